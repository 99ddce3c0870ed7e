# SPDX-License-Identifier: Apache-2.0
"""The lowest point over a triangle that tangents of a convex function allow (Kelley 1960), by a dual simplex method."""

import warp as wp

_PARALLEL = wp.constant(1.0e-6)  # least share of a constraint in another that may take its place
_Planes = wp.types.matrix(shape=(3, 4), dtype=float)


@wp.struct
class Bundle:
    """Three constraints on (u, v, distance) over a triangle, met exactly at the lowest point that they allow.

    u, v: weights of its second and third corner. A constraint is a u + b v + offset <= s distance, with the row (a, b,
    s). It is a tangent with s = 1, taken at a `place` (u, v), with its plane in space; or a side of the triangle with
    s = 0. lowest: that point, whose distance [m] is a lower bound. multipliers: shares of the constraints in it, none
    negative; those of tangents have the sum 1.
    """

    rows: wp.mat33
    offsets: wp.vec3
    places: wp.mat33
    planes: _Planes
    lowest: wp.vec3
    multipliers: wp.vec3


@wp.func
def solved(bundle: Bundle) -> Bundle:
    """Return the bundle with its lowest point and multipliers."""
    inverse, now = wp.inverse(bundle.rows), bundle
    found = inverse * bundle.offsets
    now.lowest = wp.vec3(-found[0], -found[1], found[2])
    now.multipliers = inverse[2]
    return now


@wp.func
def side_row(k: int, length: float) -> wp.vec3:
    """Return the row of a side of the triangle, times a length [m]: u >= 0, v >= 0 or u + v <= 1."""
    if k == 2:
        return wp.vec3(length, length, 0.0)
    return wp.vec3(-length * float(k == 0), -length * float(k == 1), 0.0)


@wp.func
def opened(row: wp.vec3, offset: float, place: wp.vec3, plane: wp.vec4, length: float) -> Bundle:
    """Return the bundle of one tangent and the two sides that meet where it is lowest."""
    bundle, sides = Bundle(), wp.vec2i(0, 1)
    if wp.min(row[0], row[1]) < 0.0:
        sides = wp.where(row[0] < row[1], wp.vec2i(1, 2), wp.vec2i(0, 2))
    first, second = side_row(sides[0], length), side_row(sides[1], length)
    bundle.rows = wp.matrix_from_rows(row, first, second)
    bundle.offsets = wp.vec3(offset, 0.0, -length * float(sides[1] == 2))
    bundle.places[0] = place
    bundle.planes[0] = plane
    return solved(bundle)


@wp.func
def tightened(bundle: Bundle, row: wp.vec3, offset: float, place: wp.vec3, plane: wp.vec4) -> Bundle:
    """Return the bundle with a constraint in place of one of its own, if its lowest point breaks it (dual simplex)."""
    if wp.dot(row, wp.vec3(bundle.lowest[0], bundle.lowest[1], -bundle.lowest[2])) + offset <= 0.0:
        return bundle
    ratios = wp.transpose(wp.inverse(bundle.rows)) * row
    least, leaves = float(1.0e30), int(-1)
    for i in range(3):
        if ratios[i] > _PARALLEL and bundle.multipliers[i] < least * ratios[i]:
            least = bundle.multipliers[i] / ratios[i]
            leaves = i
    now = bundle
    for i in range(3):
        if i == leaves:
            now.rows[i] = row
            now.offsets[i] = offset
            now.places[i] = place
            now.planes[i] = plane
    return solved(now)


@wp.func
def within_sides(bundle: Bundle, length: float) -> Bundle:
    """Return the bundle with its lowest point in the triangle."""
    now = bundle
    for _k in range(3):
        u, v = now.lowest[0], now.lowest[1]
        beyond = wp.max(wp.max(-u, -v), u + v - 1.0)
        if beyond > 1.0e-6:
            side = wp.where(beyond == -u, 0, wp.where(beyond == -v, 1, 2))
            none, offset = wp.vec3(0.0), -length * float(side == 2)
            now = tightened(now, side_row(side, length), offset, none, wp.vec4(0.0))
    return now


@wp.func
def next_place(k: int, bundle: Bundle) -> wp.vec3:
    """Return where to evaluate next: the lowest point, which is exact where planes meet.

    For odd k it is where the slopes between the tangents' places, interpolated linearly, are 0. That is exact for a
    parabola.
    """
    at = wp.vec3(bundle.lowest[0], bundle.lowest[1], 0.0)
    if k % 2 == 1 and wp.min(wp.min(bundle.rows[0, 2], bundle.rows[1, 2]), bundle.rows[2, 2]) > 0.0:
        at = wp.transpose(bundle.places) * bundle.multipliers
    u, v = wp.max(at[0], 0.0), wp.max(at[1], 0.0)
    return wp.vec3(u, v, 0.0) / wp.max(u + v, 1.0)
