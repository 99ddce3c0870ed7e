# SPDX-License-Identifier: Apache-2.0
"""What the colliders of a scene share. A shape's own description lies beside its distance, in the file of the shape."""

from __future__ import annotations

import copy
import dataclasses
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import warp as wp

from cloth_sim_ros import parameters as table
from cloth_sim_ros.sim.input.checks import check_fields
from cloth_sim_ros.sim.physics.quaternion import Quaternion, Vector

STRETCHED = 1.62  # how much wider gaps between particles may become than they are at rest
FASTEST = 20.0  # [m/s] at which none may come through between particles that it touches
_DIMENSIONS = table.row(table.COLLIDER, "dimensions")


@dataclass(frozen=True, kw_only=True)
class Collider:
    """A pose, Coulomb coefficients and a compliance; a pair's friction is the geometric mean of its two sides.

    compliance [m/N]: how deep a point of contact lies in it for the force there; 0 is rigid. What two colliders squeeze
    has a force only where they are not rigid.

    A shape adds its lengths as fields, their rows in `dimensions`, and `reach()`, from its origin to the farthest of it
    [m]. That and `roundness()` take numbers or, for as many sizes, arrays (k,) in their place. A shape that needs more
    than three numbers gives `data` and its own `size()` too; its rows are not live then.
    `convex`: whether its signed distance is convex along every line. Raises ValueError for what cannot be.
    """

    position: Vector = (0.0, 0.0, 0.0)
    orientation: Quaternion = (0.0, 0.0, 0.0, 1.0)
    static_friction: float = 0.5
    kinetic_friction: float = 0.4
    compliance: float = 0.0
    dimensions: ClassVar[tuple[table.Parameter, ...]] = ()
    convex: ClassVar[bool] = True

    def __post_init__(self) -> None:
        check_fields(self, (*table.COLLIDER, *self.dimensions))

    def size(self) -> tuple[float, ...]:
        """What its `signed_distance` takes as size (3,) [m]: its dimensions one after another, then 0."""
        values = [getattr(self, row.name) for row in self.dimensions]
        numbers = [number for value in values for number in (value if isinstance(value, tuple) else (value,))]
        return (*numbers, 0.0, 0.0, 0.0)[:3]

    def place_in_size(self, name: str) -> int | slice:
        """Where the dimension called `name` lies in `size()`."""
        first = 0
        for row in self.dimensions:
            if row.name == name:
                return slice(first, first + row.length) if row.length else first
            first += row.length or 1
        raise KeyError(name)

    def resized(self, size: np.ndarray) -> Collider:
        """The same of another size (3,) [m], which has been checked; of many (k, 3) with arrays for numbers."""
        other = copy.copy(self)
        for row in self.dimensions:
            place = self.place_in_size(row.name)
            value = tuple(size.T[place]) if isinstance(place, slice) else size.T[place]
            object.__setattr__(other, row.name, value)
        return other

    def roundness(self) -> float:
        """The smallest radius of curvature of its surface [m]; 0 of what has edges."""
        return 0.0

    def enters(self, gap: float, thickness: float) -> bool:
        """Whether it can come through between particles that it touches at `thickness` [m] at the nearest.

        gap: the farthest that a point between them lies from the nearest of them [m]. In a sheet that lies on a sphere
        of radius R, such a point is sqrt((R + thickness)^2 - gap^2) from its middle.
        """
        return (STRETCHED * gap) ** 2 > thickness**2 + 2.0 * thickness * self.roundness()

    def data(self, device: wp.Device) -> Any:
        """What its `signed_distance` reads on a device beside the size; None for nothing.

        An object whose `id` is the address that the function takes as third argument. Who asked keeps it alive.
        """
        return None


def length(name: str) -> table.Parameter:
    """The row of a length [m] of a shape, which is live."""
    return dataclasses.replace(_DIMENSIONS, name=name, kind="double", live=True)


@dataclass(frozen=True)
class Tube(Collider):
    """What has a `radius` [m] around local z and reaches `half_length` [m] along it both ways, ends apart."""

    radius: float = 0.1
    half_length: float = 0.2
    dimensions = (length("radius"), length("half_length"))


def lengths(name: str) -> table.Parameter:
    """The row of three lengths [m] of a shape along its local axes, which is live."""
    return dataclasses.replace(_DIMENSIONS, name=name, length=3, live=True)
