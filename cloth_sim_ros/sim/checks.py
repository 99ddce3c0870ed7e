# SPDX-License-Identifier: Apache-2.0
"""How descriptions check themselves: against the rows of `cloth_sim_ros.parameters`, and arrays by their shape.

A bad value raises ValueError with one sentence that names the thing, the value and what is allowed.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from cloth_sim_ros import parameters as table
from cloth_sim_ros.sim.quaternion import unit_quaternion


def check_fields(thing: Any, rows: tuple[table.Parameter, ...], skip: tuple[str, ...] = ()) -> None:
    """Replace every field of a frozen dataclass that has a row, and is not in `skip`, by its checked value, and an
    orientation by a unit quaternion. Raises ValueError."""
    by_name, owner = {row.name: row for row in rows}, type(thing).__name__
    for field in dataclasses.fields(thing):
        value, name = getattr(thing, field.name), f"{owner}.{field.name}"
        if field.name == "orientation":
            object.__setattr__(thing, field.name, unit_quaternion(value, name))
        elif field.name in by_name and field.name not in skip:
            object.__setattr__(thing, field.name, table.check(by_name[field.name], value, name))


def finite_array(value: Any, columns: int, name: str, dtype: type = np.float64) -> np.ndarray:
    """`value` as a new (N, columns) array of finite numbers, N at least 1. Raises ValueError."""
    try:
        array = np.array(value, dtype=dtype)
    except (TypeError, ValueError):
        array = np.zeros(0)
    if array.ndim != 2 or array.shape[1] != columns or len(array) == 0 or not np.isfinite(array).all():
        raise ValueError(
            f"{name} has shape {np.shape(value)}; allowed are N rows of {columns} finite numbers, N at least 1"
        )
    return array
