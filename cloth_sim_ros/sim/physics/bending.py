"""Bending: the dihedral angle between two triangles of a cloth, the turn between two segments of a rope."""

import warp as wp


@wp.struct
class HingeGradients:
    """The angle [rad] of a hinge and its gradient [rad/m] at its edge i, j and the opposite vertices k, l."""

    angle: float
    i: wp.vec3
    j: wp.vec3
    k: wp.vec3
    l: wp.vec3


@wp.func
def hinge_gradients(i: wp.vec3, j: wp.vec3, k: wp.vec3, l: wp.vec3) -> HingeGradients:
    """The dihedral angle, 0 when flat, by atan2, smooth over the whole circle (Bridson, Marino, Fedkiw 2003).

    A degenerate triangle has no gradient: the hinge then does nothing.
    """
    result = HingeGradients()
    e = j - i
    n1 = wp.cross(e, k - i)
    n2 = wp.cross(l - i, e)
    length = wp.length(e)
    a1 = wp.dot(n1, n1)
    a2 = wp.dot(n2, n2)
    if a1 > 1.0e-24 and a2 > 1.0e-24 and length > 1.0e-12:
        u1 = n1 / a1
        u2 = n2 / a2
        result.k = -length * u1
        result.l = -length * u2
        result.i = -wp.dot(k - j, e) / length * u1 - wp.dot(l - j, e) / length * u2
        result.j = wp.dot(k - i, e) / length * u1 + wp.dot(l - i, e) / length * u2
        result.angle = wp.atan2(wp.dot(wp.cross(n1, n2), e) / length, wp.dot(n1, n2))
    return result


@wp.func
def wrap_angle(angle: float) -> float:
    """The angle in (-pi, pi]: a fold through pi is followed the short way."""
    return angle - 2.0 * wp.pi * wp.round(angle / (2.0 * wp.pi))


@wp.func
def rest_turn(turn: wp.vec3, rest: float) -> wp.vec3:
    """The turn vector of length `rest` that is nearest to `turn`."""
    return turn * (rest / wp.max(wp.length(turn), 1.0e-9))
