# SPDX-License-Identifier: Apache-2.0
"""The base of all colliders of a scene. The file of each shape holds its description and its distance."""

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

SHALLOW = 0.05  # depth of a surface between particles, as a share of their spacing, that no facet has to prevent
FASTEST = 20.0  # speed [m/s] up to which no collider may pass between particles that it touches
_DIMENSIONS = table.row(table.COLLIDER, "dimensions")


@dataclass(frozen=True, kw_only=True)
class Collider:
    """A pose, Coulomb coefficients and a compliance; a pair's friction is the geometric mean of its two sides.

    compliance [m/N]: depth of a point of contact per force; 0 is rigid. An object squeezed between two colliders has a
    defined force only if they are not rigid. opposite: name of the collider with which it pinches what is between them,
    as the other finger of a gripper does; see Simulation.squeeze.

    A shape adds its lengths as fields, their rows in `dimensions`, and `reach()`, the distance from its origin to its
    farthest point [m]. `reach()` and `roundness()` use the fields as numbers, or as arrays (k,) for k sizes. A shape
    that needs more than three numbers also provides `data` and its own `size()`; its rows are not live then. `convex`:
    True if its signed distance is convex along every line. Raises ValueError for a value that is not allowed.
    """

    position: Vector = (0.0, 0.0, 0.0)
    orientation: Quaternion = (0.0, 0.0, 0.0, 1.0)
    static_friction: float = 0.5
    kinetic_friction: float = 0.4
    compliance: float = 0.0
    opposite: str = ""
    dimensions: ClassVar[tuple[table.Parameter, ...]] = ()
    convex: ClassVar[bool] = True

    def __post_init__(self) -> None:
        check_fields(self, (*table.COLLIDER, *self.dimensions))

    def size(self) -> tuple[float, ...]:
        """The size (3,) [m] for its `signed_distance`: its dimensions one after another, then 0."""
        values = [getattr(self, row.name) for row in self.dimensions]
        numbers = [number for value in values for number in (value if isinstance(value, tuple) else (value,))]
        return (*numbers, 0.0, 0.0, 0.0)[:3]

    def place_in_size(self, name: str) -> int | slice:
        """Index or slice of the dimension called `name` in `size()`."""
        first = 0
        for row in self.dimensions:
            if row.name == name:
                return slice(first, first + row.length) if row.length else first
            first += row.length or 1
        raise KeyError(name)

    def resized(self, size: np.ndarray) -> Collider:
        """Copy with a checked size (3,) [m], or with arrays as fields for many sizes (k, 3)."""
        other = copy.copy(self)
        for row in self.dimensions:
            place = self.place_in_size(row.name)
            value = tuple(size.T[place]) if isinstance(place, slice) else size.T[place]
            object.__setattr__(other, row.name, value)
        return other

    def roundness(self) -> float:
        """The smallest radius of curvature of its surface [m]; 0 for a shape with edges."""
        return 0.0

    def enters(self, needed: float, thickness: float) -> bool:
        """True if it comes too deep between particles that it keeps at the distance `thickness` [m].

        needed: radius of curvature that its surface has to have everywhere [m], see `least_roundness`.
        """
        return bool(self.roundness() < needed)

    def data(self, device: wp.Device) -> Any:
        """Data that its `signed_distance` reads on a device beside the size, or None.

        The `id` of the returned object is the address that the function takes as third argument. The caller keeps the
        object alive.
        """
        return None


def least_roundness(gap: float, passing: float, depth: float, thickness: float) -> float:
    """Radius of curvature [m] that a collider needs, so that it may be tested against particles alone.

    gap: largest distance of a point between particles from the nearest of them [m]; passing: the same in the worst
    case, from which a collider must not slip through. A point between particles that a ball of radius R keeps at
    `thickness` is sqrt((R + thickness)^2 - gap^2) from its middle. It may lie by `depth` deeper than they do [m].
    """
    return max(passing, (gap * gap + depth * depth) / (2.0 * depth)) - thickness


def length(name: str) -> table.Parameter:
    """Parameter row of a shape's live length [m]."""
    return dataclasses.replace(_DIMENSIONS, name=name, kind="double", live=True)


@dataclass(frozen=True)
class Tube(Collider):
    """Base of shapes with a `radius` [m] around local z and a `half_length` [m] along it, without their ends."""

    radius: float = 0.1
    half_length: float = 0.2
    dimensions = (length("radius"), length("half_length"))


def lengths(name: str) -> table.Parameter:
    """Parameter row of three live lengths [m] of a shape along its local axes."""
    return dataclasses.replace(_DIMENSIONS, name=name, length=3, live=True)
