# SPDX-License-Identifier: Apache-2.0
"""Hold the load of config/rope_swing.yaml aside, let it swing, and begin again."""

from __future__ import annotations

from cloth_sim_ros.demo.driver import SceneDriver

HAND = (1.0, 0.0, 0.7679492)  # [m]
WAIT, SWING = 1.0, 20.0  # [s] before it lets go, and until it begins again


def holds(t: float) -> bool:
    """Return True if the hand holds the load at time t [s]."""
    return t < WAIT


class Driver(SceneDriver):
    """Lets go, and begins again."""

    moves = ("handles/hand",)
    end = WAIT + SWING

    def drive(self, t: float) -> None:
        """Send the hand's pose, which stays, and its grasp."""
        self.move("handles/hand", HAND)
        self.hold("handles/hand", holds(t))
