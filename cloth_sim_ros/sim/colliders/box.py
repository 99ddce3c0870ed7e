# SPDX-License-Identifier: Apache-2.0
"""A box around the local origin; its size is its half extents."""

from dataclasses import dataclass

import numpy as np
import warp as wp

from cloth_sim_ros.sim.colliders.collider import Collider, Solid, lengths
from cloth_sim_ros.sim.physics.quaternion import Vector


@wp.func
def signed_distance(p: wp.vec3, size: wp.vec3) -> wp.vec4:
    """Outward normal (x, y, z) and signed distance [m], positive outside, of local point p [m].

    Outside, the nearest point of the surface; inside, the nearest face, z before y before x where they tie.
    """
    side = wp.vec3(wp.where(p[0] < 0.0, -1.0, 1.0), wp.where(p[1] < 0.0, -1.0, 1.0), wp.where(p[2] < 0.0, -1.0, 1.0))
    q = wp.vec3(wp.abs(p[0]) - size[0], wp.abs(p[1]) - size[1], wp.abs(p[2]) - size[2])
    outside = wp.vec3(wp.max(q[0], 0.0), wp.max(q[1], 0.0), wp.max(q[2], 0.0))
    distance = wp.length(outside)
    n = wp.vec3(0.0, 0.0, 0.0)
    if distance > 1.0e-9:
        n = wp.cw_mul(outside, side) / distance
    elif q[2] >= q[0] and q[2] >= q[1]:
        n = wp.vec3(0.0, 0.0, side[2])
        distance = q[2]
    elif q[1] >= q[0]:
        n = wp.vec3(0.0, side[1], 0.0)
        distance = q[1]
    else:
        n = wp.vec3(side[0], 0.0, 0.0)
        distance = q[0]
    return wp.vec4(n[0], n[1], n[2], distance)


@dataclass(frozen=True)
class Box(Collider):
    """A box of `half_extents` (x, y, z) [m] along its local axes."""

    half_extents: Vector = (0.1, 0.1, 0.1)
    dimensions = (lengths("half_extents"),)
    wholes = {"half_extents": "x y z"}
    distance = signed_distance
    edged = True

    def reach(self) -> float:
        """From the middle to a corner [m]."""
        return np.linalg.norm(self.half_extents, axis=0)

    def solids(self) -> list[Solid]:
        """The box."""
        return [Solid("box", tuple(2 * half for half in self.half_extents))]
