# SPDX-License-Identifier: Apache-2.0
"""A triangle or segment in the axes of a collider: where it is deepest, and where a fast one is first touched.

The signed distance of a convex shape is convex along a line. It is searched for over a triangle as along lines from one
side to the other, by the same search in both directions.
"""

import warp as wp

from cloth_sim_ros.sim.colliders import make_signed_distance
from cloth_sim_ros.sim.intrinsics import xyz

_CUTS = 8  # evaluations between the ends of a line, at most
_NEAR = 1.0e-5  # [m] the search ends where no point of the line can be deeper by more
_ADVANCES = 16  # steps of a facet towards a collider


@wp.struct
class Facet:
    """Corners at the end of a substep and how far each came in it [m], in a collider's axes. A segment has its second
    corner twice."""

    a: wp.vec3
    b: wp.vec3
    c: wp.vec3
    slip_a: wp.vec3
    slip_b: wp.vec3
    slip_c: wp.vec3
    is_segment: bool


@wp.struct
class Line:
    """The deepest point of a line: its fraction, the signed distance there [m], and a subgradient of the distance that
    has no part along the line unless the point is an end."""

    at: float
    value: float
    gradient: wp.vec3


@wp.func
def point_of(facet: Facet, weights: wp.vec3) -> wp.vec3:
    """The point of these weights of the corners at the end of the substep."""
    return weights[0] * facet.a + weights[1] * facet.b + weights[2] * facet.c


@wp.func
def slip_at(facet: Facet, weights: wp.vec3) -> wp.vec3:
    """How far that point came in the substep [m]."""
    return weights[0] * facet.slip_a + weights[1] * facet.slip_b + weights[2] * facet.slip_c


@wp.func
def back(facet: Facet, share: float) -> Facet:
    """The facet where it was with a share of its way still to go."""
    before = facet
    before.a -= share * facet.slip_a
    before.b -= share * facet.slip_b
    before.c -= share * facet.slip_c
    return before


@wp.func
def lowest(low: wp.vec3, high: wp.vec3) -> float:
    """Where the tangents of two points (place, value, slope) meet: no value between them is below this."""
    place = (high[1] - low[1] + low[2] * low[0] - high[2] * high[0]) / (low[2] - high[2])
    return low[1] + low[2] * (place - low[0])


@wp.func
def cut(k: int, low: wp.vec3, high: wp.vec3) -> float:
    """Where to look next between two points (place, value, slope) of a convex function, downhill at `low` and uphill at
    `high`.

    Where the tangents meet (Kelley 1960), which is a corner at once; in turn with where the slope would vanish if it
    grew evenly, which is the lowest of a parabola at once.
    """
    place = (high[1] - low[1] + low[2] * low[0] - high[2] * high[0]) / (low[2] - high[2])
    if k % 2 == 1:
        place = (low[0] * high[2] - high[0] * low[2]) / (high[2] - low[2])
    return wp.clamp(place, low[0], high[0])


def make_along(shapes: tuple[str, ...]):
    """A Warp function: the point of a line that is deepest in a collider of one of `shapes`."""
    signed_distance = make_signed_distance(shapes)

    @wp.func
    def along(shape: int, size: wp.vec3, start: wp.vec3, e: wp.vec3) -> Line:
        """The deepest point of the line from `start` to `start + e`."""
        first = signed_distance(shape, start, size)
        last = signed_distance(shape, start + e, size)
        found = Line()
        found.value = first[3]
        found.gradient = xyz(first)
        low = wp.vec3(0.0, first[3], wp.dot(xyz(first), e))
        high = wp.vec3(1.0, last[3], wp.dot(xyz(last), e))
        if low[2] >= 0.0:
            return found
        if high[2] <= 0.0:
            found.at = 1.0
            found.value = last[3]
            found.gradient = xyz(last)
            return found
        n_low = xyz(first)
        n_high = xyz(last)
        if last[3] < first[3]:
            found.at = 1.0
            found.value = last[3]
        k = int(0)
        while k < wp.static(_CUTS) and found.value - lowest(low, high) > wp.static(_NEAR):
            at = cut(k, low, high)
            here = signed_distance(shape, start + at * e, size)
            slope = wp.dot(xyz(here), e)
            if here[3] < found.value:
                found.at = at
                found.value = here[3]
            if slope < 0.0:
                low = wp.vec3(at, here[3], slope)
                n_low = xyz(here)
            else:
                high = wp.vec3(at, here[3], slope)
                n_high = xyz(here)
            k += 1
        share = high[2] / wp.max(high[2] - low[2], 1.0e-20)
        found.gradient = share * n_low + (1.0 - share) * n_high
        return found

    return along


