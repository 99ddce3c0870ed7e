# SPDX-License-Identifier: Apache-2.0
"""Drag and lift of a triangle or a rope's segment in relative wind."""

import warp as wp


@wp.func
def triangle_force(
    a: wp.vec3, b: wp.vec3, c: wp.vec3, relative: wp.vec3, density: float, drag: float, lift: float
) -> wp.vec4:
    """Force (x, y, z) [N] on a triangle in air of velocity `relative` [m/s], and its drag rate [N s/m] as fourth.

    Separated flow past a plate at the incidence alpha, the angle between flow and surface, sin alpha = v.n / |v|:

        C_D = drag |sin^3 alpha|,  C_L = lift |sin alpha| sin 2 alpha
        F = 1/2 rho A |v.n| (v.n) ((drag - 2 lift) (v.n) v / |v|^2 + 2 lift n).

    With lift = drag / 2 this is pressure along n by the part of the flow across the surface, as of a cylinder. It is
    the cross-flow principle (Hoerner 1965, Fluid-Dynamic Drag); Polhamus 1966, NASA TN D-3767, has the same powers.
    `drag` is C_D across the flow, 1.17 of a square plate (Hoerner). Attached flow adds a lift linear in alpha, which
    depends on the outline of the whole sheet; a triangle does not know it. Skin friction, C_D about 0.01, is left out.
    Force and slope vanish edge-on, and F.v = 1/2 rho A drag |v.n|^3 is never negative.
    An implicit step with this rate never carries the triangle beyond the wind, with lift <= drag.
    """
    doubled = wp.cross(b - a, c - a)
    n = wp.normalize(doubled)
    along = wp.normalize(relative)
    sine = wp.dot(along, n)
    across = wp.dot(relative, n)
    size = 0.25 * density * wp.length(doubled) * wp.abs(across)
    force = size * across * ((drag - 2.0 * lift) * sine * along + 2.0 * lift * n)
    return wp.vec4(force[0], force[1], force[2], size * wp.max(drag, 2.0 * lift))


@wp.func
def segment_force(a: wp.vec3, b: wp.vec3, radius: float, relative: wp.vec3, density: float, drag: float) -> wp.vec4:
    """Force [N] and drag rate [N s/m] of a cylinder in air of velocity `relative` [m/s].

    Cross-flow principle: the part v_n of the flow across the axis alone counts, F = 1/2 rho Cd 2 r L |v_n| v_n. That is
    C_D = Cd sin^3 and C_L = Cd sin^2 cos of the incidence (Hoerner 1965, Fluid-Dynamic Drag).
    """
    axis = b - a
    t = wp.normalize(axis)
    across = relative - wp.dot(relative, t) * t
    rate = 0.5 * density * drag * 2.0 * radius * wp.length(axis) * wp.length(across)
    return wp.vec4(rate * across[0], rate * across[1], rate * across[2], rate)
