# SPDX-License-Identifier: Apache-2.0
"""A scene: objects and colliders by name, wind and gravity, as frozen descriptions without a device.

Every number is checked on construction; a bad one raises ValueError (see checks.py).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from cloth_sim_ros import parameters as table
from cloth_sim_ros.sim.colliders import SHAPES
from cloth_sim_ros.sim.colliders.collider import Collider
from cloth_sim_ros.sim.colliders.mesh import Mesh
from cloth_sim_ros.sim.input.checks import check_fields, names_of
from cloth_sim_ros.sim.input.mesh_repair import count_t_junctions, count_turns, counted, parts_of
from cloth_sim_ros.sim.input.numbers import Described
from cloth_sim_ros.sim.physics.quaternion import Vector
from cloth_sim_ros.sim.scene.constraints import CONSTRAINTS, Constraint
from cloth_sim_ros.sim.scene.forces import FORCES, Force
from cloth_sim_ros.sim.scene.handles import Handle
from cloth_sim_ros.sim.scene.objects import Cloth, Rope
from cloth_sim_ros.sim.scene.seams import Seam

_LARGE = 20.0  # size [m] above which a mesh is suspect, as garments and tools are smaller


@dataclass(frozen=True)
class Wind:
    """A uniform wind [m/s].

    At the incidence alpha a surface has C_D = drag_coefficient sin^3 alpha and C_L = lift_coefficient sin alpha
    sin 2 alpha, see physics/aerodynamics.py. A rope has drag_coefficient across its axis, and no force along it.
    """

    velocity: Vector = (0.0, 0.0, 0.0)
    air_density: float = 1.225
    drag_coefficient: float = 1.2
    lift_coefficient: float = 0.6

    def __post_init__(self) -> None:
        check_fields(self, table.WIND)


@dataclass(frozen=True)
class Scene:
    """Named objects, colliders, handles, forces, constraints and seams, wind (None: no air), gravity [m/s^2].

    spare_colliders: number of colliders of SPARE_SHAPES that may be added while a simulation runs. object_contact: True
    if objects keep the sum of their thicknesses from one another. Topics and parameters use all these names. Raises
    ValueError for a value that is not allowed.
    """

    objects: Mapping[str, Cloth | Rope] = field(default_factory=dict)
    colliders: Mapping[str, Collider] = field(default_factory=dict)
    wind: Wind | None = None
    forces: Mapping[str, Force] = field(default_factory=dict)
    gravity: Vector = (0.0, 0.0, -9.81)
    handles: Mapping[str, Handle] = field(default_factory=dict)
    spare_colliders: int = 0
    object_contact: bool = False
    constraints: Mapping[str, Constraint] = field(default_factory=dict)
    seams: Mapping[str, Seam] = field(default_factory=dict)

    def __post_init__(self) -> None:
        _check_names(self.objects, (Cloth, Rope), "objects")
        _check_names(self.colliders, tuple(SHAPES.values()), "colliders")
        _check_names(self.handles, (Handle,), "handles")
        _check_names(self.forces, (Force,), "forces")
        _check_names(self.constraints, (Constraint,), "constraints")
        _check_names(self.seams, (Seam,), "seams")
        names = [*self.objects, *self.colliders, *self.handles, *self.forces, *self.constraints, *self.seams]
        twice = {name for name in names if names.count(name) > 1}
        if twice:
            raise ValueError(
                f"the name {min(twice)!r} is given to two of objects, colliders, handles, forces, constraints and "
                "seams; allowed is one of them"
            )
        for name, handle in self.handles.items():
            if handle.object not in ("", *self.objects):
                raise ValueError(
                    f"Handle {name!r} grasps {handle.object!r}; allowed is '' for any of {', '.join(self.objects)}"
                )
        if self.wind is not None and not isinstance(self.wind, Wind):
            raise ValueError(f"Scene.wind is {self.wind!r}; allowed is a Wind or None")
        for thing in (*self.forces.values(), *self.constraints.values()):
            kind_of(thing)
        allowed = names_of(self.objects)
        for name, constraint in self.constraints.items():
            if constraint.object not in self.objects:
                raise ValueError(f"Constraint {name!r} is of {constraint.object!r}; allowed is {allowed}")
        for name, seam in self.seams.items():
            for thing in (seam.first, seam.second):
                if not isinstance(thing, str) or thing not in self.objects:
                    raise ValueError(f"Seam {name!r} is of {thing!r}; allowed is {allowed}")
        check_fields(self, (table.GRAVITY, table.SPARE_COLLIDERS, table.OBJECT_CONTACT))

    @property
    def numbered(self) -> dict[str, Described]:
        """Forces, then constraints, then seams, in the order of Arrays.numbers."""
        return {**self.forces, **self.constraints, **self.seams}

    @property
    def sewn(self) -> frozenset[str]:
        """Names of the objects that seams hold."""
        return frozenset(name for seam in self.seams.values() for name in (seam.first, seam.second))


def kind_of(thing: Described) -> str:
    """The name in FORCES or CONSTRAINTS of a force or constraint. Raises ValueError if its class is not there."""
    known = FORCES if isinstance(thing, Force) else CONSTRAINTS
    for name, kind in known.items():
        if type(thing) is kind:
            return name
    where = "forces" if known is FORCES else "constraints"
    allowed = ", ".join(known) or "none"
    raise ValueError(f"Scene.{where} has {thing!r}; allowed are {allowed}, see scene/{where}.py")


def large_meshes(scene: Scene) -> Iterator[str]:
    """Yield a warning for each cloth and collider from a mesh larger than a room, as its file may be in millimetres."""
    for name, thing in {**scene.objects, **scene.colliders}.items():
        points = thing.points() if isinstance(thing, Mesh) else getattr(thing, "vertices", None)
        across = 0.0 if points is None else float(np.ptp(points, axis=0).max())
        if across > _LARGE:
            yield f"{name} is {across:.3g} m across; a mesh in millimetres takes a scale of 0.001"


def odd_meshes(scene: Scene) -> Iterator[str]:
    """Yield a warning for each cloth of a mesh of parts that no seam holds, with vertices on open edges, or with
    triangles that turn opposite ways."""
    for name, thing in scene.objects.items():
        if not isinstance(thing, Cloth) or thing.vertices is None:
            continue
        parts = 1 + parts_of(len(thing.vertices), thing.triangles).max()
        if parts > 1 and name not in scene.sewn:
            yield f"{name} has {parts} parts that no triangle joins, which move apart; a seam sews them together"
        open_edges = count_t_junctions(thing.vertices, thing.triangles)
        if open_edges:
            between = "a vertex between its ends" if open_edges == 1 else "a vertex between their ends"
            yield f"{name} has {counted(open_edges, 'open edge')} with {between}, where it comes apart"
        turns = count_turns(thing.triangles, len(thing.vertices))
        if turns:
            edges = counted(turns, "edge")
            yield f"{name} has {edges} between triangles that turn opposite ways; it moves as if they turned alike"


def _check_names(things: Any, kinds: tuple[type, ...], where: str) -> None:
    """Raise ValueError unless `things` is a dict from valid parameter names to objects of `kinds`."""
    *first, last = (f"a {kind.__name__}" for kind in kinds)
    allowed = f"{', '.join(first)} or {last}" if first else last
    if not isinstance(things, Mapping):
        raise ValueError(f"Scene.{where} is {things!r}; allowed is a dict of name to {allowed}")
    for name, thing in things.items():
        if not isinstance(name, str) or not name or "." in name:
            raise ValueError(f"Scene.{where} has the name {name!r}; allowed is a word without dots")
        if name in ("solver", "wind", "gravity"):
            raise ValueError(f"Scene.{where} has the name {name!r}; allowed is a name that no group of parameters has")
        if not isinstance(thing, kinds):
            raise ValueError(f"Scene.{where}[{name!r}] is {thing!r}; allowed is {allowed}")
