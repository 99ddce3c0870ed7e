# SPDX-License-Identifier: Apache-2.0
"""Triangles of a mesh as files have them, made fit: polygons cut, vertices welded, and what has no area left out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

SHORTEST = 1e-6  # of an edge or a height, relative to the mesh: float32 cannot tell its ends apart well below


_NEAR = 1e-3  # share of the length of an edge within which a vertex lies on it


class Unfit(ValueError):
    """A mesh cannot be used; the message follows its name."""


@dataclass(frozen=True)
class Repaired:
    """A mesh without triangles that have no area, and without vertices that no triangle uses.

    points (N, 3), triangles (T, 3). place: of each vertex that there was, its number now, or -1. of (T,): numbers that
    the triangles had. told: what was done, in words that follow a name; "" where nothing was.
    """

    points: np.ndarray
    triangles: np.ndarray
    place: np.ndarray
    of: np.ndarray
    told: str


def repair(points: np.ndarray, triangles: np.ndarray, welds: bool = False) -> Repaired:
    """Remove triangles without an area from a mesh of `points` (N, 3) and `triangles` (T, 3).

    An edge of no length becomes a point. A triangle with its corners in a line stays if it holds two sides together, as
    at a vertex on the edge of a neighbour. welds: True to merge coincident vertices on open edges. Edges that are
    closed already stay as they are. So do places where welding would join more than two triangles at an edge. Raises
    Unfit if no triangle has an area.
    """
    if not len(triangles):
        raise Unfit("holds no triangles")
    size, told = float(np.ptp(points[triangles.ravel()], axis=0).max()), []
    start, end = triangles.ravel(), np.roll(triangles, -1, axis=1).ravel()
    short = np.linalg.norm(points[end] - points[start], axis=1) <= SHORTEST * size
    label = _joined(len(points), start[short], end[short])
    if welds:
        label, crowded = _welded(points, label, _distinct(label[triangles]), 1e-2 * SHORTEST * size)
        if crowded:
            edges = counted(crowded, "edge")
            told.append(f"has {edges} at which vertices in one place stay apart, as too many triangles meet there")
    of = np.flatnonzero(_is_distinct(label[triangles]))
    of = of[_carries(points, label[triangles[of]], SHORTEST * size)]
    kept = label[triangles[of]]
    if not len(kept):
        raise Unfit("has no triangle with an area")
    if len(kept) < len(triangles):
        told.append(
            f"has {len(triangles) - len(kept)} of {len(triangles)} triangles without an area, which are left out"
        )
    used = np.zeros(len(points), bool)
    used[kept] = True
    if not used.all() and not welds:
        unused = counted(np.count_nonzero(~used), "vertex", "vertices")
        told.append(f"has {unused} that no triangle needs, left out")
    number = np.where(used, np.cumsum(used) - 1, -1)
    return Repaired(points[used], number[kept].astype(np.int32), number[label], of, "; it ".join(told))


def parts_of(count: int, triangles: np.ndarray) -> np.ndarray:
    """Number (T,) from 0 of the part of each of `triangles` (T, 3) over `count` vertices: parts share no vertex."""
    label = _joined(count, triangles.ravel(), np.roll(triangles, 1, axis=1).ravel())
    return np.unique(label[triangles[:, 0]], return_inverse=True)[1].ravel()


def count_t_junctions(points: np.ndarray, triangles: np.ndarray) -> int:
    """Number of open edges of a mesh with a vertex of its border between their ends, where it comes apart."""
    from scipy.spatial import cKDTree

    edges, count, _ = edges_of(triangles, len(points))
    edges, found = edges[count == 1], 0
    places, starts, ways = points[np.unique(edges)], points[edges[:, 0]], points[edges[:, 1]] - points[edges[:, 0]]
    tree, middles, lengths = cKDTree(places), starts + 0.5 * ways, np.linalg.norm(ways, axis=1)
    radii = np.hypot(0.5 - _NEAR, _NEAR) * lengths  # of balls around all places that count, without the ends
    for k in np.flatnonzero(tree.query_ball_point(middles, radii, return_length=True)):
        beside = places[tree.query_ball_point(middles[k], radii[k])] - starts[k]
        share = beside @ ways[k] / lengths[k] ** 2
        off = np.linalg.norm(beside - share[:, None] * ways[k], axis=1)
        found += bool(((off < _NEAR * lengths[k]) & (_NEAR < share) & (share < 1.0 - _NEAR)).any())
    return found


def count_turns(triangles: np.ndarray, count: int) -> int:
    """Number of edges whose two triangles (T, 3) over `count` vertices turn opposite ways."""
    forward = np.concatenate([triangles[:, k] < triangles[:, (k + 1) % 3] for k in range(3)])
    _, number, of = edges_of(triangles, count)
    return np.count_nonzero((number == 2) & (np.bincount(of, forward) != 1.0))


def counted(number: int, one: str, more: str = "") -> str:
    """A number with its noun, such as "1 edge" or "2 edges"."""
    return f"{number} {one if number == 1 else more or one + 's'}"


def _joined(count: int, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """The lowest number (count,) that each is joined to by the pairs of `first` and `second`, over others too."""
    label = np.arange(count)
    while True:
        before, low = label.copy(), np.minimum(label[first], label[second])
        np.minimum.at(label, first, low)
        np.minimum.at(label, second, low)
        label = label[label]
        if (label == before).all():
            return label


def _is_distinct(triangles: np.ndarray) -> np.ndarray:
    """True for triangles of three distinct vertices."""
    a, b, c = triangles.T
    return (a != b) & (b != c) & (c != a)


def _distinct(triangles: np.ndarray) -> np.ndarray:
    """The triangles of three distinct vertices."""
    return triangles[_is_distinct(triangles)]


def _welded(points: np.ndarray, label: np.ndarray, triangles: np.ndarray, near: float) -> tuple[np.ndarray, int]:
    """`label` (N,), where vertices on open edges of `triangles` that are within `near` have the lowest of theirs, and
    at how many edges they have not, as more than two triangles would meet there."""
    edges, count, _ = edges_of(triangles, len(points))
    border = np.unique(edges[count == 1])
    if not len(border):
        return label, 0
    cells = np.round((points[border] - points.min(axis=0)) / near)
    order = np.lexsort(cells.T)
    begins = np.ones(len(border), bool)
    begins[1:] = (np.diff(cells[order], axis=0) != 0.0).any(axis=1)
    welded = np.arange(len(points))
    welded[border[order]] = border[order[begins]][np.cumsum(begins) - 1]
    if (count == 1).all():  # triangles without numbers in common: only places say what belongs together
        welded, crowded = _parted(welded, triangles)
        return welded[label], crowded
    joined, number, _ = edges_of(_distinct(welded[triangles]), len(points))
    crowded = joined[number > 2]
    apart = np.isin(welded, crowded)
    welded[apart] = np.flatnonzero(apart)
    return welded[label], max(0, len(crowded) - np.count_nonzero(count > 2))


def _parted(welded: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, int]:
    """`welded` (N,), where parts of `triangles` (T, 3) that touch along edges of more than two triangles have vertices
    of their own there, and how many such edges there were. Parts are joined by edges of two triangles.

    As it was, and 0, where that leaves an edge with more, or one open that was not.
    """
    triangles = triangles[_is_distinct(welded[triangles])]
    edges, count, of = edges_of(welded[triangles], len(welded))
    crowded = edges[count > 2]
    if not len(crowded):
        return welded, 0
    beside = (np.argsort(of, kind="stable") % len(triangles))[np.repeat(count == 2, count)].reshape(-1, 2)
    part = np.zeros(len(welded), int)
    part[triangles] = _joined(len(triangles), *beside.T)[:, None]
    part[~np.isin(welded, crowded)] = 0
    _, first, number = np.unique(np.stack([welded, part]), axis=1, return_index=True, return_inverse=True)
    parted = first[number.ravel()]
    _, now, _ = edges_of(parted[triangles], len(welded))
    if now.max() > 2 or np.count_nonzero(now == 1) > np.count_nonzero(count == 1):
        return welded, 0
    return parted, len(crowded)


def _carries(points: np.ndarray, triangles: np.ndarray, shortest: float) -> np.ndarray:
    """True for triangles with an area, or between two others at every edge and without a corner of their own."""
    corners = points[triangles]
    sides = np.roll(corners, -1, axis=1) - corners
    twice_area = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
    has_area = twice_area > shortest * np.linalg.norm(sides, axis=2).max(axis=1)
    if has_area.all():
        return has_area
    of_others = np.zeros(len(points), bool)
    of_others[triangles[has_area]] = True
    kept = has_area | of_others[triangles].all(axis=1)
    _, count, of = edges_of(triangles[kept], len(points))
    between = np.zeros(len(triangles), bool)
    between[kept] = (count[of] == 2).reshape(3, -1).all(axis=0)
    return has_area | between


def edges_of(triangles: np.ndarray, points: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Edges (E, 2), how many triangles each has (E,), and which are the first, second and third of all triangles."""
    ways = np.concatenate([triangles[:, [k, (k + 1) % 3]] for k in range(3)]).astype(np.int64)
    keys, of, count = np.unique(ways.min(axis=1) * points + ways.max(axis=1), return_inverse=True, return_counts=True)
    return np.stack(np.divmod(keys, points), axis=1), count, of.ravel()


