"""The distance constraint of XPBD: C = |e| - rest, a spring of constant 1/compliance; compliance 0 is rigid."""

import warp as wp

SHORTEST = wp.constant(1.0e-12)  # [m] below this an edge has no direction of its own


@wp.func
def opened(e: wp.vec3) -> wp.vec3:
    """The edge e, or a fixed tiny one where it has no length, so that collapsed springs know where to open."""
    return wp.where(wp.dot(e, e) < SHORTEST * SHORTEST, wp.vec3(0.0, 0.0, SHORTEST), e)


@wp.func
def elongation(e: wp.vec3, de: wp.vec3) -> float:
    """|e| - |e - de| [m]: how much longer an edge became, exactly 0 for a rigid rotation and without cancellation."""
    before = e - de
    return wp.dot(e + before, de) / wp.max(wp.length(e) + wp.length(before), SHORTEST)


@wp.func
def multiplier_change(c: float, slip: float, w: float, alpha: float, gamma: float, multiplier: float) -> wp.vec2:
    """Numerator and divisor of the change of a multiplier (Macklin, Mueller, Chentanez 2016, eq. 18; damping eq. 26).

    c: value of the constraint [m]; slip: its change since the start of the substep [m]; w: sum of inverse masses;
    alpha: compliance / h^2; gamma: dashpot time / h; multiplier: its value so far in this substep. The divisor is never
    0: where all particles are pinned and the constraint is rigid, the quotient is finite and meets inverse masses of 0.
    """
    return wp.vec2(-(c + alpha * multiplier + gamma * slip), wp.max((1.0 + gamma) * w + alpha, 1.0e-30))
