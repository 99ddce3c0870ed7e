# SPDX-License-Identifier: Apache-2.0
"""Make the gusts of config/flag.yaml: a wind that swells, drops, and veers to and fro."""

from __future__ import annotations

import math

from cloth_sim_ros.demo.driver import SceneDriver

STRENGTH, SWELL = 7.0, 2.0  # [m/s] on average, and up and down
VEER = 0.35  # [rad] to either side


def gust(t: float) -> tuple[float, float, float]:
    """Return the wind [m/s] at time t [s], which swells and veers."""
    strength = STRENGTH + SWELL * math.sin(2.1 * t) * math.cos(0.7 * t)
    angle = VEER * math.sin(1.3 * t) + 0.5 * VEER * math.sin(4.7 * t)
    return strength * math.cos(angle), strength * math.sin(angle), 0.0


class Driver(SceneDriver):
    """Sends the wind."""

    def drive(self, t: float) -> None:
        """Send the wind."""
        self.blow(gust(t))
