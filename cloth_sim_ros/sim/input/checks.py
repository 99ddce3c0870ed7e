# SPDX-License-Identifier: Apache-2.0
"""Checks of descriptions against the rows of `cloth_sim_ros.parameters`, and of arrays by their shape.

A bad value raises ValueError with one sentence that names the parameter, the value and the allowed values.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
import warp as wp

from cloth_sim_ros import parameters as table
from cloth_sim_ros.sim.physics.quaternion import unit_quaternion

# Worlds: one, all for None, or the numbers (k,) of those that a mask selects.
WorldSelection = int | None | np.ndarray


def worlds_of(world: WorldSelection) -> slice | np.ndarray:
    """The rows of some worlds in an array that has one for each."""
    if isinstance(world, np.ndarray):
        return world
    return slice(None) if world is None else slice(world, world + 1)


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


def on_host(array: Any) -> np.ndarray:
    """`array` for NumPy: what NumPy takes, or what DLPack brings from a device, copied and waited for."""
    if isinstance(array, wp.array):
        return array.numpy()
    on_gpu = hasattr(array, "__dlpack_device__") and not isinstance(array, np.ndarray)
    if on_gpu and array.__dlpack_device__()[0] != 1:  # kDLCPU
        return wp.from_dlpack(array).numpy()
    return np.asarray(array)


def check_worlds(row: table.Parameter, value: Any, name: str, worlds: int, some: WorldSelection) -> Any:
    """The checked value of a live number for some of `worlds` worlds.

    It is as `table.check` gives it or, of an array whose first axis is all worlds, the rows (k,) or (k, length) float64
    of those. Raises ValueError.
    """
    vector = row.kind == "double_array"
    value = on_host(value) if hasattr(value, "shape") else value
    if row.kind not in ("double", "double_array") or _ndim(value) != 1 + vector:
        return table.check(row, value, name)
    if isinstance(some, int):
        raise ValueError(f"{name} is an array of all worlds for world {some} alone; allowed is one value for it")
    array, shape = np.asarray(value, dtype=np.float64), (worlds, *((row.length,) if vector else ()))
    if array.shape != shape or not ((array >= row.low) & (array <= row.high)).all():  # NaN is neither
        raise ValueError(
            f"{name} has shape {array.shape} with values from {array.min():g} to {array.max():g}; allowed are "
            f"{shape} of which each is {table.allowed(row)}"
        )
    return array[worlds_of(some)]


def _ndim(value: Any) -> int:
    try:
        return np.asarray(value, dtype=np.float64).ndim
    except (TypeError, ValueError):  # text, or rows of different lengths
        return -1


def finite_array(value: Any, name: str, least: int = 1) -> np.ndarray:
    """`value` as a new (N, 3) array of finite numbers, N at least `least`. Raises ValueError."""
    try:
        array = np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        array = np.zeros(0)
    if array.ndim != 2 or array.shape[1] != 3 or len(array) < least:
        raise ValueError(
            f"{name} has shape {np.shape(value)}; allowed are N rows of 3 finite numbers, N at least {least}"
        )
    for row, column in np.argwhere(~np.isfinite(array))[:1]:
        raise ValueError(f"{name} holds {array[row, column]:g} in row {row}; allowed are finite numbers")
    return array


def named(among: Mapping[str, Any], name: Any, kind: str) -> Any:
    """What `name` stands for `among` the things of a kind, such as "object". Raises ValueError where there is none."""
    if not isinstance(name, str) or name not in among:
        raise ValueError(f"there is no {kind} {name!r}; allowed is {names_of(among)}")
    return among[name]


def names_of(names: Iterable[str]) -> str:
    """Names as a sentence about what is allowed lists them."""
    return ", ".join(names) or "none, as the scene has none"