@wp.func
def slope_of(found: Line, u: float, facet: Facet) -> float:
    """How the distance of the deepest point of a row (see make_deepest) changes with its place u."""
    e = facet.b - facet.a
    if found.at >= 0.5 * (1.0 - u):  # no part along the row but at its far end, which moves along the side c-b
        e = facet.b - facet.c
    return wp.dot(found.gradient, e)


def make_deepest(shapes: tuple[str, ...]):
    """A Warp function: the weights of the corners of the point of a facet that is deepest in a collider of `shapes`."""
    signed_distance, along = make_signed_distance(shapes), make_along(shapes)

    @wp.func
    def row(shape: int, size: wp.vec3, facet: Facet, u: float) -> Line:
        """The deepest point of the line of a triangle at the share u of the way from its side a-c to b."""
        found = along(shape, size, facet.a + u * (facet.b - facet.a), (1.0 - u) * (facet.c - facet.a))
        found.at *= 1.0 - u
        return found

    @wp.func
    def deepest(shape: int, size: wp.vec3, facet: Facet) -> wp.vec3:
        if facet.is_segment:
            at = along(shape, size, facet.a, facet.b - facet.a).at
            return wp.vec3(1.0 - at, at, 0.0)
        first = row(shape, size, facet, 0.0)
        low = wp.vec3(0.0, first.value, slope_of(first, 0.0, facet))
        if low[2] >= 0.0:
            return wp.vec3(1.0 - first.at, 0.0, first.at)
        tip = signed_distance(shape, facet.b, size)
        # Uphill to the tip in both sides that meet there, or nothing of the triangle lies deeper than it.
        rise = wp.max(wp.dot(xyz(tip), facet.b - facet.a), wp.dot(xyz(tip), facet.b - facet.c))
        if rise <= 0.0:
            return wp.vec3(0.0, 1.0, 0.0)
        high = wp.vec3(1.0, tip[3], rise)
        best = wp.vec3(1.0 - first.at, 0.0, first.at)
        value = first.value
        if tip[3] < value:
            best = wp.vec3(0.0, 1.0, 0.0)
            value = tip[3]
        k = int(0)
        while k < wp.static(_CUTS) and value - lowest(low, high) > wp.static(_NEAR):
            u = cut(k, low, high)
            here = row(shape, size, facet, u)
            if here.value < value:
                best = wp.vec3(1.0 - u - here.at, u, here.at)
                value = here.value
            slope = slope_of(here, u, facet)
            if slope < 0.0:
                low = wp.vec3(u, here.value, slope)
            else:
                high = wp.vec3(u, here.value, slope)
            k += 1
        return best

    return deepest


def make_first_touched(shapes: tuple[str, ...]):
    """A Warp function: the weights of the point of a facet that a collider of `shapes` met first in the substep, or
    those of the deepest at its end where it met none.

    By conservative advancement: no point can come nearer than by its own way.
    """
    signed_distance, deepest = make_signed_distance(shapes), make_deepest(shapes)

    @wp.func
    def first_touched(shape: int, size: wp.vec3, facet: Facet, thickness: float) -> wp.vec3:
        way = wp.max(wp.length(facet.slip_a), wp.max(wp.length(facet.slip_b), wp.length(facet.slip_c)))
        left = float(1.0)
        weights = wp.vec3(0.0)
        gap = float(1.0)
        count = int(0)
        while count < wp.static(_ADVANCES) and left > 0.0 and gap > 1.0e-3 * thickness:
            before = back(facet, left)
            weights = deepest(shape, size, before)
            gap = signed_distance(shape, point_of(before, weights), size)[3] - thickness
            left -= wp.max(gap, 0.0) / wp.max(way, 1.0e-20)
            count += 1
        if left <= 0.0:
            weights = deepest(shape, size, facet)
        return weights

    return first_touched
