# SPDX-License-Identifier: Apache-2.0
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
