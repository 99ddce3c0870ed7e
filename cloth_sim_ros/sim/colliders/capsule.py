# SPDX-License-Identifier: Apache-2.0
"""A capsule along local z; its size is (radius, half length, -)."""

from dataclasses import dataclass

import warp as wp

from cloth_sim_ros.sim.colliders.collider import Solid, Tube


@wp.func
def signed_distance(p: wp.vec3, size: wp.vec3) -> wp.vec4:
    """Outward normal (x, y, z) and signed distance [m], positive outside, of local point p [m]; along x on the axis."""
    r = wp.vec3(p[0], p[1], p[2] - wp.clamp(p[2], -size[1], size[1]))
    length = wp.length(r)
    n = wp.where(length > 1.0e-9, r / wp.max(length, 1.0e-9), wp.vec3(1.0, 0.0, 0.0))
    return wp.vec4(n[0], n[1], n[2], length - size[0])


@dataclass(frozen=True)
class Capsule(Tube):
    """All points within `radius` [m] of the segment of half length `half_length` [m] along local z."""

    distance = signed_distance

    def reach(self) -> float:
        """From the middle to an end [m]."""
        return self.radius + self.half_length

    def roundness(self) -> float:
        """Its radius [m]."""
        return self.radius

    def solids(self) -> list[Solid]:
        """The cylinder and its ends."""
        tips = [(0.0, 0.0, z) for z in (-self.half_length, self.half_length)]
        return [*super().solids(), *(Solid("ball", (2 * self.radius,) * 3, tip) for tip in tips)]
