"""A sphere around the local origin; size[0] is its radius."""

import warp as wp


@wp.func
def signed_distance(p: wp.vec3, size: wp.vec3) -> wp.vec4:
    """Outward normal (x, y, z) and signed distance [m], positive outside, of local point p [m]; up at the very
    centre."""
    length = wp.length(p)
    n = wp.where(length > 1.0e-9, p / wp.max(length, 1.0e-9), wp.vec3(0.0, 0.0, 1.0))
    return wp.vec4(n[0], n[1], n[2], length - size[0])


def size(collider) -> tuple[float, float, float]:
    """(radius, 0, 0) [m]."""
    return (collider.radius, 0.0, 0.0)


def reach(collider) -> float:
    """The radius [m]."""
    return collider.radius
