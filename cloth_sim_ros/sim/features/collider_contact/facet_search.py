# SPDX-License-Identifier: Apache-2.0
"""Where a facet is deepest in a collider, and where a fast one touched it first.

A shape may have a formula for the deepest point. Else it is searched: the signed distance of a convex shape is convex,
so its tangents bound it from below (Kelley 1960).
"""

import warp as wp

from cloth_sim_ros.sim.colliders import SHAPES, make_formula, make_is_beyond, make_signed_distance, make_width
from cloth_sim_ros.sim.features.collider_contact.bundle import Bundle, next_place, opened, tightened, within_sides
from cloth_sim_ros.sim.features.collider_contact.facet import (
    CORNER,
    FAST,
    Deepest,
    Facet,
    back,
    longest_way,
    point_of,
    tangent,
)
from cloth_sim_ros.sim.features.collider_contact.sweep import NOISE
from cloth_sim_ros.sim.kernels.intrinsics import xyz

_CUTS = 8  # largest number of evaluations between the ends of a line
_TANGENTS = 16  # the same in a triangle
_EQUAL = wp.constant(1.0e-7)  # difference of depths that is rounding; then a corner counts [m]
# Steps along each side of a facet for samples in non-convex shapes. They are no wider than what these are made of.
_FEWEST, _MOST = 3, 8
_AROUND = 1.5  # size of the part of a facet around the deepest of them that is searched, in such steps
STEP = wp.constant(2.0)  # distance of these samples that matters, as a multiple of the thickness
ADVANCES = 16  # largest number of steps of a facet towards a collider


@wp.struct
class Line:
    """The deepest point of a line: its fraction, the signed distance there [m], and a plane g, c.

    For a convex shape the distance at x is at least g.x + c. This bound equals `value` along the line (Kelley 1960). So
    g has no component along the line unless the point is an end.
    """

    at: float
    value: float
    plane: wp.vec4


@wp.struct
class Touch:
    """The deepest point of a facet with a share `left` of its displacement still to go, found by some searches."""

    deepest: Deepest
    left: float
    searches: int


@wp.func
def lowest(low: wp.vec3, high: wp.vec3) -> float:
    """Return the value where the tangents of two points (place, value, slope) intersect, a bound from below."""
    place = (high[1] - low[1] + low[2] * low[0] - high[2] * high[0]) / (low[2] - high[2])
    return low[1] + low[2] * (place - low[0])


@wp.func
def cut(k: int, low: wp.vec3, high: wp.vec3) -> float:
    """Return the next place to evaluate a convex function between two points, each (place, value, slope).

    The function falls at `low` and rises at `high`. Even k give the intersection of the tangents (Kelley 1960), which
    is exact at a corner. Odd k give the zero of the linearly interpolated slope, which is exact for a parabola.
    """
    place = (high[1] - low[1] + low[2] * low[0] - high[2] * high[0]) / (low[2] - high[2])
    if k % 2 == 1:
        place = (low[0] * high[2] - high[0] * low[2]) / (high[2] - low[2])
    return wp.clamp(place, low[0], high[0])


@wp.func
def between(low: wp.vec3, high: wp.vec3, below: wp.vec4, above: wp.vec4) -> wp.vec4:
    """Return the mean of the planes of two such points that has no slope along the line."""
    share = high[2] / wp.max(high[2] - low[2], 1.0e-20)
    return share * below + (1.0 - share) * above


def make_along(shapes: tuple[str, ...]):
    """Return a Warp function: the point of a line that is deepest in a collider of one of `shapes`."""
    signed_distance = make_signed_distance(shapes)

    @wp.func
    def along(shape: int, size: wp.vec3, data: wp.uint64, start: wp.vec3, e: wp.vec3) -> Line:
        """Return the deepest point of the line from `start` to `start + e`.

        The search ends if no point can be deeper by more than NOISE. With 1e-5 m, what rests would creep or shake, as
        contact would miss it or jump along it.
        """
        first = signed_distance(shape, start, size, data)
        last = signed_distance(shape, start + e, size, data)
        found = Line()
        found.value = first[3]
        found.plane = tangent(start, first)
        low = wp.vec3(0.0, first[3], wp.dot(xyz(first), e))
        high = wp.vec3(1.0, last[3], wp.dot(xyz(last), e))
        if low[2] >= 0.0:
            return found
        below = found.plane
        above = tangent(start + e, last)
        if last[3] < first[3] or high[2] <= 0.0:
            found.at = 1.0
            found.value = last[3]
        if high[2] <= 0.0:
            found.plane = above
            return found
        k = int(0)
        while k < wp.static(_CUTS) and found.value - lowest(low, high) > NOISE:
            at = cut(k, low, high)
            ctx = signed_distance(shape, start + at * e, size, data)
            slope = wp.dot(xyz(ctx), e)
            if ctx[3] < found.value:
                found.at = at
                found.value = ctx[3]
            if slope < 0.0:
                low = wp.vec3(at, ctx[3], slope)
                below = tangent(start + at * e, ctx)
            else:
                high = wp.vec3(at, ctx[3], slope)
                above = tangent(start + at * e, ctx)
            k += 1
        found.plane = between(low, high, below, above)
        return found

    return along


