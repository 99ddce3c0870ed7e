# SPDX-License-Identifier: Apache-2.0
"""Discs and strips of triangles of several kinds."""

from __future__ import annotations

import numpy as np
from scipy.spatial import Delaunay

KINDS = ("ring", "hexagonal", "delaunay")
_JITTER = 0.3  # part of the spacing by which vertices of an irregular mesh are moved


def disc(kind: str, radius: float, support: float, spacing: float) -> tuple[np.ndarray, np.ndarray]:
    """Return points (N, 2) [m] and triangles of a disc, with vertices along the edge of a round support.

    kind: rings of vertices, a hexagonal lattice, or an irregular mesh between both circles.
    """
    if kind == "ring":
        count = round(radius / spacing)
        points = np.concatenate([[(0.0, 0.0)], *(circle(radius * k / count, 6 * k) for k in range(1, count + 1))])
        return points, _sound(points)
    rows = 2 * round(radius / spacing) + 4
    x, y = (spacing * (each.ravel() - rows / 2) for each in np.meshgrid(np.arange(rows + 1), np.arange(rows + 1)))
    if kind == "hexagonal":
        points = np.column_stack([x + 0.5 * spacing * (np.round(y / spacing) % 2), np.sqrt(0.75) * y])
    else:
        points = np.column_stack([x, y]) + np.random.default_rng(0).uniform(-_JITTER, _JITTER, (len(x), 2)) * spacing
    out = np.linalg.norm(points, axis=1)
    points = points[(out < radius - 0.5 * spacing) & (np.abs(out - support) > 0.5 * spacing)]
    rims = [circle(each, round(2.0 * np.pi * each / spacing)) for each in (support, radius)]
    points = np.concatenate([points, *rims])
    return points, _sound(points)


def strip(kind: str, length: float, width: float, spacing: float) -> tuple[np.ndarray, np.ndarray]:
    """Return points (N, 2) [m] and triangles of a strip along x with straight ends.

    kind: hexagonal, irregular, or cut one way.
    """
    nx, ny = round(length / spacing), max(2, round(width / spacing))
    column, row = (each.ravel() for each in np.meshgrid(np.arange(nx + 1), np.arange(ny + 1)))
    points = np.column_stack([column * length / nx, row * width / ny])
    inside = (column > 1) & (column < nx) & (row > 0) & (row < ny)  # the first two columns are for a clamp
    if kind == "hexagonal":
        points[inside & (row % 2 == 1), 0] += 0.5 * length / nx
    elif kind == "delaunay":
        points[inside] += np.random.default_rng(1).uniform(-_JITTER, _JITTER, (inside.sum(), 2)) * spacing
    return points, _sound(points)


def circle(radius: float, count: int) -> np.ndarray:
    """Return points (count, 2) [m] on a circle around the origin."""
    angle = 2.0 * np.pi * np.arange(count) / count
    return radius * np.column_stack([np.cos(angle), np.sin(angle)])


def areas(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Return the signed areas (T,) [m^2] of triangles over points (N, 2)."""
    first, second = points[triangles[:, 1]] - points[triangles[:, 0]], points[triangles[:, 2]] - points[triangles[:, 0]]
    return 0.5 * (first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0])


def _sound(points: np.ndarray) -> np.ndarray:
    """Return Delaunay triangles of points (N, 2), without those between vertices in a row along the border."""
    triangles = Delaunay(points).simplices
    size = np.abs(areas(points, triangles))
    return triangles[size > 1e-3 * np.median(size)]
