# SPDX-License-Identifier: Apache-2.0
"""Nearest points of two parts of surfaces, and a test for crossing."""

import warp as wp

_ANYWHERE = wp.constant(1.0e-6)  # fraction of an edge; nearer to an end, the test of that corner takes over


@wp.func
def weights_at(p: wp.vec3, a: wp.vec3, b: wp.vec3, c: wp.vec3) -> wp.vec3:
    """Return the weights of corners a, b, c of the point of a triangle nearest to p (Ericson 2005, sec. 5.1.5)."""
    ab = b - a
    ac = c - a
    d1 = wp.dot(ab, p - a)
    d2 = wp.dot(ac, p - a)
    d3 = wp.dot(ab, p - b)
    d4 = wp.dot(ac, p - b)
    d5 = wp.dot(ab, p - c)
    d6 = wp.dot(ac, p - c)
    va = d3 * d6 - d5 * d4
    vb = d5 * d2 - d1 * d6
    vc = d1 * d4 - d3 * d2
    if d1 <= 0.0 and d2 <= 0.0:
        return wp.vec3(1.0, 0.0, 0.0)
    if d3 >= 0.0 and d4 <= d3:
        return wp.vec3(0.0, 1.0, 0.0)
    if d6 >= 0.0 and d5 <= d6:
        return wp.vec3(0.0, 0.0, 1.0)
    if vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        return wp.vec3(1.0 - d1 / (d1 - d3), d1 / (d1 - d3), 0.0)
    if vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        return wp.vec3(1.0 - d2 / (d2 - d6), 0.0, d2 / (d2 - d6))
    if va <= 0.0 and d4 >= d3 and d5 >= d6:
        share = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        return wp.vec3(0.0, 1.0 - share, share)
    return wp.vec3(va, vb, vc) / (va + vb + vc)


@wp.struct
class Nearest:
    """Two nearest points: the weights of four particles in their difference.

    inside: True if both points lie inside their parts, so that no other pair covers them.
    """

    weights: wp.vec4
    inside: bool


@wp.func
def nearest(is_corner: bool, a: wp.vec3, b: wp.vec3, c: wp.vec3, d: wp.vec3) -> Nearest:
    """Return the nearest points of a corner a and a triangle b c d, or of two edges a b and c d."""
    m = Nearest()
    m.inside = True
    if is_corner:
        w = weights_at(a, b, c, d)
        m.weights = wp.vec4(1.0, -w[0], -w[1], -w[2])
    else:
        near = wp.closest_point_edge_edge(a, b, c, d, 1.0e-9)
        m.weights = wp.vec4(1.0 - near[0], near[0], near[1] - 1.0, -near[1])
        m.inside = wp.min(wp.min(near[0], 1.0 - near[0]), wp.min(near[1], 1.0 - near[1])) > _ANYWHERE
    return m


@wp.func
def crosses(p: wp.vec3, q: wp.vec3, a: wp.vec3, b: wp.vec3, c: wp.vec3) -> bool:
    """Return True if the segment p q goes through the triangle a b c."""
    n = wp.cross(b - a, c - a)
    from_p, from_q = wp.dot(n, p - a), wp.dot(n, q - a)
    if from_p * from_q >= 0.0:
        return False
    x = p + (from_p / (from_p - from_q)) * (q - p)
    u = wp.dot(n, wp.cross(b - a, x - a))
    v = wp.dot(n, wp.cross(c - b, x - b))
    w = wp.dot(n, wp.cross(a - c, x - c))
    return (u > 0.0 and v > 0.0 and w > 0.0) or (u < 0.0 and v < 0.0 and w < 0.0)
