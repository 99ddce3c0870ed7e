# SPDX-License-Identifier: Apache-2.0
"""Forces of the air on panels: arrays of a batch, and their sizes."""

import warp as wp

from cloth_sim_ros.sim.arrays.model import Counts, Features


@wp.struct
class AirState:
    """State of the air on panels; see State for the letters."""

    ahead_positions: wp.array(dtype=wp.vec4)  # (N,) extrapolated by one substep [m], only in order 2 with air
    ahead_velocities: wp.array(dtype=wp.vec4)  # (N,) the same for velocities [m/s]
    panel_forces: wp.array(dtype=wp.vec4)  # (P,) force [N], drag rate [N s/m]


def sizes(features: Features, n: Counts) -> dict[str, int]:
    ahead = n.particles if features.order == 2 and features.panels else 0
    return {"ahead_positions": ahead, "ahead_velocities": ahead, "panel_forces": n.panels if features.panels else 0}
