# SPDX-License-Identifier: Apache-2.0
"""Twirl the skirt of config/garment.yaml: the handle at its waist and the hips in it turn to and fro."""

from __future__ import annotations

import math

from cloth_sim_ros.demo.driver import SceneDriver

WAIST, HIPS = (0.0, 0.0, 1.0), (0.0, 0.0, 0.86)  # [m]
TURNS, PERIOD = 4.0, 8.0  # one way, and [s] to and fro


def turned(t: float) -> tuple[float, float, float, float]:
    """Return the orientation x y z w of waist and hips at time t [s]: by TURNS about the vertical axis, and back."""
    angle = math.pi * TURNS * (1.0 - math.cos(2.0 * math.pi * t / PERIOD))
    return 0.0, 0.0, math.sin(0.5 * angle), math.cos(0.5 * angle)


class Driver(SceneDriver):
    """Turns waist and hips."""

    moves = ("handles/waist", "colliders/hips")

    def drive(self, t: float) -> None:
        """Send both poses."""
        self.move("handles/waist", WAIST, turned(t))
        self.move("colliders/hips", HIPS, turned(t))
