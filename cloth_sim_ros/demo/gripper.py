# SPDX-License-Identifier: Apache-2.0
"""Pinch the napkin of config/gripper.yaml, carry it aside, and drop it, as a robot's driver would."""

from __future__ import annotations

import math

from cloth_sim_ros.demo.driver import SceneDriver, Vector

PEG, START, ASIDE = (0.0, 0.0, 0.75), (0.0, 0.0, 0.73), 0.25  # [m]
FIRM, WEAK, OPEN = 1.0, 0.1, 0.06  # [N] each finger has to press with 0.25 to hold 40 g; [m]
CLOSE, CARRY, HOLD, DROP = 1.5, 2.0, 1.0, 2.0  # [s]
END = CLOSE + CARRY + HOLD + DROP


def place(t: float) -> Vector:
    """Return the gripper's position [m] at time t [s]."""
    share = min(max((t - CLOSE) / CARRY, 0.0), 1.0)
    return (ASIDE * 0.5 * (1.0 - math.cos(math.pi * share)), START[1], START[2])


def force(t: float) -> float:
    """Return the force [N] of its fingers at time t [s]."""
    return FIRM if t < CLOSE + CARRY + HOLD else WEAK


class Driver(SceneDriver):
    """Moves the gripper, sets its force, releases the peg's grasp, and begins again with open fingers."""

    moves = ("grippers/hand", "handles/peg")
    numbers = tuple(f"grippers/hand/{what}" for what in ("force", "opening"))
    end = END + 1.0

    def drive(self, t: float) -> None:
        """Send the poses, and the force or the opening."""
        self.move("handles/peg", PEG)
        self.hold("handles/peg", t < CLOSE - 0.2)
        if t < END:
            self.move("grippers/hand", place(t))
            self.tell("grippers/hand/force", force(t))
        else:
            self.move("grippers/hand", START)
            self.tell("grippers/hand/opening", OPEN)
