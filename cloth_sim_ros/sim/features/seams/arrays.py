# SPDX-License-Identifier: Apache-2.0
"""Seams: arrays of the batch of the first object of each, and their sizes."""

import warp as wp

from cloth_sim_ros.sim.arrays.model import Counts, Features

# Array -> the element of each of its rows. These arrays are kept if everything on the device is rebuilt.
KEPT = {"stitches": "stitch"}

# The second number of a stitch.
CLOSES, CLOSED, BROKEN = wp.constant(0.0), wp.constant(-1.0), wp.constant(1.0)


@wp.struct
class SeamState:
    """State of the stitches whose first object is in this batch, Z of them."""

    # (Z,) segments that it slid along a rope; CLOSES, CLOSED from then on, or BROKEN; and 1 if it lies at a particle
    # where the rope bends
    stitches: wp.array(dtype=wp.vec3)
    stitch_forces: wp.array(dtype=wp.vec3)  # (Z,) force on the point of the first object, in the last substep [N]


def sizes(features: Features, n: Counts) -> dict[str, int]:
    return {"stitches": n.stitches, "stitch_forces": n.stitches}
