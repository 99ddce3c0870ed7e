# SPDX-License-Identifier: Apache-2.0
"""The air on panels: arrays of a batch, and how many elements each has."""

import warp as wp

from cloth_sim_ros.sim.arrays.model import Counts, Features


@wp.struct
class AirState:
    """The air on panels; see State for the letters."""

    ahead_positions: wp.array(dtype=wp.vec4)  # (N,) after one more substep as smooth as the last, order 2 in wind alone
    ahead_velocities: wp.array(dtype=wp.vec4)  # (N,)
    panel_forces: wp.array(dtype=wp.vec4)  # (P,) force [N], drag rate [N s/m]


def sizes(features: Features, n: Counts) -> dict[str, int]:
    """Array -> its elements in one world; 0 where the features do not need it."""
    return {
        "ahead_positions": (n.particles if features.order == 2 else 0) if features.panels else 0,
        "ahead_velocities": (n.particles if features.order == 2 else 0) if features.panels else 0,
        "panel_forces": n.panels if features.panels else 0,
    }
