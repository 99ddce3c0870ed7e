"""The distance constraint of XPBD: C = |e| - rest, a spring of constant 1/compliance; compliance 0 is rigid."""

import warp as wp

SHORTEST = wp.constant(1.0e-12)  # [m] below this an edge has no direction of its own


@wp.func
def opening(k: int) -> wp.vec3:
    """A tiny edge in the direction that collapsed spring k opens: fixed for each spring, spread over all directions.

    One direction for all would unfold a sheet collapsed to a point into a line. Directions are those of the R3 sequence
    in a cube (Roberts 2018): no sine, because this stands in the hottest loop, where it is next to never needed.
    """
    n = float(k % 65536)
    r = wp.vec3(wp.frac(0.81917251 * n) - 0.5, wp.frac(0.67104361 * n) - 0.5, wp.frac(0.54970048 * n) - 0.5)
    return SHORTEST * r


@wp.func
def opened(e: wp.vec3, k: int) -> wp.vec3:
    """The edge e of spring k, or a tiny one where it has no length, so that collapsed springs know where to open."""
    if wp.dot(e, e) < SHORTEST * SHORTEST:
        return opening(k)
    return e


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


@wp.func_native("""
#if defined(__CUDA_ARCH__)
float y, reciprocal;
asm("rsqrt.approx.ftz.f32 %0, %1;" : "=f"(y) : "f"(square));
asm("rcp.approx.ftz.f32 %0, %1;" : "=f"(reciprocal) : "f"(divisor));  // beside the root, not after it
float root = square * y;
float length = fmaf(fmaf(-root, root, square), 0.5f * y, root);  // correctly rounded (Markstein 1990)
return wp::vec2((length + (held - rest)) * (y * reciprocal), length);
#else
float length = sqrtf(square);
return wp::vec2((length - rest + held) / (divisor * length), length);
#endif
""")
def pull_along(square: float, rest: float, held: float, divisor: float) -> wp.vec2:
    """The same quotient, its sign turned and divided by the length |e|, and that length [m].

    square: |e|^2 > 0 [m^2]; held: alpha x multiplier + gamma x slip [m]; divisor: (1 + gamma) w + alpha [1/kg] > 0.
    """
    ...
