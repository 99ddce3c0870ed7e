# SPDX-License-Identifier: Apache-2.0
"""Twist of ropes: arrays of a batch, and their sizes."""

import warp as wp

from cloth_sim_ros.sim.arrays.model import Counts, Features

# Array -> the element of each of its rows. These arrays are cleared if a body is placed elsewhere.
FORGOTTEN = {"twisted": "segment", "twists": "body", "good_twists": "body"}
# Array -> the element of each of its rows. These arrays are kept if everything on the device is rebuilt.
KEPT = {"twists": "body", "twisted": "segment", "rest_turns": "segment"}


@wp.struct
class EndTurn:
    """Angle by which the end of one rope is turned about its axis relative to the start, live [rad]."""

    turn: float


@wp.struct
class Twist:
    """The twist of one rope between two clamps (see twist.py)."""

    known: int  # 0 at first, 1 while both ends are clamped, 2 after one was free
    start: wp.vec3  # unit vector across the first segment
    end: wp.vec3  # the vector `start`, carried along the rope without twist, across the last segment
    start_by: int  # number of the clamp at the start, see clamped_by in clamps.py
    end_by: int  # the same at the end
    held: wp.vec2i  # number of segments that each clamp holds
    start_own: wp.vec3  # `start` in the axes of its clamp
    end_own: wp.vec3  # `end` in the axes of its clamp
    wanted: float  # angle by which the end is turned [rad]
    turned: float  # the same before this substep [rad]
    angle: float  # total twist angle of the rope [rad]
    moment: float  # mean torsional moment [N m]
    start_moment: float  # that at the start [N m]
    end_moment: float  # that at the end [N m]


@wp.struct
class Twisted:
    """A segment of a twisted rope, and the joint behind it."""

    couple: wp.vec3  # torsional moment x half the curvature binormal [N m] at the joint
    carried: wp.vec3  # the vector `start` of Twist, carried to the segment without twist
    angle: float  # angle of the material about the segment, against `carried` [rad]
    row: wp.vec2  # scratch of the solve for the angles


@wp.struct
class TwistState:
    """State of twisted ropes; see State for the letters."""

    twisted: wp.array(dtype=Twisted)  # (C,)
    rest_turns: wp.array(dtype=wp.vec2)  # (C,) turn of each joint at rest, along both directors there [-]
    bends: wp.array(dtype=wp.vec3)  # (C,) the same in world axes now
    twists: wp.array(dtype=Twist)  # (B,) twist of each rope that resists it
    good_twists: wp.array(dtype=Twist)  # (B,) the same when the body was last good


def sizes(features: Features, n: Counts) -> dict[str, int]:
    joints = dict.fromkeys(("twisted", "rest_turns", "bends"), n.joints * features.twist)
    return joints | dict.fromkeys(("twists", "good_twists"), n.bodies * features.twist)
