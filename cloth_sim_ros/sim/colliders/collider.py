# SPDX-License-Identifier: Apache-2.0
"""The base of all colliders of a scene. The file of each shape holds its description and its distance."""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import warp as wp

from cloth_sim_ros import parameters as table
from cloth_sim_ros.sim.input.checks import check_fields
from cloth_sim_ros.sim.input.numbers import fields_of, numbers_of
from cloth_sim_ros.sim.physics.quaternion import Quaternion, Vector

SHALLOW = 0.05  # depth of a surface between particles, as a share of their spacing, that no facet has to prevent
FASTEST = 20.0  # speed [m/s] up to which no collider may pass between particles that it touches
_DIMENSIONS = table.row(table.COLLIDER, "dimensions")


@dataclass(frozen=True)
class Solid:
    """A part of what to draw of a collider, in its local axes.

    kind: "box", "ball" or "cylinder" along z, of edges or diameters `scale` [m] about `middle` [m]; "triangles" of
    `points` (3 T, 3) [m], three corners each; or "cells", boxes of edges `scale` about `points`. file: a mesh file that
    viewers may read instead, of which a unit is `unit` [m].
    """

    kind: str
    scale: Vector = (1.0, 1.0, 1.0)
    middle: Vector = (0.0, 0.0, 0.0)
    points: np.ndarray | None = None
    file: str = ""
    unit: float = 1.0

    @classmethod
    def triangles(cls, points: Any, corners: Any, file: str = "", unit: float = 1.0) -> Solid:
        """Triangles `corners` (T, 3) over points (N, 3) [m]."""
        return cls("triangles", points=np.asarray(points)[np.asarray(corners)].reshape(-1, 3), file=file, unit=unit)


@dataclass(frozen=True, kw_only=True)
class Collider:
    """A pose, Coulomb coefficients and a compliance; a pair's friction is the geometric mean of its two sides.

    compliance [m/N]: depth of a point of contact per force; 0 is rigid. An object squeezed between two colliders has a
    defined force only if they are not rigid. opposite: name of the collider with which it pinches what is between them,
    as the other finger of a gripper does; see Simulation.squeeze.

    A shape adds its lengths as fields, their rows in `dimensions`, its Warp function `distance`, what to draw in
    `solids()`, and `reach()`, the distance from its origin to its farthest point [m]. `reach()` and `roundness()` use
    the fields as numbers, or as arrays (k,) for k sizes. A shape that needs more than three numbers also provides
    `data` and its own `size()`; its rows are not live then. Raises ValueError for a value that is not allowed.

    distance: Warp function (p, size) or (p, size, data) -> outward normal (x, y, z) and signed distance [m] of local
    point p. at_least: a quick lower bound (p, data) [m] of a distance that is slow to compute. width: of a
    shape that may not be convex, a Warp function (data) -> twice its volume over its surface [m], or 0 where the
    distance is convex along every line. deepest: where a formula is faster than a search, a Warp function (a, b, c) ->
    weights of the corners in the deepest point of a triangle; b and c are equal for a segment. edged: True if its
    surface may have sharp edges. flat: True if all of it is flat, so that a facet touches it at a particle first. cost:
    that of a distance on a CPU, over that from a box. wholes: halves among `dimensions`, of which YAML has the double
    as in shape_msgs/SolidPrimitive, and its name there; these come first.
    """

    position: Vector = (0.0, 0.0, 0.0)
    orientation: Quaternion = (0.0, 0.0, 0.0, 1.0)
    static_friction: float = 0.5
    kinetic_friction: float = 0.4
    compliance: float = 0.0
    opposite: str = ""
    dimensions: ClassVar[tuple[table.Parameter, ...]] = ()
    wholes: ClassVar[Mapping[str, str]] = {}
    distance: ClassVar[wp.Function]
    at_least: ClassVar[wp.Function | None] = None
    width: ClassVar[wp.Function | None] = None
    deepest: ClassVar[wp.Function | None] = None
    edged: ClassVar[bool] = False
    flat: ClassVar[bool] = False
    cost: ClassVar[int] = 1

    def __post_init__(self) -> None:
        check_fields(self, (*table.COLLIDER, *self.dimensions))

    def size(self) -> tuple[float, ...]:
        """The size (3,) [m] for its `signed_distance`: its dimensions one after another, then 0."""
        return (*numbers_of(self, self.dimensions), 0.0, 0.0, 0.0)[:3]

    @classmethod
    def from_dimensions(cls, numbers: Sequence[float], **fields: Any) -> Collider:
        """A collider of the numbers [m] that its parameter `dimensions` has. Raises ValueError for another count."""
        rows = sorted(cls.dimensions, key=lambda row: row.name not in cls.wholes)
        shares = [0.5 if row.name in cls.wholes else 1.0 for row in rows for _ in range(row.length or 1)]
        if shares and len(numbers) != len(shares):
            names, kind = ", ".join(cls.wholes.get(row.name, row.name) for row in rows), cls.__name__
            meaning = f"a {kind.lower()} has {len(shares)}: {names} [m]"
            raise ValueError(f"{kind}.dimensions is {table.shown(numbers)}; {meaning}")
        numbers = [share * number for share, number in zip(shares, numbers, strict=False)]
        return cls(**fields_of(rows, numbers), **fields)

    def solids(self) -> list[Solid]:
        """What to draw of it; nothing unless a shape says more."""
        return []

    def resized(self, size: np.ndarray) -> Collider:
        """Copy with a checked size (3,) [m], or with arrays as fields for many sizes (k, 3)."""
        other = copy.copy(self)
        for name, value in fields_of(self.dimensions, size.T).items():
            object.__setattr__(other, name, value)
        return other

    def sharpest(self, sizes: np.ndarray) -> Collider:
        """Copy of the one of sizes (k, 3) [m] with which it comes between particles most easily."""
        if not any(row.live for row in self.dimensions):
            return self
        roundness = np.broadcast_to(self.resized(sizes).roundness(), len(sizes))
        return self.resized(sizes[roundness.argmin()])

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
    wholes = {"half_length": "height of the cylinder"}

    def solids(self) -> list[Solid]:
        """The cylinder."""
        return [Solid("cylinder", (2 * self.radius, 2 * self.radius, 2 * self.half_length))]


def lengths(name: str) -> table.Parameter:
    """Parameter row of three live lengths [m] of a shape along its local axes."""
    return dataclasses.replace(_DIMENSIONS, name=name, length=3, live=True)
