# SPDX-License-Identifier: Apache-2.0
"""A trial of a hard case: a scene, the actions on it while it runs, and the conditions it must keep."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from cloth_sim_ros.sim import Scene, Simulation

WHIP = 4.0  # times the speed at which a body is struck: what the exact motion of springs reaches at free ends

Options = dict[str, Any]


def _nothing(sim: Simulation, frame: int = 0) -> None:
    """Leave a body to itself."""


def fine(sim: Simulation) -> str:
    """Return "": nothing is checked at the end."""
    return ""


@dataclass(frozen=True)
class Trial:
    """One run: `begin` once, then `drive` before every frame; and its promises besides staying finite.

    conserves: only gravity does work, and a collider that moves with `velocity`(frame) [m/s]. Energy never grows beyond
    that by more than the share `slack`. rest: strain at the end. fastest [m/s]: bound of the speed of a particle. jump
    [m]: move of pins between frames, which takes particles along within a substep. outside: no particle ends a frame
    deeper than a tenth of a millimetre in a collider. finally_: returns "" or what went wrong.
    """

    scene: Scene
    frames: int = 120
    frame_dt: float = 1 / 60
    begin: Callable[[Simulation], None] = _nothing
    drive: Callable[[Simulation, int], None] = _nothing
    conserves: bool = False
    slack: float = 0.01
    velocity: Callable[[int], float] | None = None
    rest: float = math.inf
    fastest: float = math.inf
    jump: float = 0.0
    outside: bool = False
    finally_: Callable[[Simulation], str] = fine
