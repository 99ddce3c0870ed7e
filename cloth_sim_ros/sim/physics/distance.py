"""The distance constraint of XPBD: C = |e| - rest, a spring of constant 1/compliance; compliance 0 is rigid."""

import warp as wp


@wp.func
def direction(e: wp.vec3) -> wp.vec3:
    """The unit vector along e; a fixed one where e has no length, so that collapsed springs know where to open."""
    length = wp.length(e)
    return wp.where(length > 1.0e-12, e / wp.max(length, 1.0e-12), wp.vec3(0.0, 0.0, 1.0))


@wp.func
def elongation(e: wp.vec3, de: wp.vec3) -> float:
    """|e| - |e - de| [m]: how much longer an edge became, exactly 0 for a rigid rotation and without cancellation."""
    before = e - de
    return wp.dot(e + before, de) / wp.max(wp.length(e) + wp.length(before), 1.0e-12)


@wp.func
def spring_multiplier(c: float, slip: float, w: float, alpha: float, gamma: float, multiplier: float) -> float:
    """The change of the multiplier of one constraint (Macklin, Mueller, Chentanez 2016, eq. 18; damping eq. 26).

    c: value of the constraint [m]; slip: its change since the start of the substep [m]; w: sum of inverse masses;
    alpha: compliance / h^2; gamma: dashpot time / h; multiplier: its value so far in this substep.
    """
    divisor = (1.0 + gamma) * w + alpha
    return wp.where(divisor > 0.0, -(c + alpha * multiplier + gamma * slip) / wp.max(divisor, 1.0e-30), 0.0)