def _make_line_search(shapes: tuple[str, ...]):
    along = make_along(shapes)

    @wp.func
    def search(shape: int, size: wp.vec3, data: wp.uint64, facet: Facet, thickness: float, known: wp.vec3) -> Deepest:
        line, best = along(shape, size, data, facet.a, facet.b - facet.a), Deepest()
        best.weights = wp.vec3(1.0 - line.at, line.at, 0.0)
        best.value = line.value
        best.plane = line.plane
        return best

    return search


def _make_search(shapes: tuple[str, ...]):
    signed_distance = make_signed_distance(shapes)

    @wp.func
    def search(shape: int, size: wp.vec3, data: wp.uint64, facet: Facet, thickness: float, known: wp.vec3) -> Deepest:
        best = Deepest()
        p, q = facet.b - facet.a, facet.c - facet.a
        length = wp.length(p) + wp.length(q)
        bundle, at = Bundle(), wp.vec3(1.0 / 3.0, 1.0 / 3.0, 0.0)
        best.value = 1.0e30
        k = int(0)
        while k < wp.static(_TANGENTS):
            point = facet.a + at[0] * p + at[1] * q
            surface = signed_distance(shape, point, size, data)
            weights = wp.vec3(1.0 - at[0] - at[1], at[0], at[1])
            if surface[3] < best.value + wp.where(wp.max(weights) > CORNER, _EQUAL, 0.0):
                best.weights = weights
                best.value = surface[3]
            plane = tangent(point, surface)
            row = wp.vec3(wp.dot(xyz(surface), p), wp.dot(xyz(surface), q), 1.0)
            offset = surface[3] - row[0] * at[0] - row[1] * at[1]
            if k == 0:
                bundle = opened(row, offset, at, plane, length)
            else:
                bundle = tightened(bundle, row, offset, at, plane)
            bundle = within_sides(bundle, length)
            best.plane = wp.transpose(bundle.planes) * bundle.multipliers
            error = best.value - bundle.lowest[2]
            if error <= NOISE and k > 0:
                return best
            if error <= bundle.lowest[2] - thickness:  # farther off this is enough
                best.value = bundle.lowest[2]
                return best
            at = next_place(k, bundle)
            k += 1
        return best

    return search


@wp.func
def slope_of(found: Line, u: float, facet: Facet) -> float:
    """Return the derivative of the distance of a row's deepest point (see make_deepest) by its place u."""
    e = facet.b - facet.a
    if found.at >= 0.5 * (1.0 - u):  # the plane has no slope along the row, except at its far end, which follows c-b
        e = facet.b - facet.c
    return wp.dot(xyz(found.plane), e)


