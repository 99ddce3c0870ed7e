# SPDX-License-Identifier: Apache-2.0
"""Lay the cable of config/harness.yaml around its pegs: a hand leads the free end between them."""

from __future__ import annotations

import math

from cloth_sim_ros.demo.driver import SceneDriver

HEIGHT = 0.01  # [m]
WAY = (  # x, y [m]
    (-2.14, 0.0), (-2.05, 0.15), (-0.3, 0.19), (-0.15, 0.15), (0.0, -0.15), (0.2, -0.15), (0.35, 0.15), (0.5, 0.15),
    (0.74, 0.0),
)  # fmt: skip
PACE = 0.4  # [m/s]
WAIT, STAY, AGAIN = 0.5, 3.0, 2.0  # [s] before the way and after it, and with an empty hand until the next time
END = WAIT + sum(map(math.dist, WAY, WAY[1:])) / PACE + STAY + AGAIN


def hand(t: float) -> tuple[float, float, float]:
    """Return the hand's position [m] at time t [s]: along the corners of WAY, and back once it is empty."""
    left = 0.0 if t > END - 0.5 * AGAIN else max(t - WAIT, 0.0) * PACE
    for a, b in zip(WAY, WAY[1:], strict=False):
        length = math.dist(a, b)
        if left < length:
            return *(p + left / length * (q - p) for p, q in zip(a, b, strict=True)), HEIGHT
        left -= length
    return *WAY[-1], HEIGHT


def holds(t: float) -> bool:
    """Return True if the hand holds the cable at time t [s]."""
    return t < END - AGAIN


class Driver(SceneDriver):
    """Moves the hand, releases the cable at the end, and begins again."""

    moves = ("handles/hand",)
    end = END

    def drive(self, t: float) -> None:
        """Send pose and grasp."""
        self.move("handles/hand", hand(t))
        self.hold("handles/hand", holds(t))
