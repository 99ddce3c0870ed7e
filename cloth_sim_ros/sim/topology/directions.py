# SPDX-License-Identifier: Apache-2.0
"""Directions of the material in the triangles of a sheet."""

from __future__ import annotations

import numpy as np


def in_planes(way: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Unit vectors (T, 3): the parts of `way`, (3,) or (T, 3), in planes with unit `normals` (T, 3).

    Where a way stands on its plane, the axis that lies best in the plane takes its place.
    """
    way = np.broadcast_to(way, normals.shape)
    flat, axis = (_projected(each, normals) for each in (way, np.eye(3)[np.abs(normals).argmin(axis=1)]))
    stands = np.linalg.norm(flat, axis=1) < 1e-6 * np.linalg.norm(way, axis=1)
    flat = np.where(stands[:, None], axis, flat)
    return flat / np.linalg.norm(flat, axis=1, keepdims=True)


def _projected(way: np.ndarray, normals: np.ndarray) -> np.ndarray:
    return way - (way * normals).sum(1, keepdims=True) * normals