def _make_row_search(shapes: tuple[str, ...]):
    """Return a Warp function that searches a triangle row by row, in lines parallel to one side.

    It takes three times as many evaluations as tangents do. In a shape that is not convex these end at once where they
    contradict one another, and a hook passed a sheet of 24 x 24.
    """
    signed_distance, along = make_signed_distance(shapes), make_along(shapes)

    @wp.func
    def row(shape: int, size: wp.vec3, data: wp.uint64, facet: Facet, u: float) -> Line:
        """Return the deepest point of the row of a triangle at the share u of the way from its side a-c to b."""
        found = along(shape, size, data, facet.a + u * (facet.b - facet.a), (1.0 - u) * (facet.c - facet.a))
        found.at *= 1.0 - u
        return found

    @wp.func
    def search(shape: int, size: wp.vec3, data: wp.uint64, facet: Facet, thickness: float, known: wp.vec3) -> Deepest:
        # One loop serves the first row and those between it and the tip, so the compiler emits the search along a row
        # once.
        u = float(0.0)
        low = wp.vec3(0.0)
        high = wp.vec3(0.0)
        below = wp.vec4(0.0)
        above = wp.vec4(0.0)
        best = Deepest()
        k = int(0)
        while k <= wp.static(_CUTS):
            ctx = row(shape, size, data, facet, u)
            slope = slope_of(ctx, u, facet)
            if k == 0 or ctx.value < best.value:
                best.weights = wp.vec3(1.0 - u - ctx.at, u, ctx.at)
                best.value = ctx.value
            if k == 0:
                best.plane = ctx.plane
                if slope >= 0.0:
                    return best
                tip = signed_distance(shape, facet.b, size, data)
                above = tangent(facet.b, tip)
                # If the distance does not rise to the tip along both sides, no point is deeper than the tip.
                rise = wp.max(wp.dot(xyz(tip), facet.b - facet.a), wp.dot(xyz(tip), facet.b - facet.c))
                if tip[3] < best.value or rise <= 0.0:
                    best.weights = wp.vec3(0.0, 1.0, 0.0)
                    best.value = tip[3]
                if rise <= 0.0:
                    best.plane = above
                    return best
                high = wp.vec3(1.0, tip[3], rise)
            if slope < 0.0:
                low = wp.vec3(u, ctx.value, slope)
                below = ctx.plane
            else:
                high = wp.vec3(u, ctx.value, slope)
                above = ctx.plane
            best.plane = between(low, high, below, above)
            if best.value - lowest(low, high) <= NOISE:
                return best
            u = cut(k, low, high)
            k += 1
        return best

    return search


def make_deepest(shapes: tuple[str, ...], segments: bool):
    """Return a Warp function: the Deepest point of a facet in a collider of `shapes`.

    A facet farther than `thickness` [m] may be told a lower bound of its distance, of at least half the way from there.
    In a non-convex shape a few samples are compared, and then the part of the facet around the deepest is searched.
    known: weights of a point that is taken instead; or 0. There, one that no sample shows within STEP thicknesses has
    weights 0. segments: True for segments, False for triangles.
    """
    width = make_width(shapes)
    search = _make_line_search(shapes) if segments else _make_search(shapes)
    search = _or_formula(search, shapes)
    if width is None:
        return search
    local = _make_line_search(shapes) if segments else _make_row_search(shapes)
    return _or_spread(search, local, shapes, width, segments)


def _or_formula(search, shapes: tuple[str, ...]):
    signed_distance, formula = make_signed_distance(shapes), make_formula(shapes)
    if formula is None:
        return search
    searched = any(SHAPES[name].deepest is None for name in shapes)

    @wp.func
    def told(shape: int, size: wp.vec3, data: wp.uint64, facet: Facet, thickness: float, known: wp.vec3) -> Deepest:
        weights = formula(shape, facet.a, facet.b, facet.c)
        if wp.static(searched):
            if wp.max(weights) == 0.0:
                return search(shape, size, data, facet, thickness, known)
        if facet.is_segment:
            weights = wp.vec3(weights[0], weights[1] + weights[2], 0.0)
        found, p = Deepest(), point_of(facet, weights)
        surface = signed_distance(shape, p, size, data)
        found.weights = weights
        found.value = surface[3]
        found.plane = tangent(p, surface)
        return found

    return told


def _or_spread(search, local_search, shapes: tuple[str, ...], width, segments: bool):
    signed_distance = make_signed_distance(shapes)
    is_beyond = make_is_beyond(shapes)

    @wp.func
    def spread(shape: int, size: wp.vec3, data: wp.uint64, facet: Facet, thickness: float, known: wp.vec3) -> Deepest:
        side = wp.max(wp.length(facet.b - facet.a), wp.max(wp.length(facet.c - facet.b), wp.length(facet.a - facet.c)))
        steps = int(wp.clamp(wp.ceil(side / width(shape, data)), wp.static(float(_FEWEST)), wp.static(float(_MOST))))
        share, apart = 1.0 / float(steps), side / float(steps)
        best = Deepest()
        best.value = STEP * thickness + apart  # farther samples need not be told apart
        is_known = wp.max(known) > 0.0
        count = wp.where(is_known, 1, (steps + 1) * wp.where(wp.static(segments), 1, steps + 1))
        k = int(0)
        while k < count:
            u, v = share * float(k / (steps + 1)), share * float(k % (steps + 1))
            k += 1
            weights = wp.where(is_known, known, wp.vec3(1.0 - u - v, u, v))
            if wp.static(segments) and not is_known:
                weights = wp.vec3(1.0 - v, v, 0.0)
            if wp.min(weights) < -1.0e-6:
                continue
            p = point_of(facet, weights)
            if wp.static(is_beyond is not None):
                if is_beyond(shape, p, best.value, data):
                    continue
            surface = signed_distance(shape, p, size, data)
            if surface[3] < best.value:
                best.weights = weights
                best.value = surface[3]
                best.plane = tangent(p, surface)
        if is_known or wp.max(best.weights) == 0.0:
            return best
        # The part around that sample is searched as if the shape were convex there.
        middle, part = best.weights, facet
        around = wp.min(wp.static(_AROUND) * share, 1.0)
        part.a = around * facet.a + (1.0 - around) * point_of(facet, middle)
        part.b = around * facet.b + (1.0 - around) * point_of(facet, middle)
        part.c = around * facet.c + (1.0 - around) * point_of(facet, middle)
        local = local_search(shape, size, data, part, thickness, known)
        if local.value < best.value:
            best = local
            best.weights = around * local.weights + (1.0 - around) * middle
        return best

    @wp.func
    def deepest(shape: int, size: wp.vec3, data: wp.uint64, facet: Facet, thickness: float, known: wp.vec3) -> Deepest:
        if width(shape, data) > 0.0:
            return spread(shape, size, data, facet, thickness, known)
        return search(shape, size, data, facet, thickness, known)

    return deepest


