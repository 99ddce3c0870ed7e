# SPDX-License-Identifier: Apache-2.0
"""What varies of ropes alone, as kernels see it: scratch of their solves, winches, bending and twist."""

import warp as wp


@wp.struct
class Segment:
    """Scratch of a direct solve at one segment of a chain (see physics/chain.py)."""

    frame: wp.mat33
    admittance: wp.mat33
    compliance: wp.mat33
    free: wp.vec3
    missing: wp.vec3
    moved: wp.vec3
    held: float
    tension: float
    gap: float
    along: float
    across: float
    near: float
    far: float
    reach: float
    turn: float
    too_far: int
    overstretched: int
    unsettled: int
    pull: float


@wp.struct
class Drive:
    """What is asked of one winch, live: pay_out, max_rate [m/s], acceleration [m/s^2], shortest, longest [m]."""

    pay_out: float
    max_rate: float
    acceleration: float
    shortest: float
    longest: float


@wp.struct
class WinchState:
    """How far one winch has paid out (see ropes/drum.py)."""

    index: int  # the particle at the drum that is next to the rope, and the segment that is fed
    length: float  # of that segment [m], at rest
    behind: float  # of all segments behind it [m], at rest
    total: float  # of the rope [m], at rest
    backlog: float  # [m] to be fed little by little
    rate: float  # [m/s]
    fed: float  # in this substep [m]
    last_fed: float  # in the one before [m]
    stopped: int  # whether it is asked to go beyond a limit of its length that it has reached


@wp.struct
class EndTurn:
    """By how much the end of one rope is turned about its axis against the start, live [rad]."""

    turn: float


@wp.struct
class Twist:
    """The twist of one rope between two clamps (see ropes/twist.py)."""

    known: int  # 0 at first, 1 while both ends are clamped, 2 since one was free
    start: wp.vec3  # a unit vector across the first segment
    end: wp.vec3  # and what it was, carried along the rope without twist, across the last
    start_by: int  # what clamps it, as told by ropes/twist.py
    end_by: int
    start_own: wp.vec3  # the vectors in the axes of what clamps them
    end_own: wp.vec3
    wanted: float  # by how much the end is turned [rad], now and before this substep
    turned: float
    angle: float  # of twist along all of it [rad]
    moment: float  # [N m]


@wp.struct
class BeamRow:
    """Scratch of the solve of a rope's bending at one particle (see ropes/beam.py)."""

    pivot: float
    inverse: float
    first: float
    second: float
    move: wp.vec3
    turn: wp.vec3  # y of beam_rotation.py, where the rest shape is bent
