# SPDX-License-Identifier: Apache-2.0
"""Sizes of colliders, which may differ between worlds: written to the rows of ColliderMotion, and looked through."""

from __future__ import annotations

from typing import Any

import numpy as np

from cloth_sim_ros.sim.arrays.live_array import LiveArray
from cloth_sim_ros.sim.colliders.collider import Collider
from cloth_sim_ros.sim.input.checks import WorldSelection


def write_size(rows: LiveArray, row: int, collider: Collider, field: str, value: Any, world: WorldSelection) -> None:
    """Give a dimension of a collider a checked value [m], or one for each of some worlds, and what goes with it."""
    sizes = rows.read(row, world)["size"].astype(np.float64)
    sizes[:, collider.place_in_size(field)] = value
    resized = collider.resized(sizes)
    rows.write(row, world, size=sizes, reach=resized.reach(), roundness=resized.roundness())


def sharpest(rows: LiveArray, row: int, collider: Collider) -> Collider:
    """The collider at the size, of those that it has in all worlds, at which it comes between particles most easily."""
    if not any(each.live for each in collider.dimensions):
        return collider
    sizes = rows.read(row, None)["size"].astype(np.float64)
    roundness = np.broadcast_to(collider.resized(sizes).roundness(), len(sizes))
    return collider.resized(sizes[roundness.argmin()])
