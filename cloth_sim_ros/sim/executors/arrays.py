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
    """Return the number of elements of each array in one world; 0 if the features do not need it."""
    return {
        "strain_found": n.bodies if features.method == "verlet" else 0,
        "strain": n.bodies if features.method == "verlet" else 0,
        "rejected": n.bodies if features.method == "verlet" else 0,
    }
