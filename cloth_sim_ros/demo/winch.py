# SPDX-License-Identifier: Apache-2.0
"""Lower the load of config/winch.yaml and haul it up again."""

from __future__ import annotations

from cloth_sim_ros.demo.driver import SceneDriver

RATE, MOVE, REST = 0.4, 4.0, 2.0  # [m/s]; [s] of each way, and of the rest after it


def rate(t: float) -> float:
    """Return the rate of the winch [m/s] at time t [s]: out, rest, in, rest."""
    along = t % (2.0 * (MOVE + REST))
    if along % (MOVE + REST) >= MOVE:
        return 0.0
    return RATE if along < MOVE else -RATE


class Driver(SceneDriver):
    """Turns the drum."""

    numbers = ("cable/winch",)

    def drive(self, t: float) -> None:
        """Send the rate."""
        self.tell("cable/winch", rate(t))
