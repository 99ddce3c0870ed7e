# SPDX-License-Identifier: Apache-2.0
"""Self-contact and contact between objects: arrays of a batch, and their sizes."""

import warp as wp

from cloth_sim_ros.sim.arrays.model import Counts, Features

# Integers a particle in `pair_corrections`: for each of two turns, a move, a move by hits alone, and a sum of claims.
ASKED = 14


@wp.struct
class SelfContactState:
    """State of self-contact and contact between objects; see State for the letters."""

    path_starts: wp.array(dtype=wp.vec3)  # (N,) start of each particle's straight path [m], see search.py
    path_velocities: wp.array(dtype=wp.vec3)  # (N,) velocity along that path [m/s]
    off_path: wp.array(dtype=float)  # (N,) distance from the path, now or when the substep ends [m]
    pair_corrections: wp.array(dtype=wp.int64)  # (ASKED N,) corrections that pairs ask for, see solve.py
    grounds: wp.array(dtype=wp.vec4)  # (N,) displacement of a collider that touches it in this substep [m], and 1
    ways_given_up: wp.array(dtype=float)  # (N,) share of its displacement that a particle gives up, see ccd_clamp.py


def sizes(features: Features, n: Counts) -> dict[str, int]:
    particles = n.particles * features.coupled
    return {**dict.fromkeys(SelfContactState.vars, particles), "pair_corrections": ASKED * particles}
