# SPDX-License-Identifier: Apache-2.0
"""The grid around a closed surface: the distance of each cell's middle and, near the surface, the cell's triangles.

A cell leaves out only triangles that are provably never nearest in it. Let q be the point of a triangle nearest to the
middle of a cell, and g the direction from q to that middle. The triangle lies behind the plane through q across g, so a
point p of the cell is at least g.(p - q) from it. Another triangle with a point s is nearer in the whole cell if
|p - s| is less than that at the cell's eight corners, because the difference is convex.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp

from cloth_sim_ros.sim.colliders.mesh_distance import NUMBERS, ROWS, TREE, TRIANGLES, by_tree, nearest_on
from cloth_sim_ros.sim.input.mesh_repair import areas_of
from cloth_sim_ros.sim.kernels.compiled import compiled
from cloth_sim_ros.sim.kernels.intrinsics import load4, load_address, xyz
from cloth_sim_ros.sim.kernels.native import LANES

# Spacing of the grid over the root of the mean triangle area. A list then has about 27 triangles, and lists take 2.6 kB
# per triangle.
_SPACING = 1.2
_LEAST, _MOST = 16, 1 << 21  # minimum number of cells along the longest side, and maximum number in all
_OUTSIDE, _INSIDE = 3.0, 1.0  # distance from the surface up to which cells have lists, in spacings
_FAR = 1.0e9  # larger than all squared distances in cells
_ROUNDING = 2.0e-6  # rounding error as a fraction of the reach


@dataclass
class Grid:
    """origin (3,) and spacing [m], and how many cells it has along each axis.

    cells (N + 1, 2): of each what the signed distance of its middle is not below [m], and as an integer where its list
    begins. The lists, one after another: around (M / 8, 8, 8), flat, see NUMBERS, and names (M,), the numbers of
    triangles.
    """

    origin: np.ndarray
    spacing: float
    shape: tuple[int, ...]
    cells: np.ndarray
    around: np.ndarray
    names: np.ndarray


@wp.struct
class _Cells:
    """Where cells lie: origin and spacing [m], and how many there are along each axis."""

    origin: wp.vec3
    spacing: float
    shape: wp.vec3i


@wp.func
def _middle(cell: int, cells: _Cells) -> wp.vec3:
    """The middle of a cell [m]."""
    shape = cells.shape
    i, j, k = cell / (shape[1] * shape[2]), cell / shape[2] % shape[1], cell % shape[2]
    return cells.origin + cells.spacing * wp.vec3(float(i) + 0.5, float(j) + 0.5, float(k) + 0.5)


@compiled
def _mark(data: wp.uint64, cells: _Cells, width: float, marks: wp.array3d(dtype=wp.uint8)):
    """Mark all cells whose middle is within a width of a triangle, and some more."""
    triangles, f, shape = load_address(data + TRIANGLES), ROWS * wp.tid(), cells.shape
    a = xyz(load4(triangles, f))
    b, c = a + xyz(load4(triangles, f + 1)), a + xyz(load4(triangles, f + 2))
    low = (wp.min(wp.min(a, b), c) - cells.origin - wp.vec3(width)) / cells.spacing - wp.vec3(0.5)
    high = (wp.max(wp.max(a, b), c) - cells.origin + wp.vec3(width)) / cells.spacing - wp.vec3(0.5)
    for i in range(wp.max(int(wp.floor(low[0])), 0), wp.min(int(wp.ceil(high[0])) + 1, shape[0])):
        for j in range(wp.max(int(wp.floor(low[1])), 0), wp.min(int(wp.ceil(high[1])) + 1, shape[1])):
            for k in range(wp.max(int(wp.floor(low[2])), 0), wp.min(int(wp.ceil(high[2])) + 1, shape[2])):
                marks[i, j, k] = wp.uint8(1)


@compiled
def _measure(
    data: wp.uint64, size: wp.vec3, cells: _Cells, marked: wp.array(dtype=int), found: wp.array(dtype=wp.vec4)
):
    """The normals and signed distances of the middles of marked cells [m]."""
    found[wp.tid()] = by_tree(_middle(marked[wp.tid()], cells), size, data)


@wp.func
def _is_flat(f: int, triangles: wp.uint64) -> bool:
    """True if a triangle has no width, so that the tree leaves it out."""
    ab, ac = xyz(load4(triangles, ROWS * f + 1)), xyz(load4(triangles, ROWS * f + 2))
    return wp.length(wp.cross(ab, ac)) < 1.0e-6 * (wp.length_sq(ab) + wp.length_sq(ac) + wp.length_sq(ac - ab))


@wp.func
def _plane(f: int, middle: wp.vec3, slack: float, triangles: wp.uint64) -> wp.vec4:
    """The plane before a triangle as seen from the middle of a cell: g and g.q."""
    near = nearest_on(f, middle, triangles)
    way = middle - xyz(load4(triangles, ROWS * f)) - near[1] * xyz(load4(triangles, ROWS * f + 1))
    way -= near[2] * xyz(load4(triangles, ROWS * f + 2))
    g = xyz(load4(triangles, ROWS * f + 3))
    distance = wp.sqrt(near[0])
    if distance > slack:
        g = way / distance
    return wp.vec4(g[0], g[1], g[2], wp.dot(g, middle - way))


@wp.func
def _may_be_nearest(plane: wp.vec4, foot: wp.vec3, middle: wp.vec3, spacing: float, slack: float) -> bool:
    """True if a triangle behind a plane may be nearer than the point `foot` to a corner of a cell."""
    for corner in range(8):
        side = wp.vec3(float(corner / 4) - 0.5, float(corner / 2 % 2) - 0.5, float(corner % 2) - 0.5)
        p = middle + spacing * side
        if wp.length(p - foot) > wp.dot(xyz(plane), p) - plane[3] - slack:
            return True
    return False


@wp.func
def _ball(f: int, slack: float, triangles: wp.uint64) -> wp.vec4:
    """A ball that holds a triangle: its centre and radius."""
    ab, ac = xyz(load4(triangles, ROWS * f + 1)), xyz(load4(triangles, ROWS * f + 2))
    to = (ab + ac) / 3.0
    centre = xyz(load4(triangles, ROWS * f)) + to
    radius = wp.max(wp.length(to), wp.max(wp.length(ab - to), wp.length(ac - to)))
    return wp.vec4(centre[0], centre[1], centre[2], radius + slack)


@wp.func
def _put(plane: wp.vec4, ball: wp.vec4, f: int, place: int, around: wp.array(dtype=float), names: wp.array(dtype=int)):
    """Write an entry of a list."""
    names[place] = f
    first = place / wp.static(LANES) * wp.static(NUMBERS * LANES) + place % wp.static(LANES)
    for k in range(4):
        around[first + wp.static(LANES) * k] = plane[k]
        around[first + wp.static(LANES) * (4 + k)] = ball[k]


@wp.func
def _move(start: int, end: int, around: wp.array(dtype=float), names: wp.array(dtype=int)):
    """Write the first entry of a list, which is at `start`, to another place too."""
    lanes = wp.static(LANES)
    first, second = start / lanes * NUMBERS * lanes + start % lanes, end / lanes * NUMBERS * lanes + end % lanes
    names[end] = names[start]
    for k in range(NUMBERS):
        around[second + lanes * k] = around[first + lanes * k]


@compiled
def _list(
    data: wp.uint64,
    slack: float,
    cells: _Cells,
    marked: wp.array(dtype=int),
    nearest: wp.array(dtype=wp.vec4),
    first: wp.array(dtype=int),
    around: wp.array(dtype=float),
    names: wp.array(dtype=int),
):
    """Count the triangles that may be the nearest of a point of a cell; if there is room for names, list them from
    `first` on.

    That of the middle comes first: few others are then nearer."""
    triangles = load_address(data + TRIANGLES)
    middle, near, spacing = _middle(marked[wp.tid()], cells), nearest[wp.tid()], cells.spacing
    foot = middle - near[3] * xyz(near)
    within = wp.abs(near[3]) + 1.7321 * spacing + slack
    best = float(1.0e30)
    count = int(0)
    at = first[wp.tid()]
    query = wp.mesh_query_aabb(load_address(data + TREE), middle - wp.vec3(within), middle + wp.vec3(within))
    f = int(0)
    while wp.mesh_query_aabb_next(query, f):
        plane = _plane(f, middle, slack, triangles)
        distance = wp.dot(xyz(plane), middle) - plane[3]
        if not _is_flat(f, triangles) and distance <= within and _may_be_nearest(plane, foot, middle, spacing, slack):
            if names.shape[0] > 0:
                plane[3] += slack
                place = at + count
                if distance < best:
                    best = distance
                    _move(at, place, around, names)
                    place = at
                _put(plane, _ball(f, slack, triangles), f, place, around, names)
            count += 1
    if names.shape[0] == 0:
        first[wp.tid()] = count


@compiled
def _nearest_along(before: wp.array(dtype=float), length: int, after: wp.array(dtype=float)):
    """For each place of a line, find the least sum of a square and the squared distance to it, both in cells."""
    first = wp.tid() / length * length
    least = float(wp.static(_FAR))
    for k in range(length):
        way = float(first + k - wp.tid())
        least = wp.min(least, before[first + k] + way * way)
    after[wp.tid()] = least


def grid_of(data: int, points: np.ndarray, faces: np.ndarray, reach: float) -> Grid:
    """The grid of the surface at an address on the CPU, where tree and triangles are there."""
    device = wp.get_device("cpu")
    low, high = points.min(axis=0), points.max(axis=0)
    spacing = min(_SPACING * np.sqrt(areas_of(points, faces).sum() / len(faces)), (high - low).max() / _LEAST)
    while np.prod(np.ceil((high - low) / spacing) + 2 * _OUTSIDE) > _MOST:
        spacing *= 1.1
    width, slack = _OUTSIDE * spacing, _ROUNDING * reach
    shape = tuple(int(n) for n in np.ceil((high - low + 2 * width) / spacing))
    origin = low - width
    cells = _Cells()
    cells.origin, cells.spacing, cells.shape = wp.vec3(*origin), spacing, wp.vec3i(*shape)
    marks = wp.zeros(shape, dtype=wp.uint8, device=device)
    wp.launch(_mark, dim=len(faces), inputs=[data, cells, width, marks], device=device)
    marked = np.flatnonzero(marks.numpy()).astype(np.int32)
    of_marked = wp.empty(len(marked), dtype=wp.vec4, device=device)
    inputs = [data, wp.vec3(reach, 0.0, 0.0), cells, wp.array(marked, dtype=int, device=device), of_marked]
    wp.launch(_measure, dim=len(marked), inputs=inputs, device=device)
    found = of_marked.numpy()
    bounds = _bounds(shape, marked, found[:, 3], spacing, width)
    some = (found[:, 3] >= -_INSIDE * spacing) & (found[:, 3] <= width)
    listed, nearest = wp.array(marked[some], device=device), wp.array(found[some], dtype=wp.vec4, device=device)
    first = wp.zeros(len(listed), dtype=int, device=device)
    none, nobody = wp.empty(0, dtype=float, device=device), wp.empty(0, dtype=int, device=device)
    inputs = [data, slack, cells, listed, nearest]
    wp.launch(_list, dim=len(listed), inputs=[*inputs, first, none, nobody], device=device)
    counts = np.zeros(len(bounds) + 1, np.int32)
    counts[1 + marked[some]] = -(-first.numpy() // LANES) * LANES
    begins = np.cumsum(counts, dtype=np.int32)
    first.assign(begins[marked[some]])
    empty = np.zeros((int(begins[-1]) // LANES, NUMBERS, LANES), np.float32)
    empty[:, 3] = -1e30  # what fills up eight is far from all points
    around = wp.array(empty.ravel(), dtype=float, device=device)
    names = wp.zeros(int(begins[-1]), dtype=int, device=device)
    wp.launch(_list, dim=len(listed), inputs=[*inputs, first, around, names], device=device)
    rows = np.stack([np.append(bounds, 0.0).astype(np.float32), begins.view(np.float32)], axis=1)
    return Grid(origin, spacing, shape, rows, around.numpy(), names.numpy())


def _bounds(
    shape: tuple[int, ...], marked: np.ndarray, distances: np.ndarray, spacing: float, width: float
) -> np.ndarray:
    """Bounds that the signed distances of all middles are not below [m]; of marked cells the distances themselves.

    Another cell is on the side of the marked one before it. The nearest cell that holds surface tells how far it is:
    its middle is half a diagonal from the surface at most, and the surface half a diagonal from such a middle.
    """
    half = 0.5 * np.sqrt(3.0) * spacing
    known, squares, sides = np.zeros(shape, bool), np.full(shape, _FAR, np.float32), np.ones(shape, np.float32)
    known.ravel()[marked], sides.ravel()[marked] = True, np.copysign(1.0, distances)
    squares.ravel()[marked[np.abs(distances) <= half * (1.0 + 1e-5)]] = 0.0
    for axis in range(3):
        lines = np.moveaxis(squares, axis, 2)
        before = wp.array(lines.ravel(), dtype=float, device="cpu")
        after = wp.empty_like(before)
        wp.launch(_nearest_along, dim=before.size, inputs=[before, shape[axis], after], device="cpu")
        squares = np.moveaxis(after.numpy().reshape(lines.shape), 2, axis)
    last = np.maximum.accumulate(np.where(known, np.arange(shape[0])[:, None, None], 0), axis=0)
    away = spacing * np.sqrt(squares)
    outside = np.maximum(away * (1.0 - 1e-5) - half, width)
    bounds = np.where(np.take_along_axis(sides, last, axis=0) < 0.0, -away * (1.0 + 1e-5) - half, outside)
    bounds[known] = distances
    return bounds.astype(np.float32).ravel()
