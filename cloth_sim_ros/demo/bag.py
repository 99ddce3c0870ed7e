# SPDX-License-Identifier: Apache-2.0
"""Draw the bag of config/bag.yaml together: two hands lower its string, pull it tight below the ball, and release
it."""

from __future__ import annotations

from cloth_sim_ros.demo.driver import SceneDriver

# name -> where the hand waits, where it holds the string below the ball, and where it has pulled it to: x, y, z [m]
HANDS = {
    "left": ((-0.445, -0.276, 0.64), (-0.36, -0.19, 0.38), (-0.624, 0.061, 0.38)),
    "right": ((-0.308, -0.406, 0.64), (-0.22, -0.32, 0.38), (0.051, -0.61, 0.38)),
}
LOWER, PULL, LIE, AGAIN = 0.8, 2.5, 1.5, 1.0  # [s] to lower the string, to pull it tight, to hold it, to begin again
END = LOWER + PULL + LIE + AGAIN


def hand(name: str, t: float) -> tuple[float, float, float]:
    """Return the position [m] of a hand at time t [s]; it goes back to its start once it is empty."""
    t = 0.0 if t > END - 0.5 * AGAIN else t
    wait, low, tight = HANDS[name]
    begin, end, share = (wait, low, t / LOWER) if t < LOWER else (low, tight, (t - LOWER) / PULL)
    share = min(max(share, 0.0), 1.0)
    along = share * share * (3.0 - 2.0 * share)
    return tuple(a + along * (b - a) for a, b in zip(begin, end, strict=True))


def holds(t: float) -> bool:
    """True if the hands hold the string at time t [s]."""
    return t < END - AGAIN


class Driver(SceneDriver):
    """Moves the hands, releases the string, and begins again."""

    moves = tuple(f"handles/{name}" for name in HANDS)
    end = END

    def drive(self, t: float) -> None:
        """Send the poses and grasps."""
        for name in HANDS:
            self.move(f"handles/{name}", hand(name, t))
            self.hold(f"handles/{name}", holds(t))
