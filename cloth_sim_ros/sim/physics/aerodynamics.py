"""Drag and lift of a triangle or a rope's segment in relative wind."""

import warp as wp


@wp.func
def triangle_force(
    a: wp.vec3, b: wp.vec3, c: wp.vec3, relative: wp.vec3, density: float, drag: float, lift: float
) -> wp.vec4:
    """Force (x, y, z) [N] on a triangle in air of velocity `relative` [m/s], and its drag rate [N s/m] as fourth.

    F = 1/2 rho A ((Cd - Cl) |v.n| v + Cl |v|^2 sign(v.n) n) (Ling 2000; Wilson et al. 2014). The rate bounds the slope
    of F along v, so that an implicit step never carries the triangle beyond the wind.
    """
    doubled = wp.cross(b - a, c - a)
    area = 0.5 * wp.length(doubled)
    n = wp.normalize(doubled)
    speed = wp.length(relative)
    across = wp.dot(relative, n)
    factor = 0.5 * density * area
    force = factor * ((drag - lift) * wp.abs(across) * relative + lift * speed * speed * wp.sign(across) * n)
    if across == 0.0:
        force = wp.vec3(0.0)
    return wp.vec4(force[0], force[1], force[2], factor * wp.max(drag, lift) * speed)


@wp.func
def segment_force(a: wp.vec3, b: wp.vec3, radius: float, relative: wp.vec3, density: float, drag: float) -> wp.vec4:
    """Force [N] and drag rate [N s/m] of a cylinder across the flow: 1/2 rho Cd 2 r L |v_n| v_n (Hoerner 1965)."""
    axis = b - a
    t = wp.normalize(axis)
    across = relative - wp.dot(relative, t) * t
    rate = 0.5 * density * drag * 2.0 * radius * wp.length(axis) * wp.length(across)
    return wp.vec4(rate * across[0], rate * across[1], rate * across[2], rate)
