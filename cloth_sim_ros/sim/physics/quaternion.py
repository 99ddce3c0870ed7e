# SPDX-License-Identifier: Apache-2.0
"""Orientations as unit quaternions x y z w, in NumPy. Nothing here touches a device."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from cloth_sim_ros.parameters import shown

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
Motion = tuple[Quaternion, np.ndarray]  # a turn about the origin of the world, then a shift [m]


def unit_quaternion(value: Any, name: str) -> Quaternion:
    """`value` (x, y, z, w) scaled to length 1.

    Raises ValueError if it is not four finite numbers, or shorter than 1e-6.
    """
    unit = _unit(value, 4, 1e-6)
    if unit is None:
        raise ValueError(f"{name} is {shown(value)}; allowed is a finite quaternion x y z w that is not zero")
    return unit


def unit_quaternions(value: Any, name: str, count: int) -> np.ndarray:
    """Rows (count, 4) of x, y, z, w, each scaled to length 1. Raises ValueError as `unit_quaternion`."""
    rows = np.asarray(value, dtype=np.float64)
    if rows.shape != (count, 4):
        raise ValueError(f"{name} has shape {rows.shape}; allowed is ({count}, 4), x y z w")
    length = np.sqrt((rows * rows).sum(axis=-1))
    bad = np.flatnonzero(~(np.isfinite(length) & (length >= 1e-6)))
    if len(bad):
        raise ValueError(
            f"{name} is {shown(rows[bad[0]])} in row {bad[0]}; allowed is a finite quaternion x y z w that is not zero"
        )
    return rows / length[:, None]


def turn_to(normal: Any, name: str) -> Quaternion:
    """The shortest rotation of local z onto `normal` (x, y, z).

    Raises ValueError if that is not three finite numbers, or shorter than 1e-9.
    """
    unit = _unit(normal, 3, 1e-9)
    if unit is None:
        raise ValueError(f"{name} is {shown(normal)}; allowed is a finite vector that is not zero")
    x, y, z = unit
    if z < -1.0 + 1e-12:
        return (1.0, 0.0, 0.0, 0.0)
    return unit_quaternion((-y, x, 0.0, 1.0 + z), name)


def rotate(orientation: Quaternion | np.ndarray, points: np.ndarray) -> np.ndarray:
    """Rows of `points` (N, 3) rotated by the unit quaternion x y z w, or each by its row of (N, 4), in float64."""
    turned = np.asarray(orientation)
    axis, w = turned[..., :3], turned[..., 3:]
    turn = 2.0 * np.cross(axis, points)
    return points + w * turn + np.cross(axis, turn)


def quaternion_product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Rows (k, 4) of the rotations b, then a."""
    u, v = a[:, :3], b[:, :3]
    w = a[:, 3:] * b[:, 3:] - (u * v).sum(axis=1, keepdims=True)
    ahead, behind = [1, 2, 0], [2, 0, 1]
    cross = u[:, ahead] * v[:, behind] - u[:, behind] * v[:, ahead]  # np.cross takes five times as long
    return np.hstack([a[:, 3:] * v + b[:, 3:] * u + cross, w])


def _unit(value: Any, size: int, shortest: float) -> tuple[float, ...] | None:
    """`value` (size,) scaled to length 1, None where it is not that many finite numbers or shorter than `shortest`.

    In plain numbers, as it is asked for each moving thing in each frame; to the same bits as unit_quaternions.
    """
    try:
        vector = () if isinstance(value, (str, bytes)) else tuple(map(float, value))
        length = math.sqrt(sum(each * each for each in vector))
    except (TypeError, ValueError, OverflowError):
        return None
    if len(vector) != size or not math.isfinite(length) or length < shortest:
        return None
    return tuple(each / length for each in vector)


def moved(points: np.ndarray, motion: Motion) -> np.ndarray:
    """Points (N, 3) [m] after a motion."""
    return rotate(motion[0], points) + motion[1]
