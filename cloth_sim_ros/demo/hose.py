# SPDX-License-Identifier: Apache-2.0
"""Turn a clamp of config/hose.yaml by the parameter hose.end_turn: several turns on, and back."""

from __future__ import annotations

import math

from cloth_sim_ros.demo.driver import SceneDriver

TURNS, PERIOD = 7.0, 20.0  # of the clamp, and [s] to and fro
EVERY = 3  # of the driver's steps one sets the parameter


def turn(t: float) -> float:
    """Return the turn of the clamp [rad] at time t [s]."""
    return math.pi * TURNS * (1.0 - math.cos(2.0 * math.pi * t / PERIOD))


class Driver(SceneDriver):
    """Turns the clamp."""

    def __init__(self):
        super().__init__()
        self._steps = 0

    def drive(self, t: float) -> None:
        """Set the turn in one of EVERY steps."""
        self._steps += 1
        if self._steps % EVERY == 0:
            self.set("hose.end_turn", turn(t))
