# SPDX-License-Identifier: Apache-2.0
"""The shortest edge that has a direction, and the point of a triangle nearest to the origin."""

import warp as wp

SHORTEST = wp.constant(1.0e-12)  # [m] below this an edge has no direction of its own


@wp.func
def nearest_in_triangle(a: wp.vec3, b: wp.vec3, c: wp.vec3) -> wp.vec3:
    """Return the weights of the corners in the point of a triangle nearest to the origin (Ericson 2005, 5.1.5).

    A segment has its second corner twice; the third weight is then 0.
    """
    ab, ac = b - a, c - a
    ab_a, ac_a, ab_b, ac_b, ab_c, ac_c = (
        -wp.dot(ab, a),
        -wp.dot(ac, a),
        -wp.dot(ab, b),
        -wp.dot(ac, b),
        -wp.dot(ab, c),
        -wp.dot(ac, c),
    )
    if ab_a <= 0.0 and ac_a <= 0.0:
        return wp.vec3(1.0, 0.0, 0.0)
    if ab_b >= 0.0 and ac_b <= ab_b:
        return wp.vec3(0.0, 1.0, 0.0)
    beyond_c = ab_a * ac_b - ab_b * ac_a
    if ab_a >= 0.0 and ab_b <= 0.0 and (beyond_c <= 0.0 or b == c):
        share = ab_a / wp.max(ab_a - ab_b, 1.0e-30)
        return wp.vec3(1.0 - share, share, 0.0)
    if ac_c >= 0.0 and ab_c <= ac_c:
        return wp.vec3(0.0, 0.0, 1.0)
    beyond_b = ab_c * ac_a - ab_a * ac_c
    if beyond_b <= 0.0 and ac_a >= 0.0 and ac_c <= 0.0:
        share = ac_a / wp.max(ac_a - ac_c, 1.0e-30)
        return wp.vec3(1.0 - share, 0.0, share)
    beyond_a, to_c, to_b = ab_b * ac_c - ab_c * ac_b, ac_b - ab_b, ab_c - ac_c
    if beyond_a <= 0.0 and to_c >= 0.0 and to_b >= 0.0:
        share = to_c / wp.max(to_c + to_b, 1.0e-30)
        return wp.vec3(0.0, 1.0 - share, share)
    all = wp.max(beyond_a + beyond_b + beyond_c, 1.0e-30)
    return wp.vec3(1.0 - (beyond_b + beyond_c) / all, beyond_b / all, beyond_c / all)
