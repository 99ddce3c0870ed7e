# SPDX-License-Identifier: Apache-2.0
"""Trial frames of explicit steps: arrays of a batch, and their sizes."""

import warp as wp

from cloth_sim_ros.sim.arrays.model import Counts, Features


@wp.struct
class TrialState:
    """State of trial frames of explicit steps; see State for the letters."""

    strains: wp.array(
        dtype=float
    )  # (2 B,) largest strains above 0.5, else 0, at the ends of the last frame and of this
    rejected: wp.array(dtype=int)  # (B,) 1 if the frame is repeated


def sizes(features: Features, n: Counts) -> dict[str, int]:
    bodies = n.bodies * (features.method == "verlet")
    return {"strains": 2 * bodies, "rejected": bodies}
