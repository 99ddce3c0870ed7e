# SPDX-License-Identifier: Apache-2.0
"""Pull the knot of config/knot.yaml tight by two hands that move apart, and begin again."""

from __future__ import annotations

from cloth_sim_ros.demo.driver import SceneDriver

HANDS = {"left": (-0.2633, -0.2482, 1.3412), "right": (0.2633, 0.2482, 1.3412)}  # [m] at first
SPAN = 1.79  # [m] between the hands in the end
WAIT, PULL, STAY, AGAIN = 1.0, 6.0, 3.0, 2.0  # [s] before and after the pull, and with empty hands until the next one
END = WAIT + PULL + STAY + AGAIN


def hand(name: str, t: float) -> tuple[float, ...]:
    """Return the position [m] of a hand at time t [s]: outward on the line through both, and back once it is empty."""
    t = 0.0 if t > END - 0.5 * AGAIN else t
    share = min(max((t - WAIT) / PULL, 0.0), 1.0)
    here, other = HANDS[name], HANDS["right" if name == "left" else "left"]
    apart = sum((p - q) ** 2 for p, q in zip(here, other, strict=True)) ** 0.5
    stretch = 1.0 + share * (SPAN / apart - 1.0)
    return tuple(0.5 * (p + q) + 0.5 * stretch * (p - q) for p, q in zip(here, other, strict=True))


def holds(t: float) -> bool:
    """Return True if the hands hold the rope at time t [s]."""
    return t < END - AGAIN


class Driver(SceneDriver):
    """Moves both hands, releases the rope, and begins again."""

    moves = tuple(f"handles/{name}" for name in HANDS)
    end = END

    def drive(self, t: float) -> None:
        """Send the poses and grasps."""
        for name in HANDS:
            self.move(f"handles/{name}", hand(name, t))
            self.hold(f"handles/{name}", holds(t))
