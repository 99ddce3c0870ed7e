# SPDX-License-Identifier: Apache-2.0
"""A sphere around the local origin; the first number of its size is its radius."""

from dataclasses import dataclass

import warp as wp

from cloth_sim_ros.sim.colliders.collider import Collider, Solid, length
from cloth_sim_ros.sim.physics.distance import nearest_in_triangle


@wp.func
def signed_distance(p: wp.vec3, size: wp.vec3) -> wp.vec4:
    """Outward normal (x, y, z) and signed distance [m], positive outside, of local point p [m]; up at the very
    centre."""
    length = wp.length(p)
    n = wp.where(length > 1.0e-9, p / wp.max(length, 1.0e-9), wp.vec3(0.0, 0.0, 1.0))
    return wp.vec4(n[0], n[1], n[2], length - size[0])


@dataclass(frozen=True)
class Sphere(Collider):
    """A ball of `radius` [m]."""

    radius: float = 0.2
    dimensions = (length("radius"),)
    distance = signed_distance
    deepest = nearest_in_triangle

    def reach(self) -> float:
        """The radius [m]."""
        return self.radius

    def roundness(self) -> float:
        """Its radius [m]."""
        return self.radius

    def solids(self) -> list[Solid]:
        """The ball."""
        return [Solid("ball", (2 * self.radius,) * 3)]
