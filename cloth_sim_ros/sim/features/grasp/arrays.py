# SPDX-License-Identifier: Apache-2.0
"""Handles: arrays of a batch that record what they hold, and the sizes of these."""

import warp as wp

from cloth_sim_ros.sim.arrays.model import Counts, Features

# Array -> the element of each of its rows. These arrays are kept if everything on the device is rebuilt.
KEPT = {"grips": "particle", "grip_pulls": "particle", "grip_forces": "particle", "held": "count"}


@wp.struct
class GraspState:
    """State of held particles; see State for the letters."""

    grips: wp.array(dtype=wp.vec4)  # (N,) place in the axes of the holding handle [m], and 1 + the handle's number
    grip_pulls: wp.array(dtype=wp.vec4)  # (N,) force of the handle on the particle in the last substep [N]
    grip_forces: wp.array(dtype=wp.vec4)  # (N,) force of the handle on the particle, mean over the frame [N]
    held: wp.array(dtype=int)  # (B,) particles that handles hold


def sizes(features: Features, n: Counts) -> dict[str, int]:
    grips = dict.fromkeys(("grips", "grip_pulls", "grip_forces"), n.particles * features.handles)
    return {**grips, "held": n.bodies * features.handles}
