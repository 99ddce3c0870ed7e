# SPDX-License-Identifier: Apache-2.0
"""Contact of objects with themselves and one another: arrays of a batch, and how many elements each has."""

import warp as wp

from cloth_sim_ros.sim.arrays.model import Counts, Features

# Numbers of a particle in two turns: where to move, where to move by hits alone, and what its pairs lack.
ASKED = 14


@wp.struct
class SelfContactState:
    """Contact of objects with themselves and one another; see State for the letters."""

    path_starts: wp.array(dtype=wp.vec3)  # (N,) where their ways start [m], see search.py,
    path_velocities: wp.array(dtype=wp.vec3)  # (N,) how fast they go along these [m/s],
    off_path: wp.array(dtype=float)  # (N,) and how far they are off them, or will be when the substep ends [m]
    pair_corrections: wp.array(dtype=wp.int64)  # (7 N,) what pairs ask of a particle, see solve.py
    ways_given_up: wp.array(dtype=float)  # (N,) and what share of its way it gives up, or it came through something


def sizes(features: Features, n: Counts) -> dict[str, int]:
    """Array -> its elements in one world; 0 where the features do not need it."""
    return {
        "path_starts": n.particles if features.coupled else 0,
        "path_velocities": n.particles if features.coupled else 0,
        "off_path": n.particles if features.coupled else 0,
        "pair_corrections": ASKED * n.particles if features.coupled else 0,
        "ways_given_up": n.particles if features.coupled else 0,
    }
