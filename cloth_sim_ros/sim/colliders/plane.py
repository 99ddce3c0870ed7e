# SPDX-License-Identifier: Apache-2.0
"""A plane through the local origin with the outward normal along local z; it has no size."""

import math
from dataclasses import dataclass

import numpy as np
import warp as wp

from cloth_sim_ros.parameters import shown
from cloth_sim_ros.sim.colliders.collider import Collider, Solid
from cloth_sim_ros.sim.physics.quaternion import Quaternion, Vector, rotate, turn_to

WIDE = 20.0  # [m] as it is drawn
_UNBOUNDED = 1.0e30  # [m]


@wp.func
def signed_distance(p: wp.vec3, size: wp.vec3) -> wp.vec4:
    """Outward normal (x, y, z) and signed distance [m], positive outside, of local point p [m]."""
    return wp.vec4(0.0, 0.0, 1.0, p[2])


@dataclass(frozen=True)
class Plane(Collider):
    """The half space below the plane through `point` (or `position`) with outward `normal` in world axes.

    Raises ValueError if two different values are given for the same quantity.
    """

    point: Vector | None = None
    normal: Vector | None = None
    distance = signed_distance
    flat = True

    def __post_init__(self) -> None:
        point, turned = self.point, None if self.normal is None else turn_to(self.normal, "Plane.normal")
        if point is not None and any(self.position):
            self._same("position", self.position, "point", point)
        if turned is not None and any(self.orientation[:3]):
            self._same("orientation", _up(self.orientation), "normal", _up(turned))
            turned = None
        object.__setattr__(self, "position", self.position if point is None else point)
        object.__setattr__(self, "orientation", self.orientation if turned is None else turned)
        super().__post_init__()
        object.__setattr__(self, "point", self.position)
        object.__setattr__(self, "normal", tuple(_up(self.orientation).tolist()))

    def _same(self, name: str, value: np.ndarray, other: str, wanted: np.ndarray) -> None:
        """Raise ValueError if two fields for the same quantity differ."""
        if not np.allclose(value, wanted, atol=1e-6):
            one, two = (shown(getattr(self, each)) for each in (name, other))
            raise ValueError(f"Plane.{name} is {one} beside the {other} {two}; allowed is one of both")

    def reach(self) -> float:
        """A plane has no bounds. A saved state holds finite numbers alone."""
        return _UNBOUNDED

    def roundness(self) -> float:
        """A plane is flat, so the deepest point of every triangle is a particle."""
        return math.inf

    def solids(self) -> list[Solid]:
        """A wide plate below it."""
        return [Solid("box", (WIDE, WIDE, 0.01), (0.0, 0.0, -0.005))]


def _up(orientation: Quaternion) -> np.ndarray:
    """The normal of a plane with this orientation."""
    return rotate(np.asarray(orientation, dtype=np.float64), np.array([[0.0, 0.0, 1.0]]))[0]
