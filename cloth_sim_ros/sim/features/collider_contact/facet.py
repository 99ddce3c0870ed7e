# SPDX-License-Identifier: Apache-2.0
"""A triangle or segment in the axes of a collider."""

import warp as wp

from cloth_sim_ros.sim.colliders import make_signed_distance, make_width
from cloth_sim_ros.sim.kernels.intrinsics import xyz

# Displacement in a substep, as a fraction of the thickness, beyond which a facet is searched on its whole way.
FAST = wp.constant(0.5)
# Barycentric weight of a corner, above which the corner's own contact already covers the point.
CORNER = wp.constant(0.999)
_FAR = wp.constant(1.0e30)  # distance [m]


@wp.struct
class Facet:
    """Corners at the end of a substep and their displacements in it [m], in a collider's axes.

    A segment has its second corner twice.
    """

    a: wp.vec3
    b: wp.vec3
    c: wp.vec3
    slip_a: wp.vec3
    slip_b: wp.vec3
    slip_c: wp.vec3
    is_segment: bool


@wp.struct
class Deepest:
    """The deepest point of a facet: its barycentric weights, the signed distance there [m], and a plane.

    For a convex shape the distance at x is at least plane.x + c, and on the facet that is nowhere below `value`.
    """

    weights: wp.vec3
    value: float
    plane: wp.vec4


@wp.func
def tangent(p: wp.vec3, surface: wp.vec4) -> wp.vec4:
    """Return the tangent plane, a lower bound of the signed distance, from its normal and value at p."""
    n = xyz(surface)
    return wp.vec4(n[0], n[1], n[2], surface[3] - wp.dot(n, p))


@wp.func
def point_of(facet: Facet, weights: wp.vec3) -> wp.vec3:
    """Return the point with these weights of the corners at the end of the substep."""
    return weights[0] * facet.a + weights[1] * facet.b + weights[2] * facet.c


@wp.func
def slip_at(facet: Facet, weights: wp.vec3) -> wp.vec3:
    """Return the displacement of that point in the substep [m]."""
    return weights[0] * facet.slip_a + weights[1] * facet.slip_b + weights[2] * facet.slip_c


@wp.func
def back(facet: Facet, share: float) -> Facet:
    """Return the facet as it was with a `share` of its displacement still to go."""
    before = facet
    before.a -= share * facet.slip_a
    before.b -= share * facet.slip_b
    before.c -= share * facet.slip_c
    return before


@wp.func
def middle_of(facet: Facet) -> wp.vec3:
    """Return the mean of the corners; for a segment its middle."""
    if facet.is_segment:
        return 0.5 * (facet.a + facet.b)
    return (facet.a + facet.b + facet.c) / 3.0


@wp.func
def longest_way(facet: Facet) -> float:
    """Return the largest displacement of any of its points in the substep [m]."""
    return wp.max(wp.length(facet.slip_a), wp.max(wp.length(facet.slip_b), wp.length(facet.slip_c)))


@wp.func
def farthest_of(facet: Facet) -> float:
    """Return the largest distance of any of its points from middle_of(facet) in the substep [m]."""
    middle = middle_of(facet)
    farthest = wp.max(wp.length(facet.a - middle), wp.max(wp.length(facet.b - middle), wp.length(facet.c - middle)))
    return farthest + longest_way(facet)


def make_least(shapes: tuple[str, ...]):
    """Return a Warp function: a lower bound of the distance [m] of a facet to a collider of `shapes` in a substep.

    It holds at the end, and on the whole way if `swept`. The bound is the tangent plane at the middle of the facet. It
    is -1e30 for non-convex shapes.
    """
    signed_distance, width = make_signed_distance(shapes), make_width(shapes)

    @wp.func
    def least(shape: int, size: wp.vec3, data: wp.uint64, facet: Facet, swept: bool) -> float:
        if wp.static(width is not None):
            if width(shape, data) > 0.0:
                return -_FAR
        middle = middle_of(facet)
        plane = tangent(middle, signed_distance(shape, middle, size, data))
        n = xyz(plane)
        low = wp.min(wp.dot(n, facet.a), wp.min(wp.dot(n, facet.b), wp.dot(n, facet.c)))
        if swept:
            was = back(facet, 1.0)
            low = wp.min(low, wp.min(wp.dot(n, was.a), wp.min(wp.dot(n, was.b), wp.dot(n, was.c))))
        return plane[3] + low

    return least
