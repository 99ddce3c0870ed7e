# SPDX-License-Identifier: Apache-2.0
"""Sizes of colliders, which may differ between worlds, in the rows of ColliderMotion."""

from __future__ import annotations

from typing import Any

import numpy as np

from cloth_sim_ros.sim.arrays.live_array import LiveArray
from cloth_sim_ros.sim.colliders.collider import Collider
from cloth_sim_ros.sim.input.checks import WorldSelection
from cloth_sim_ros.sim.input.numbers import place_of


def write_size(rows: LiveArray, row: int, collider: Collider, field: str, value: Any, world: WorldSelection) -> None:
    """Set a dimension of a collider to a checked value [m], or one per world, and update its reach."""
    sizes = rows.read(row, world)["size"].astype(np.float64)
    sizes[:, place_of(collider.dimensions, field)] = value
    resized = collider.resized(sizes)
    rows.write(row, world, size=sizes, reach=resized.reach())


def sharpest(rows: LiveArray, row: int, collider: Collider) -> Collider:
    """Return the collider at its sharpest size over all worlds, which comes between particles most easily."""
    if not any(each.live for each in collider.dimensions):
        return collider
    sizes = rows.read(row, None)["size"].astype(np.float64)
    roundness = np.broadcast_to(collider.resized(sizes).roundness(), len(sizes))
    return collider.resized(sizes[roundness.argmin()])
