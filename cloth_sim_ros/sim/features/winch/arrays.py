# SPDX-License-Identifier: Apache-2.0
"""Ropes on a winch: arrays of a batch, and how many elements each has."""

import warp as wp

from cloth_sim_ros.sim.arrays.model import Counts, Features

# Array -> what it has a row of; kept where everything on the device is made anew.
KEPT = {"winches": "body"}


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
class WinchArrays:
    """Ropes on a winch; see State for the letters."""

    winches: wp.array(dtype=WinchState)  # (B,) of ropes that a winch feeds, and when the body was last good
    good_winches: wp.array(dtype=WinchState)  # (B,)


def sizes(features: Features, n: Counts) -> dict[str, int]:
    """Array -> its elements in one world; 0 where the features do not need it."""
    return {
        "winches": n.bodies if features.winch else 0,
        "good_winches": n.bodies if features.winch else 0,
    }
