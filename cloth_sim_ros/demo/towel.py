# SPDX-License-Identifier: Apache-2.0
"""Fold the towel of config/towel.yaml in half, as a robot's driver would, by poses and services of two hands."""

from __future__ import annotations

import math

from cloth_sim_ros.demo.driver import SceneDriver

HANDS = {"left": -0.25, "right": 0.25}  # name -> x [m]
HALF, TABLE = 0.25, 0.006  # [m] half of the towel's length, and where it lies
WAIT, FOLD, LIE, AGAIN = 1.0, 3.0, 1.0, 2.0  # [s] before, for and after the fold, and then until the next one
END = WAIT + FOLD + LIE + AGAIN


def hand(t: float) -> tuple[float, float]:
    """Return y and z [m] of both hands at time t [s]: half a circle over the towel, and back once they are empty."""
    t = 0.0 if t > END - 0.5 * AGAIN else t
    share = min(max((t - WAIT) / FOLD, 0.0), 1.0)
    angle = math.pi * 0.5 * (1.0 - math.cos(math.pi * share))
    return -HALF * math.cos(angle), TABLE + HALF * math.sin(angle) + 0.012 * share


def holds(t: float) -> bool:
    """Return True if the hands hold the towel at time t [s]."""
    return t < WAIT + FOLD + LIE


class Driver(SceneDriver):
    """Moves the hands, releases the folded towel, and begins again."""

    moves = tuple(f"handles/{name}" for name in HANDS)
    end = END

    def drive(self, t: float) -> None:
        """Send the poses and grasps."""
        for name, x in HANDS.items():
            self.move(f"handles/{name}", (x, *hand(t)))
            self.hold(f"handles/{name}", holds(t))
