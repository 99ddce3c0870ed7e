# SPDX-License-Identifier: Apache-2.0
"""Twist of ropes: arrays of a batch, and how many elements each has."""

import warp as wp

from cloth_sim_ros.sim.arrays.model import Counts, Features

# Array -> what it has a row of; cleared where a body is put elsewhere.
FORGOTTEN = {"couples": "segment", "twists": "body", "good_twists": "body"}
# Array -> what it has a row of; kept where everything on the device is made anew.
KEPT = {"twists": "body"}


@wp.struct
class EndTurn:
    """By how much the end of one rope is turned about its axis against the start, live [rad]."""

    turn: float


@wp.struct
class Twist:
    """The twist of one rope between two clamps (see twist.py)."""

    known: int  # 0 at first, 1 while both ends are clamped, 2 since one was free
    start: wp.vec3  # a unit vector across the first segment
    end: wp.vec3  # and what it was, carried along the rope without twist, across the last
    start_by: int  # what clamps it, as told by clamps.py
    end_by: int
    start_own: wp.vec3  # the vectors in the axes of what clamps them
    end_own: wp.vec3
    wanted: float  # by how much the end is turned [rad], now and before this substep
    turned: float
    angle: float  # of twist along all of it [rad]
    moment: float  # [N m]


@wp.struct
class TwistState:
    """Twist of ropes; see State for the letters."""

    couples: wp.array(dtype=wp.vec3)  # (C,) torsional moment x half the curvature binormal [N m] at each such joint
    twists: wp.array(dtype=Twist)  # (B,) of ropes that resist twist, and when the body was last good
    good_twists: wp.array(dtype=Twist)  # (B,)


def sizes(features: Features, n: Counts) -> dict[str, int]:
    """Array -> its elements in one world; 0 where the features do not need it."""
    return {
        "couples": n.joints if features.twist else 0,
        "twists": n.bodies if features.twist else 0,
        "good_twists": n.bodies if features.twist else 0,
    }
