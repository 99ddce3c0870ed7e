# SPDX-License-Identifier: Apache-2.0
"""A plane through the local origin with the outward normal along local z; it has no size."""

import math
from dataclasses import dataclass

import numpy as np
import warp as wp

from cloth_sim_ros.sim.colliders.collider import Collider
from cloth_sim_ros.sim.quaternion import Vector, rotate, turn_to


@dataclass(frozen=True)
class Plane(Collider):
    """The half space below the plane through `point` (or `position`) with outward `normal` in world axes."""

    point: Vector | None = None
    normal: Vector | None = None

    def __post_init__(self) -> None:
        if self.point is not None:
            object.__setattr__(self, "position", self.point)
        if self.normal is not None:
            object.__setattr__(self, "orientation", turn_to(self.normal, "Plane.normal"))
        super().__post_init__()
        object.__setattr__(self, "point", self.position)
        normal = rotate(self.orientation, np.array([[0.0, 0.0, 1.0]]))[0]
        object.__setattr__(self, "normal", tuple(normal.tolist()))

    def reach(self) -> float:
        """A plane is everywhere."""
        return math.inf

    def enters(self, gap: float, thickness: float) -> bool:
        """Never: of every triangle, a particle is deepest."""
        return False


@wp.func
def signed_distance(p: wp.vec3, size: wp.vec3) -> wp.vec4:
    """Outward normal (x, y, z) and signed distance [m], positive outside, of local point p [m]."""
    return wp.vec4(0.0, 0.0, 1.0, p[2])
