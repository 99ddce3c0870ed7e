# SPDX-License-Identifier: Apache-2.0
"""Ropes on a winch: arrays of a batch, and their sizes."""

import warp as wp

from cloth_sim_ros.sim.arrays.model import Counts, Features

# Array -> the element of each of its rows. These arrays are kept if everything on the device is rebuilt.
KEPT = {"winches": "body"}


@wp.struct
class Drive:
    """Settings of one winch, live: pay_out, max_rate [m/s], acceleration [m/s^2], shortest, longest [m]."""

    pay_out: float
    max_rate: float
    acceleration: float
    shortest: float
    longest: float


@wp.struct
class WinchState:
    """State of the rope of one winch (see drum.py)."""

    index: int  # last particle held on the drum; the fed segment has the same number
    length: float  # rest length of the fed segment [m]
    behind: float  # rest length of all segments after it [m]
    total: float  # rest length of the whole rope [m]
    backlog: float  # rest length that is still to be fed little by little [m]
    rate: float  # pay-out rate [m/s]
    fed: float  # length fed in this substep [m]
    last_fed: float  # length fed in the one before [m]
    stopped: int  # 1 if the winch is to go beyond a length limit that it has reached


@wp.struct
class WinchArrays:
    """State of ropes on a winch; see State for the letters."""

    winches: wp.array(dtype=WinchState)  # (B,) state of each rope on a winch
    good_winches: wp.array(dtype=WinchState)  # (B,) the same when the body was last good


def sizes(features: Features, n: Counts) -> dict[str, int]:
    return dict.fromkeys(("winches", "good_winches"), n.bodies * features.winch)
