# SPDX-License-Identifier: Apache-2.0
"""The drive of a winch: its pay-out rate, from the wanted rate and its limits."""

import warp as wp


@wp.func
def braking(room: float, acceleration: float, h: float) -> float:
    """The fastest rate [m/s] from which `room` [m] is enough to stop in, sqrt(2 a s); 0 beyond a limit."""
    left = wp.max(room, 0.0)
    return wp.min(wp.sqrt(2.0 * acceleration * left), left / h)


@wp.func
def next_rate(
    rate: float, wanted: float, most: float, acceleration: float, room: float, slack: float, h: float
) -> float:
    """The pay-out rate [m/s] of the next substep of length h [s], below 0 for hauling in.

    It nears `wanted`, within `most` both ways, by at most `acceleration` [m/s^2], and stops where the `room` [m] to
    pay out or the `slack` [m] to haul in ends.
    """
    goal = wp.clamp(wanted, -most, most)
    rate = wp.clamp(goal, rate - acceleration * h, rate + acceleration * h)
    return wp.clamp(rate, -braking(slack, acceleration, h), braking(room, acceleration, h))
