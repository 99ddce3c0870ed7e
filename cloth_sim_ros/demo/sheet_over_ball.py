# SPDX-License-Identifier: Apache-2.0
"""Move the ball of config/sheet_over_ball.yaml: it waits for the sheet to fall, then circles and bobs below it."""

from __future__ import annotations

import math

from cloth_sim_ros.demo.driver import SceneDriver

START = (0.0, 0.0, 0.4)  # [m]
FALL = 1.5  # [s] in which the sheet comes to rest
ROUND, PERIOD = 0.2, 8.0  # [m] and [s] of the circle
END = FALL + 4.0 * PERIOD  # [s] until all begins again
BOB = 0.05  # [m] up and down, twice a round


def ball(t: float) -> tuple[float, float, float]:
    """Return the ball's position [m] at time t [s]. It starts gently, from a circle of radius 0."""
    after = max(t - FALL, 0.0)
    growth = 1.0 - math.exp(-after)
    angle = 2.0 * math.pi * after / PERIOD
    x, y = ROUND * growth * math.sin(angle), ROUND * growth * (1.0 - math.cos(angle))
    return START[0] + x, START[1] + y, START[2] + BOB * growth * math.sin(2.0 * angle)


class Driver(SceneDriver):
    """Moves the ball, and resets the scene after END."""

    moves = ("colliders/ball",)
    end = END

    def drive(self, t: float) -> None:
        """Send the ball's pose."""
        self.move("colliders/ball", ball(t))
