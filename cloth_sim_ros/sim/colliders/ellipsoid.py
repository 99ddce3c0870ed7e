# SPDX-License-Identifier: Apache-2.0
"""An ellipsoid around the local origin; its size is its radii."""

from dataclasses import dataclass

import numpy as np
import warp as wp

from cloth_sim_ros.sim.colliders.collider import Collider, Solid, lengths
from cloth_sim_ros.sim.physics.quaternion import Vector


@wp.func
def signed_distance(p: wp.vec3, size: wp.vec3) -> wp.vec4:
    """Outward normal (x, y, z) and signed distance [m], positive outside, of local point p [m].

    The nearest point q has q_i = s_i^2 p_i / (t + s_i^2) for radii s (Eberly 2013, Distance from a point to an
    ellipsoid). With u_i = q_i / s_i, Newton's method solves 1 / |u| = 1 for t, which is nearly linear and concave: from
    anywhere it lands below, and never overshoots from there (More and Sorensen 1983). It starts at the surface, where
    cloth is, and stops where another step would move it by less than its rounding.
    """
    scale = wp.max(size[0], wp.max(size[1], size[2]))
    s = size / scale
    y = wp.vec3(wp.abs(p[0]), wp.abs(p[1]), wp.abs(p[2])) / scale
    y = wp.vec3(wp.max(y[0], 1.0e-6 * s[0]), wp.max(y[1], 1.0e-6 * s[1]), wp.max(y[2], 1.0e-6 * s[2]))
    # Solve for t + least, the distance from the pole, which would else be the difference of two large numbers.
    least = wp.min(s[0] * s[0], wp.min(s[1] * s[1], s[2] * s[2]))
    above = wp.vec3(s[0] * s[0] - least, s[1] * s[1] - least, s[2] * s[2] - least)
    lowest = wp.max(s[0] * y[0] - above[0], wp.max(s[1] * y[1] - above[1], s[2] * y[2] - above[2]))
    t = wp.max(lowest, least)
    for _ in range(9):
        square = float(0.0)
        slope = float(0.0)
        for k in range(3):
            inverse = 1.0 / wp.max(t + above[k], 1.0e-12)
            part = (s[k] * y[k] * inverse) * (s[k] * y[k] * inverse)
            square += part
            slope += part * inverse
        step = square * (wp.sqrt(square) - 1.0) / wp.max(slope, 1.0e-12)
        t = wp.max(t + step, lowest)
        if wp.abs(step) < 1.0e-4 * t:  # convergence is quadratic
            break
    q = wp.vec3(0.0)
    n = wp.vec3(0.0)
    for k in range(3):
        q[k] = s[k] * s[k] * y[k] / wp.max(t + above[k], 1.0e-12)
        n[k] = wp.where(p[k] < 0.0, -1.0, 1.0) * q[k] / (s[k] * s[k])
    n = wp.normalize(n)
    distance = wp.where(t < least, -1.0, 1.0) * wp.length(y - q) * scale
    return wp.vec4(n[0], n[1], n[2], distance)


@dataclass(frozen=True)
class Ellipsoid(Collider):
    """An ellipsoid of `radii` (x, y, z) [m] along its local axes."""

    radii: Vector = (0.2, 0.1, 0.1)
    dimensions = (lengths("radii"),)
    wholes = {"radii": "diameters x y z"}
    distance = signed_distance
    cost = 5

    def reach(self) -> float:
        """The largest radius [m]."""
        return np.max(self.radii, axis=0)

    def roundness(self) -> float:
        """At the tips of the longest axis [m]."""
        return np.min(self.radii, axis=0) ** 2 / np.max(self.radii, axis=0)

    def solids(self) -> list[Solid]:
        """The ellipsoid."""
        return [Solid("ball", tuple(2 * radius for radius in self.radii))]
