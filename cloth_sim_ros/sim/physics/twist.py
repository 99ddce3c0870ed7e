# SPDX-License-Identifier: Apache-2.0
"""Twist of a discrete elastic rod (Bergou, Wardetzky, Robinson, Audoly, Grinspun 2008).

A frame carried along a rope without turning about it (Bishop's) arrives at the far end turned against the frame that is
held there. That angle m is the twist of all of it. Torsion waves are far faster than anything else, so that it is
spread evenly. The rope has the torsional moment M = GJ m / L everywhere. As the rope moves, the carried frame turns by
the change of its writhe, and so M pushes sideways wherever it is curved.
"""

import warp as wp

# Lower bound of 1 + cos at a joint; a frame cannot be carried across a joint that folds back on itself.
FOLDED = wp.constant(1.0e-2)


@wp.func
def carried_across(u: wp.vec3, before: wp.vec3, after: wp.vec3) -> wp.vec3:
    """The vector u turned as little as takes the unit tangent `before` to `after` (parallel transport)."""
    axis = wp.cross(before, after)
    cosine = wp.dot(before, after)
    along = wp.dot(axis, u) / wp.max(1.0 + cosine, FOLDED)
    return cosine * u + wp.cross(axis, u) + along * axis


@wp.func
def angle_about(t: wp.vec3, u: wp.vec3, v: wp.vec3) -> float:
    """The angle (-pi, pi] from u to v about the unit vector t [rad]."""
    return wp.atan2(wp.dot(wp.cross(u, v), t), wp.dot(u, v))


@wp.func
def small_angle_about(t: wp.vec3, u: wp.vec3, v: wp.vec3) -> float:
    """The same up to its fifth power, of a small angle between unit vectors."""
    sine = wp.dot(wp.cross(u, v), t)
    return sine * (1.0 + sine * sine / 6.0)


@wp.func
def half_binormal(before: wp.vec3, after: wp.vec3) -> wp.vec3:
    """Half of the curvature binormal of a joint, t0 x t1 / (1 + t0 . t1): its length is the tangent of half the turn.

    The twist grows by w0, w1 - w0 and -w1 times its product with the displacements of the joint's three particles.
    There w are the inverse lengths of its segments (eq. 9 of the paper, for a frame held at the far end).
    """
    return wp.cross(before, after) / wp.max(1.0 + wp.dot(before, after), FOLDED)


@wp.func
def rest_turn(along: wp.vec2, u: wp.vec3, t: wp.vec3, angle: float) -> wp.vec3:
    """The turn of a joint at rest, whose parts are along two directors.

    The first is u, turned about t by `angle` [rad]. u and t are sums of those of both segments, of any length.
    """
    first = wp.normalize(u)
    second = wp.cross(wp.normalize(t), first)
    c, s = wp.cos(angle), wp.sin(angle)
    return (along[0] * c - along[1] * s) * first + (along[0] * s + along[1] * c) * second


@wp.func
def wrap_angle(angle: float) -> float:
    """The angle in (-pi, pi]: a fold through pi is followed the short way."""
    return angle - 2.0 * wp.pi * wp.round(angle / (2.0 * wp.pi))
