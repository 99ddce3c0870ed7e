# SPDX-License-Identifier: Apache-2.0
"""Pull the cloth of config/tablecloth.yaml from its table: two hands grasp its corners, pull, and let it fall."""

from __future__ import annotations

from cloth_sim_ros.demo.driver import SceneDriver

HANDS = {"left": -0.48, "right": 0.48}  # name -> y [m] of its corner
CORNER = (0.6, 0.71)  # x, z [m]
DRAPE, PULL, LIE = 1.0, 1.6, 2.4  # [s] until the pull, of it, and after it until all begins again
END = DRAPE + PULL + LIE
FAR, DOWN = 1.3, 0.1  # [m] by how much the hands go away from the table, and down


def hand(t: float) -> tuple[float, float]:
    """Return x and z [m] of both hands at time t [s]: they wait, pull, and go back once they are empty."""
    t = 0.0 if t > END - 0.5 * LIE else t
    share = min(max((t - DRAPE) / PULL, 0.0), 1.0)
    along = share * share * (3.0 - 2.0 * share)
    return CORNER[0] + FAR * along, CORNER[1] - DOWN * along


def holds(t: float) -> bool:
    """Return True if the hands hold the cloth at time t [s]."""
    return t < DRAPE + PULL


class Driver(SceneDriver):
    """Moves the hands, releases the cloth at the end, and begins again."""

    moves = tuple(f"handles/{name}" for name in HANDS)
    end = END

    def drive(self, t: float) -> None:
        """Send the poses and grasps."""
        for name, y in HANDS.items():
            x, z = hand(t)
            self.move(f"handles/{name}", (x, y, z))
            self.hold(f"handles/{name}", holds(t))
