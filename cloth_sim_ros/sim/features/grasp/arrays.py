# SPDX-License-Identifier: Apache-2.0
"""What handles hold: arrays of a batch, and how many elements each has."""

import warp as wp

from cloth_sim_ros.sim.arrays.model import Counts, Features

# Array -> what it has a row of; kept where everything on the device is made anew.
KEPT = {"grips": "particle", "grip_pulls": "particle", "grip_forces": "particle", "held": "count"}


@wp.struct
class GraspState:
    """What handles hold; see State for the letters."""

    grips: wp.array(dtype=wp.vec4)  # (N,) place in the axes of the handle that holds a particle [m], and 1 + its number
    grip_pulls: wp.array(dtype=wp.vec4)  # (N,) of the handle on the particle in the last substep [N]
    grip_forces: wp.array(dtype=wp.vec4)  # (N,) of the handle on the particle, mean over the frame [N]
    held: wp.array(dtype=int)  # (B,) particles that handles hold


def sizes(features: Features, n: Counts) -> dict[str, int]:
    """Array -> its elements in one world; 0 where the features do not need it."""
    return {
        "grips": n.particles if features.handles else 0,
        "grip_pulls": n.particles if features.handles else 0,
        "grip_forces": n.particles if features.handles else 0,
        "held": n.bodies if features.handles else 0,
    }
