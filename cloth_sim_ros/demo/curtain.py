# SPDX-License-Identifier: Apache-2.0
"""Drive config/curtain.yaml: a ball swings through the curtain, and a breeze comes and goes.

The breeze ends for good if a user sets the parameter wind.velocity, as by a slider of the viewer.
"""

from __future__ import annotations

import math

from cloth_sim_ros.demo.driver import SceneDriver

SWING_PERIOD = 6.0  # [s] of the ball, to and fro
GUST_PERIOD = 8.0  # [s] of the breeze


def ball_pose(t: float) -> tuple[float, float, float]:
    """Return the ball's position [m] at time t [s]: it swings through the plane y = 0, and from side to side."""
    phase = 2.0 * math.pi * t / SWING_PERIOD
    return 0.25 * math.sin(0.3 * phase), -0.6 * math.cos(phase), 1.0


def breeze(t: float) -> tuple[float, float, float]:
    """Return the wind [m/s] at time t [s]."""
    return 0.0, 2.0 * math.sin(2.0 * math.pi * t / GUST_PERIOD) ** 2, 0.0


class Driver(SceneDriver):
    """Moves the ball and makes the wind."""

    moves = ("colliders/ball",)

    def drive(self, t: float) -> None:
        """Send the ball's pose and the wind."""
        self.move("colliders/ball", ball_pose(t))
        self.blow(breeze(t))
