# SPDX-License-Identifier: Apache-2.0
"""The triangles of a sheet at rest, each in its own plane, and what lies beyond their edges.

All arrays (T, 3) of edges hold at [t, c] the edge of triangle t opposite its corner c.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

_SLIVER = 1e-3  # least height of a triangle over its longest edge; across thinner ones the sheet is hinged
NEXT, LAST = [1, 2, 0], [2, 0, 1]  # the corners after and before each corner


@dataclass(frozen=True)
class Mesh:
    """Triangles at rest, each in its own plane, and their neighbours.

    triangles (T, 3). area (T,) [m^2], normal (T, 3). along, out (T, 3, 2): unit vectors of an edge and its outward
    normal, in axes of the triangle along the warp and across. length, height (T, 3) [m]: of edge and corner. foot (T,
    3): where the height meets the edge, 0 at its start, 1 at its end. twin (T, 3): the same edge of the neighbour as
    3 t + c, itself on a border. turned (T, 3): whether the neighbour runs along that edge in the other direction, as in
    a mesh of one orientation. bends (T, 3): whether the triangle bends at an edge; clamped (T, 3): whether the
    neighbour there is a clamp.
    """

    triangles: np.ndarray
    area: np.ndarray
    normal: np.ndarray
    along: np.ndarray
    out: np.ndarray
    length: np.ndarray
    height: np.ndarray
    foot: np.ndarray
    derived: np.ndarray
    turned: np.ndarray
    bends: np.ndarray
    clamped: np.ndarray

    @classmethod
    def of(cls, points: np.ndarray, triangles: np.ndarray, pinned: np.ndarray, warp: np.ndarray) -> Mesh:
        """The mesh of points (N, 3) [m], triangles (T, 3) with at most two at an edge, and pinned (N,).

        warp: (3,) or (T, 3), of which the part in a triangle's plane counts.
        """
        corners = points[triangles]
        edge = corners[:, LAST] - corners[:, NEXT]
        length = np.linalg.norm(edge, axis=2)
        normal = np.cross(edge[:, 2], -edge[:, 1])
        double = np.linalg.norm(normal, axis=1)
        longest = length.max(axis=1)
        sound = double > _SLIVER * longest**2
        length = np.where(sound[:, None], length, 1.0)
        double = np.where(sound, double, 1.0)
        unit = edge / length[:, :, None]
        normal = normal / double[:, None]
        x = in_planes(warp, normal)
        y = np.cross(normal, x)
        along = np.stack([(unit * x[:, None]).sum(2), (unit * y[:, None]).sum(2)], axis=2)
        out = np.stack([along[:, :, 1], -along[:, :, 0]], axis=2)
        foot = ((corners - corners[:, NEXT]) * unit).sum(2) / length
        derived = _twins(triangles, len(points))
        start, other = triangles[:, NEXT], triangles[:, NEXT].ravel()[derived]
        inner = derived != np.arange(derived.size).reshape(-1, 3)
        there = derived // 3
        clamp = pinned[triangles].all(axis=1)
        bends = inner & (sound & ~clamp)[:, None] & sound[there]
        return cls(
            triangles,
            0.5 * double,
            normal,
            along,
            out,
            length,
            double[:, None] / length,
            foot,
            derived,
            start != other,
            bends,
            bends & clamp[there],
        )

    def beyond(self, values: np.ndarray) -> np.ndarray:
        """Values of the neighbours at the edges, from `values` (T, 3, ...)."""
        return values.reshape(-1, *values.shape[2:])[self.derived]


def _twins(triangles: np.ndarray, count: int) -> np.ndarray:
    """The same edge of the neighbouring triangle (T, 3) as 3 t + c; the edge itself on a border."""
    ends = np.sort(np.stack([triangles[:, NEXT], triangles[:, LAST]], axis=2).reshape(-1, 2).astype(np.int64), axis=1)
    key = ends[:, 0] * count + ends[:, 1]
    order = np.argsort(key, kind="stable")
    pair = np.flatnonzero(key[order[1:]] == key[order[:-1]])
    derived = np.arange(len(key))
    derived[order[pair]], derived[order[pair + 1]] = order[pair + 1], order[pair]
    return derived.reshape(-1, 3)


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