def make_balanced(shapes: tuple[str, ...]):
    """Return a Warp function: weights of the point at which an edge presses a triangle whose deepest point is found.

    An edge presses a whole line of a triangle. Its deepest point would jump from one end of that line to the other, and
    the triangle would rock on it for ever. So the deepest points of the sides count by the squares of their depths, and
    the deepest of all by what its square is larger.
    """
    along = make_along(shapes)

    @wp.func
    def balanced(shape: int, size: wp.vec3, data: wp.uint64, facet: Facet, found: Deepest, thickness: float) -> wp.vec3:
        sum, total, most = wp.vec3(0.0), float(0.0), float(0.0)
        for k in range(3):
            start = wp.vec3(float(k == 0), float(k == 1), float(k == 2))
            way = wp.vec3(start[2], start[0], start[1]) - start
            side = along(shape, size, data, point_of(facet, start), point_of(facet, way))
            depth = wp.max(thickness - side.value, 0.0)
            square = depth * depth
            sum += square * (start + side.at * way)
            total += square
            most = wp.max(most, square)
        deepest = thickness - found.value
        left = wp.max(deepest * deepest - most, 0.0)
        return (sum + left * found.weights) / wp.max(total + left, 1.0e-30)

    return balanced


@wp.func
def is_same_side(a: wp.vec4, b: wp.vec4) -> bool:
    """Return True if the normals of two planes of a collider are less than 60 degrees apart."""
    return wp.dot(xyz(a), xyz(b)) > 0.5 * wp.length(xyz(a)) * wp.length(xyz(b))


def make_touched(shapes: tuple[str, ...], segments: bool):
    """Return a Warp function: the point of a facet that a collider of `shapes` touched first in the substep.

    If it touched none, or moved by less than FAST times the thickness, this is the deepest point at the end. So it is
    for a segment whose line does not enter the collider: past an edge, another point is pressed than first touched.
    known: see make_deepest. off: a lower bound of its distance from the collider at the start of the substep [m].

    The search is by conservative advancement: no point comes nearer than by its own displacement.
    """
    deepest = make_deepest(shapes, segments)

    @wp.func
    def touched(
        shape: int, size: wp.vec3, data: wp.uint64, facet: Facet, thickness: float, known: wp.vec3, off: float
    ) -> Touch:
        way = longest_way(facet)
        touch, first = Touch(), Touch()
        if way > FAST * thickness:
            touch.left = wp.max(1.0 - wp.max(off - thickness, 0.0) / way, 0.0)
        gap = float(1.0)
        # The last turn is at the end of its way; one loop lets the compiler emit the search once.
        while touch.searches <= wp.static(ADVANCES) and gap > 1.0e-3 * thickness:
            touch.deepest = deepest(shape, size, data, back(facet, touch.left), thickness, known)
            gap = 0.0
            if touch.left > 0.0:
                gap = touch.deepest.value - thickness
                if gap > 1.0e-3 * thickness:
                    touch.left = wp.max(touch.left - gap / way, 0.0)
                elif wp.static(segments):
                    first = touch
                    touch.left = 0.0
                    gap = 1.0
            touch.searches += 1
        outside = touch.deepest.value > 0.0 and is_same_side(first.deepest.plane, touch.deepest.plane)
        if first.left == 0.0 or outside:
            return touch
        first.searches = touch.searches
        return first

    return touched
