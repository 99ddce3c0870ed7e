# SPDX-License-Identifier: Apache-2.0
"""A cylinder along local z with flat ends; its size is (radius, half length, -)."""

from dataclasses import dataclass

import numpy as np
import warp as wp

from cloth_sim_ros.sim.colliders.collider import Tube


@wp.func
def signed_distance(p: wp.vec3, size: wp.vec3) -> wp.vec4:
    """Outward normal (x, y, z) and signed distance [m], positive outside, of local point p [m]; along x on the axis."""
    across = wp.length(wp.vec2(p[0], p[1]))
    out = wp.vec3(1.0, 0.0, 0.0)
    if across > 1.0e-9:
        out = wp.vec3(p[0] / across, p[1] / across, 0.0)
    up = wp.vec3(0.0, 0.0, wp.where(p[2] < 0.0, -1.0, 1.0))
    beside = across - size[0]
    above = wp.abs(p[2]) - size[1]
    distance = wp.length(wp.vec2(wp.max(beside, 0.0), wp.max(above, 0.0)))
    n = out
    if distance > 1.0e-9:
        n = (wp.max(beside, 0.0) * out + wp.max(above, 0.0) * up) / distance
    elif above >= beside:
        n = up
        distance = above
    else:
        distance = beside
    return wp.vec4(n[0], n[1], n[2], distance)


@dataclass(frozen=True)
class Cylinder(Tube):
    """All points within `radius` [m] of local z, up to `half_length` [m] both ways."""

    distance = signed_distance
    edged = True

    def reach(self) -> float:
        """From the middle to a rim [m]."""
        return np.hypot(self.radius, self.half_length)
