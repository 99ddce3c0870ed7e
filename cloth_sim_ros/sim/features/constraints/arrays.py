# SPDX-License-Identifier: Apache-2.0
"""Constraints between two particles: arrays of a batch, and their sizes."""

import warp as wp

from cloth_sim_ros.sim.arrays.model import Counts, Features


@wp.struct
class ConstraintState:
    """State of constraints, E of them in a batch."""

    # (E,) what the last pass pulls its first particle with, as a move times the mass [kg m], and the sum so far
    constraint_pulls: wp.array(dtype=wp.vec4)


def sizes(features: Features, n: Counts) -> dict[str, int]:
    return {"constraint_pulls": n.model["constraint_ends"]}
