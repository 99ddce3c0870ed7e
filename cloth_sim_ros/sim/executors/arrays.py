# SPDX-License-Identifier: Apache-2.0
"""Frames of explicit steps, which are trials: arrays of a batch, and how many elements each has."""

import warp as wp

from cloth_sim_ros.sim.arrays.model import Counts, Features


@wp.struct
class TrialState:
    """Frames of explicit steps, which are trials; see State for the letters."""

    start_positions: wp.array(dtype=wp.vec4)  # (N,) where this frame began, explicit methods, see trial.py
    start_position_lo: wp.array(dtype=wp.vec4)  # (N,)
    start_velocities: wp.array(dtype=wp.vec4)  # (N,)
    start_recoveries: wp.array(dtype=int)  # (B,)
    strain_found: wp.array(dtype=float)  # (B,) largest strain above 0.5 at the end of this frame, else 0
    strain: wp.array(dtype=float)  # (B,) the same of the frame before
    rejected: wp.array(dtype=int)  # (B,) whether the frame is done again
    redone: wp.array(dtype=int)  # (B,) how many frames were


def sizes(features: Features, n: Counts) -> dict[str, int]:
    """Array -> its elements in one world; 0 where the features do not need it."""
    return {
        "start_positions": n.particles if features.method == "verlet" else 0,
        "start_position_lo": n.particles if features.method == "verlet" else 0,
        "start_velocities": n.particles if features.method == "verlet" else 0,
        "start_recoveries": n.bodies if features.method == "verlet" else 0,
        "strain_found": n.bodies if features.method == "verlet" else 0,
        "strain": n.bodies if features.method == "verlet" else 0,
        "rejected": n.bodies if features.method == "verlet" else 0,
        "redone": n.bodies if features.method == "verlet" else 0,
    }
