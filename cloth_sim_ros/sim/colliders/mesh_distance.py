# SPDX-License-Identifier: Apache-2.0
"""Signed distance of a point from a closed surface of triangles, in kernels.

A grid around the surface quickly shows that most points are far. Near the surface, each cell lists the triangles that
may be nearest to some point in it. Elsewhere a tree finds the nearest triangle.
"""

import warp as wp

from cloth_sim_ros.sim.kernels.intrinsics import load4, load_address, load_int, load_number, xyz
from cloth_sim_ros.sim.kernels.native import LANES, source

# Offsets [bytes] at the address of a mesh: tree, triangles, cells of its grid, bounds and triangle numbers of all
# lists, and its width.
TREE, TRIANGLES, CELLS, BOUNDS, NAMES, WIDTH = (wp.constant(wp.uint64(8 * k)) for k in range(6))
WORDS = 6  # number of these words, even
# Rows of four numbers behind them: origin and spacing of the grid; cells along each axis, and cells per metre.
GRID, SHAPE = wp.constant(WORDS // 2), wp.constant(WORDS // 2 + 1)
# Number of rows of a triangle: its first corner a, b - a and c - a, with the products of the latter two; its unit
# normal and height; the normals of its corners; those of the edges opposite them.
ROWS = wp.constant(10)
# Bounds of a list lie LANES at a time: x, y, z and height of planes before the triangles, then x, y, z and radius of
# balls around them. Beside a plane, the ball excludes triangles that lie in one plane with the nearest.
NUMBERS = wp.constant(8)  # of a triangle's bounds


@wp.func_native(source(__file__, "next_below", LANES=LANES))
def next_below(k: int, last: int, bounds: wp.uint64, p: wp.vec3, distance: float) -> int:
    """First of entries k to `last` that may be nearer to p than `distance` [m], or `last`; a CPU tests 8 at once."""
    ...


@wp.func
def row_of(u: float, v: float) -> int:
    """Row of a triangle's normal that applies at barycentric coordinates u, v of its first two corners.

    Row 0 is the triangle's own normal.
    """
    near = 1.0e-6
    first, second, third = u <= near, v <= near, 1.0 - u - v <= near
    row = wp.where(first, 4, wp.where(second, 5, wp.where(third, 6, 0)))
    if first and second:
        row = 3
    elif first and third:
        row = 2
    elif second and third:
        row = 1
    return row


@wp.func
def nearest_on(f: int, p: wp.vec3, triangles: wp.uint64) -> wp.vec3:
    """The way from the nearest point of a triangle is p - a - v (b - a) - w (c - a): its square [m^2], v and w.

    By the regions of Ericson 2005, Real-Time Collision Detection, 5.1.5.
    """
    first, second, third = load4(triangles, ROWS * f), load4(triangles, ROWS * f + 1), load4(triangles, ROWS * f + 2)
    ab, ac, ap = xyz(second), xyz(third), p - xyz(first)
    d1, d2 = wp.dot(ab, ap), wp.dot(ac, ap)
    d3, d4 = d1 - first[3], d2 - second[3]
    d5, d6 = d1 - second[3], d2 - third[3]
    va, vb, vc = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
    v, w = float(0.0), float(0.0)
    if d1 <= 0.0 and d2 <= 0.0:
        v = 0.0
    elif d3 >= 0.0 and d4 <= d3:
        v = 1.0
    elif d6 >= 0.0 and d5 <= d6:
        w = 1.0
    elif vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        v = d1 / (d1 - d3)
    elif vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        w = d2 / (d2 - d6)
    elif va <= 0.0 and d4 >= d3 and d5 >= d6:
        w = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        v = 1.0 - w
    else:
        v = vb / (va + vb + vc)
        w = vc / (va + vb + vc)
    return wp.vec3(wp.length_sq(ap - v * ab - w * ac), v, w)


@wp.func
def signed(f: int, u: float, v: float, p: wp.vec3, reach: float, triangles: wp.uint64) -> wp.vec4:
    """Normal and signed distance [m] of p, whose nearest point lies in triangle f at u, v of its first two corners."""
    row = row_of(u, v)
    normal = load4(triangles, ROWS * f + 3 + row)
    n = xyz(normal)
    distance = wp.dot(n, p) - normal[3]
    if row > 0:
        way = p - xyz(load4(triangles, ROWS * f)) - v * xyz(load4(triangles, ROWS * f + 1))
        way -= (1.0 - u - v) * xyz(load4(triangles, ROWS * f + 2))
        distance = wp.length(way)
        side = wp.where(wp.dot(way, n) < 0.0, -1.0, 1.0)
        # Nearer than this, the vector to the surface is only rounding.
        if distance > 1.0e-5 * reach:
            n = (side / distance) * way
        distance *= side
    return wp.vec4(n[0], n[1], n[2], distance)


@wp.func
def cell_of(p: wp.vec3, data: wp.uint64) -> wp.vec4:
    """The number of the cell of the grid that is nearest to p, and its middle (x, y, z)."""
    grid, shape = load4(data, GRID), load4(data, SHAPE)
    at = wp.vec3(0.0)
    for k in range(3):
        at[k] = float(int(wp.clamp((p[k] - grid[k]) * shape[3], 0.0, shape[k] - 1.0)))
    middle = xyz(grid) + grid[3] * (at + wp.vec3(0.5))
    return wp.vec4((at[0] * shape[1] + at[1]) * shape[2] + at[2], middle[0], middle[1], middle[2])


@wp.func
def at_least(p: wp.vec3, data: wp.uint64) -> float:
    """Lower bound of the signed distance of p [m]: that of the middle of its cell, minus the distance from there.

    Beyond the grid, at b from its nearest point q, it is sqrt(b^2 + d(q)^2), as the surface lies within the grid.
    """
    found = cell_of(p, data)
    middle = wp.vec3(found[1], found[2], found[3])
    half = 0.5 * load4(data, GRID)[3]
    off = p - middle
    inside = wp.vec3(wp.clamp(off[0], -half, half), wp.clamp(off[1], -half, half), wp.clamp(off[2], -half, half))
    least = load_number(load_address(data + CELLS), 2 * int(found[0])) - wp.length(inside)
    # At the bounds of the grid it is above 0. Elsewhere what is beyond the cell is rounding.
    if least > 0.0:
        least = wp.sqrt(wp.length_sq(off - inside) + least * least)
    return least


@wp.func
def width(data: wp.uint64) -> float:
    """Twice the volume over the surface [m]; 0 if the surface is convex."""
    return load_number(data + WIDTH, 0)


@wp.func
def by_tree(p: wp.vec3, size: wp.vec3, data: wp.uint64) -> wp.vec4:
    """Outward normal (x, y, z) and signed distance [m] of p, by a search in all triangles.

    A point farther than the reach gets a smaller distance, and the direction from the origin as normal.
    """
    found = wp.mesh_query_point_no_sign(load_address(data + TREE), p, size[0])
    away = wp.length(p)
    n = p / wp.max(away, 1.0e-9)
    nearest = wp.vec4(n[0], n[1], n[2], wp.max(size[0], away - size[0]))
    if found.result:
        nearest = signed(found.face, found.u, found.v, p, size[0], load_address(data + TRIANGLES))
    return nearest


@wp.func
def signed_distance(p: wp.vec3, size: wp.vec3, data: wp.uint64) -> wp.vec4:
    """Outward normal (x, y, z) and signed distance [m], positive outside, of local point p [m].

    A point farther than the reach gets a smaller distance, and the direction from the origin as normal.
    """
    found = cell_of(p, data)
    off = p - wp.vec3(found[1], found[2], found[3])
    half = 0.5 * load4(data, GRID)[3]
    cells, cell = load_address(data + CELLS), 2 * int(found[0])
    first, last = load_int(cells, cell + 1), load_int(cells, cell + 3)
    if first == last or wp.max(wp.abs(off)) > half:
        return by_tree(p, size, data)
    bounds, names = load_address(data + BOUNDS), load_address(data + NAMES)
    triangles = load_address(data + TRIANGLES)
    face = int(0)
    nearest = wp.vec3(0.0)
    distance = float(1.0e30)
    k = next_below(first, last, bounds, p, distance)
    while k < last:
        f = load_int(names, k)
        there = nearest_on(f, p, triangles)
        if there[0] < distance * distance:
            face = f
            nearest = there
            distance = wp.sqrt(there[0])
        k = next_below(k + 1, last, bounds, p, distance)
    return signed(face, 1.0 - nearest[1] - nearest[2], nearest[1], p, size[0], triangles)
