# SPDX-License-Identifier: Apache-2.0
"""A handle: a hand without a shape of its own, which grasps particles within its reach and moves them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from cloth_sim_ros import parameters as table
from cloth_sim_ros.sim.input.checks import check_fields
from cloth_sim_ros.sim.physics.quaternion import Quaternion, Vector


@dataclass(frozen=True)
class Handle:
    """A handle's pose and grasp. Raises ValueError for a value that is not allowed.

    reach: the radius [m] of a ball, or the three edges [m] of a box along its axes, around its origin; it grasps
    particles within. compliance [m/N]: of the whole grasp along each axis, 0 is rigid. break_force [N]: load above
    which it lets go, 0 is never. object: the name of the one object that it grasps, "" is any. attached: True if it
    grasps from the start.
    """

    position: Vector = (0.0, 0.0, 0.0)
    orientation: Quaternion = (0.0, 0.0, 0.0, 1.0)
    reach: Any = 0.03
    compliance: float = 0.0
    break_force: float = 0.0
    object: str = ""
    attached: bool = False

    def __post_init__(self) -> None:
        check_fields(self, table.HANDLE, skip=("reach",))
        object.__setattr__(self, "reach", checked_reach(self.reach, "Handle.reach"))


def checked_reach(value: Any, name: str) -> tuple[float, ...]:
    """A reach as one length [m] or three. Raises ValueError for anything else."""
    lengths = table.check(table.row(table.HANDLE, "reach"), np.atleast_1d(value).tolist(), name)
    if len(lengths) not in (1, 3):
        raise ValueError(f"{name} has {len(lengths)} numbers; allowed is 1, a radius, or 3, the edges of a box [m]")
    return lengths


def extents(reach: tuple[float, ...]) -> tuple[float, float, float, float]:
    """Half the edges of a box [m] and the radius [m] of the ball that a particle must both lie in to be grasped."""
    if len(reach) == 1:
        return (reach[0],) * 4
    x, y, z = (0.5 * edge for edge in reach)
    return (x, y, z, math.hypot(x, y, z) * 1.001)
