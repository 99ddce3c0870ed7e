# SPDX-License-Identifier: Apache-2.0
"""A cloth as a shell with two sides, checked in front, and the tones of a rope's two strands."""

from __future__ import annotations

import numpy as np
import trimesh
from scipy.sparse import csr_matrix

from cloth_sim_ros.drawing.tube import SIDES
from cloth_sim_ros.sim.input.mesh_repair import areas_of

CHECKS = 9  # approximate number along the longer edge of a cloth
_FLAT = 1e-3  # largest deviation of a flat cloth's rest shape from a plane, over its size


class Shell:
    """Both sides of a surface of `triangles` (T, 3), each `half` [m] away from it, and the hem between them."""

    def __init__(self, count: int, triangles: np.ndarray, half: float):
        self._triangles, self._half = triangles.astype(np.int64), half
        corners = self._triangles.ravel()
        ones = np.ones(len(corners), np.float32)
        self._gather = csr_matrix((ones, (corners, np.repeat(np.arange(len(triangles)), 3))), (count, len(triangles)))
        edges = self._triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
        hem = edges[trimesh.grouping.group_rows(np.sort(edges, axis=1), require_count=1)]
        a, b = hem.T
        self.front, self.back = self._triangles, self._triangles[:, ::-1] + count
        self.hem = np.concatenate([np.stack([b, a, a + count], axis=1), np.stack([b, a + count, b + count], axis=1)])

    def vertices(self, positions: np.ndarray) -> np.ndarray:
        """Return vertices (2 N, 3) [m], front and back, for particles at `positions` (N, 3) [m]."""
        a, b, c = (positions[self._triangles[:, k]] for k in range(3))
        normals = self._gather @ np.cross(b - a, c - a)
        normals *= self._half / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-20)
        return np.concatenate([positions + normals, positions - normals])


def checks(rest: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Return True for each of `triangles` (T, 3) in a dark check, by the vertices at rest (N, 3) [m].

    A flat cloth has checks of whole cells of its grid. Another one has stripes along z.
    """
    middle = rest - rest.mean(axis=0)
    axes = np.linalg.svd(middle, full_matrices=False)[2]
    size = np.ptp(middle @ axes.T, axis=0)
    if size[2] > _FLAT * size[0]:
        along = middle[:, 2:]
    else:  # along the edges of a cell, not along the diagonals of a square
        edges = middle[triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)]
        ways = edges[:, 1] - edges[:, 0]
        first = ways[np.linalg.norm(ways, axis=1).argmin()]
        first = first / np.linalg.norm(first)
        along = middle @ np.stack([first, np.cross(axes[2], first)], axis=1)
    along = along - along.min(axis=0)
    spacing = np.sqrt(np.median(areas_of(rest, triangles)) * 2.0)
    cells = np.maximum(np.round(along.max(axis=0) / spacing), 1.0)
    check = along.max(axis=0) / cells * max(round(along.max() / spacing / CHECKS), 1)
    return np.floor(along[triangles].mean(axis=1) / check).astype(int).sum(axis=1) % 2 == 1


def strands(faces: np.ndarray, count: int) -> np.ndarray:
    """Return True for each of the `faces` of a tube around `count` points that lies in the dark one of two strands."""
    ring, side = np.divmod(np.minimum(faces[:, 0], count * SIDES - 1), SIDES)
    return (ring + side) % SIDES < SIDES // 2