def areas_of(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Areas (T,) [m^2] of `triangles` (T, 3) over `points` (N, 3) [m]."""
    a, b, c = (points[triangles[:, k]] for k in range(3))
    return 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)


def cut(points: np.ndarray, polygons: Sequence[Sequence[int]] | np.ndarray) -> np.ndarray:
    """Triangles (T, 3) of polygons, each of three corners of `points` (N, 3) or more; an array has triangles already.

    A fan from the first corner where that fills the polygon. A polygon may go to a hole and back along one line. Raises
    Unfit for one that crosses or overlaps itself, and ImportError where shapely is not there to cut one that is not
    convex.
    """
    if isinstance(polygons, np.ndarray):
        return polygons
    lengths, found = np.array([len(each) for each in polygons]), []
    for length in np.unique(lengths[lengths > 2]):
        rows = np.array([polygons[k] for k in np.flatnonzero(lengths == length)])
        fans = np.stack([rows[:, [0, k, k + 1]] for k in range(1, length - 1)], axis=1)
        corners = points[fans]
        areas = np.cross(corners[:, :, 1] - corners[:, :, 0], corners[:, :, 2] - corners[:, :, 0])
        normals = areas.sum(axis=1)
        fills = np.linalg.norm(areas, axis=2).sum(axis=1) <= (1.0 + SHORTEST) * np.linalg.norm(normals, axis=1)
        fills |= (np.einsum("pkc,pc->pk", areas, normals) > 0.0).all(axis=1)  # though it is not flat
        found.append(fans[fills].reshape(-1, 3))
        found += [
            row[_cut_flat(points[row], normal)] for row, normal in zip(rows[~fills], normals[~fills], strict=True)
        ]
    return np.concatenate(found) if found else np.zeros((0, 3), int)


def _cut_flat(corners: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Triangles (T, 3) of one polygon of `corners` (n, 3), as seen along its normal, which turn as it does."""
    import shapely

    area = 0.5 * np.linalg.norm(normal)
    if not normal.any():
        normal = np.array([0.0, 0.0, 1.0])  # it crosses itself, wherever it is seen from
    x = np.cross(np.eye(3)[np.abs(normal).argmin()], normal)
    y = np.cross(normal, x)
    flat = corners @ np.stack([x / np.linalg.norm(x), y / np.linalg.norm(y)], axis=1)
    polygon = shapely.Polygon(flat)
    if not polygon.is_valid and len(corners) == 4:
        return np.array([[0, 1, 2], [0, 2, 3]])  # a fold, which has no side to be seen from
    number = {tuple(place): k for k, place in enumerate(flat.tolist())}
    filled = shapely.make_valid(polygon)  # the way to a hole and back becomes a line
    parts = [part.exterior.coords[:3] for part in shapely.constrained_delaunay_triangles(filled).geoms]
    if abs(filled.area - area) > SHORTEST * area or not all(place in number for part in parts for place in part):
        it = f"a polygon of {len(corners)} corners that crosses or overlaps itself"
        raise Unfit(f"has {it}; allowed are those that do not")
    triangles = np.array([[number[place] for place in part] for part in parts])
    a, b, c = (flat[triangles[:, k]] for k in range(3))
    turns = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0] > 0.0
    return np.where(turns[:, None], triangles, triangles[:, ::-1])
