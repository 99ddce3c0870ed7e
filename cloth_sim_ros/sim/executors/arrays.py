# SPDX-License-Identifier: Apache-2.0
"""Trial frames of explicit steps: arrays of a batch, and their sizes."""

import warp as wp

from cloth_sim_ros.sim.arrays.model import Counts, Features


@wp.struct
class TrialState:
    """State of trial frames of explicit steps; see State for the letters."""

    strain_found: wp.array(dtype=float)  # (B,) largest strain above 0.5 at the end of this frame, else 0
    strain: wp.array(dtype=float)  # (B,) the same for the frame before
    rejected: wp.array(dtype=int)  # (B,) 1 if the frame is repeated


def sizes(features: Features, n: Counts) -> dict[str, int]:
    return dict.fromkeys(TrialState.vars, n.bodies * (features.method == "verlet"))
