"""A plane through the local origin with the outward normal along local z."""

import math

import warp as wp


@wp.func
def signed_distance(p: wp.vec3, size: wp.vec3) -> wp.vec4:
    """Outward normal (x, y, z) and signed distance [m], positive outside, of local point p [m]."""
    return wp.vec4(0.0, 0.0, 1.0, p[2])


def size(collider) -> tuple[float, float, float]:
    """A plane has no size."""
    return (0.0, 0.0, 0.0)


def reach(collider) -> float:
    """A plane is everywhere."""
    return math.inf
