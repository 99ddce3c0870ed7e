# SPDX-License-Identifier: Apache-2.0
"""The simulated objects: cloths and ropes with their materials, as frozen descriptions without a device.

Every number is checked on construction; a bad one raises ValueError (see checks.py).
"""

from __future__ import annotations

import logging
import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from cloth_sim_ros import parameters as table
from cloth_sim_ros.sim.input.checks import check_fields, finite_array
from cloth_sim_ros.sim.input.mesh_repair import Unfit, repair
from cloth_sim_ros.sim.mesh_file import load_mesh, load_warp
from cloth_sim_ros.sim.physics.quaternion import Quaternion, Vector
from cloth_sim_ros.sim.scene.materials import Fabric, cell_of, rope_fields, sheet_fields, triangles_area

_LOG = logging.getLogger(__name__)
_MOST_POISSON = 0.95  # part of the largest Poisson's ratio of a stable sheet
_THICK = 0.1  # of its extent: a thickness or radius beyond it is suspect, as it may be in millimetres


@dataclass(frozen=True)
class Cloth:
    """A rectangular sheet (or, from `Cloth.from_mesh`, any manifold triangle mesh) of springs.

    Particle (ix, iy) is index iy*nx + ix at local (ix*w/(nx-1) - w/2, iy*h/(ny-1) - h/2, 0).

    stretch_compliance, shear_compliance [m/N]: 1/constant of every spring of a square grid, borders twice as compliant.
    shear_compliance None means no shear springs. Compliance 0 is rigid. weft_compliance: that of the springs along y;
    None for the same as along x, the warp.

    A mesh with a shear_compliance is a linear membrane: stretch_compliance and weft_compliance are 1/Young's modulus of
    warp and weft, shear_compliance is 1/shear modulus, and poisson the contraction of the weft over a stretch of the
    warp. They hold in any direction of any mesh. warp: its direction in local axes, (3,), or (T, 3) for each triangle;
    the part in the triangle's plane counts. A live stretch_compliance scales all of it. A mesh that tears, or without a
    shear_compliance, has springs: the edge between triangles of area A1, A2 has the constant
    (A1 + A2) / (stretch_compliance |e|^2) (Van Gelder 1998), and 3/8 of Young's modulus is its shear modulus.

    bend_compliance: None for no bending. With bending="springs" [m/N] it is 1/constant of the distance springs over two
    edges. With "dihedral" [1/(N m)] it is 1/flexural rigidity B of a sheet whose Poisson ratio is 0 in bending. Its
    energy is B/2 times the integral of the squared curvatures (kxx^2 + 2 kxy^2 + kyy^2). A strip of width w bends with
    B w and twists with 2 B w, in any direction of any mesh. weft_bend_compliance, diagonal_bend_compliance: the same of
    strips along the weft and at 45 degrees; then a strip along the warp has B. None is that of the warp, and the mean
    of both. The energy is quadratic in the positions (Bergou et al. 2006), exact for sheets that hardly stretch. Free
    edges carry no moment. A triangle of three pinned particles is a clamp: two pinned rows hold the sheet at the
    second one.

    mass [kg] is lumped by area; particle_masses (N,) [kg] overrides it (a heavy hem). damping [s]: dashpot coefficient
    c = damping x constant. thickness [m]: distance at which the cloth touches a collider. With self_contact its parts
    keep twice the thickness from one another. With tear_strain above 0, structural and shear springs fail for good
    beyond that strain, and `Simulation.cut` can cut them.
    """

    resolution: tuple[int, int] = (32, 32)
    size: tuple[float, float] = (1.0, 1.0)
    mass: float = 0.2
    position: Vector = (0.0, 0.0, 0.0)
    orientation: Quaternion = (0.0, 0.0, 0.0, 1.0)
    pins: Any = "corners"
    stretch_compliance: float = 1e-3
    shear_compliance: float | None = 3e-3
    weft_compliance: float | None = None
    poisson: float = 0.0
    warp: Any = field(default=(1.0, 0.0, 0.0), repr=False, compare=False)
    bend_compliance: float | None = None
    weft_bend_compliance: float | None = None
    diagonal_bend_compliance: float | None = None
    bending: str = "springs"
    damping: float = 0.0
    thickness: float = 0.005
    static_friction: float = 0.5
    kinetic_friction: float = 0.4
    self_contact: bool = False
    tear_strain: float = 0.0
    particle_masses: Any = field(default=None, repr=False, compare=False)
    vertices: np.ndarray | None = field(default=None, repr=False, compare=False)
    triangles: np.ndarray | None = field(default=None, repr=False, compare=False)

    def __post_init__(self) -> None:
        absent = ("shear_compliance", "weft_compliance", "bend_compliance")
        absent += ("weft_bend_compliance", "diagonal_bend_compliance")
        skip = tuple(name for name in absent if getattr(self, name) is None)
        check_fields(self, table.CLOTH, skip)
        if self.bending == "none":
            object.__setattr__(self, "bend_compliance", None)
        if (self.vertices is None) != (self.triangles is None):
            raise ValueError("Cloth has vertices or triangles alone; allowed are both or neither")
        if min(self.size) <= 0.0:
            raise ValueError(f"Cloth.size is {table.shown(self.size)}; allowed are two numbers above 0 [m]")
        if self.vertices is None:
            count, names = self.resolution[0] * self.resolution[1], ("corners", "top", "edges")
        else:
            count, names = len(self.vertices), ()
        _check_pins(self, names, count)
        _take_masses(self, count)
        self._check_weave()

    @property
    def weft_over_warp(self) -> float:
        """Compliance of the weft over that of the warp."""
        return 1.0 if self.weft_compliance is None else self.weft_compliance / self.stretch_compliance

    def _check_weave(self) -> None:
        """Check numbers of warp, weft and diagonal against one another. Raises ValueError."""
        mesh = self.vertices is not None
        membrane, bends = self.shear_compliance is not None, self.bend_compliance is not None
        for name, of, allowed in (
            ("weft_compliance", "stretch_compliance", membrane or not mesh),
            ("weft_bend_compliance", "bend_compliance", bends and self.bending == "dihedral"),
            ("diagonal_bend_compliance", "bend_compliance", bends and self.bending == "dihedral"),
        ):
            value = getattr(self, name)
            if value is not None and not allowed:
                needs = "a shear_compliance" if of == "stretch_compliance" else "bending 'dihedral'"
                raise ValueError(f"Cloth.{name} is {value:g} without {needs}; allowed is to leave it out, or both")
            if value is not None and min(value, getattr(self, of)) <= 0.0:
                raise ValueError(f"Cloth.{name} is {value:g}, {of} {getattr(self, of):g}; allowed are two above 0")
        if bends and self.diagonal_bend_compliance is not None:
            least = 0.25 * (self.bend_compliance + (self.weft_bend_compliance or self.bend_compliance))
            if self.diagonal_bend_compliance <= least:
                raise ValueError(
                    f"Cloth.diagonal_bend_compliance is {self.diagonal_bend_compliance:g}; allowed is more than a "
                    f"quarter of the sum of those of warp and weft, {least:g}"
                )
        if mesh and membrane and min(self.stretch_compliance, self.shear_compliance) <= 0.0:
            raise ValueError("Cloth has a compliance of 0 on a mesh with a shear_compliance; allowed is more than that")
        if not mesh and (self.poisson or tuple(self.warp) != (1.0, 0.0, 0.0)):
            raise ValueError("Cloth has poisson or warp on a grid; allowed are they on a mesh, of a grid they follow")
        most = _MOST_POISSON * math.sqrt(self.weft_over_warp)
        if abs(self.poisson) > most:
            raise ValueError(f"Cloth.poisson is {self.poisson:g}; with these compliances allowed is at most {most:.3g}")
        warp = np.array(self.warp, dtype=np.float64)
        if warp.shape != (3,) and (not mesh or warp.shape != self.triangles.shape):
            raise ValueError(f"Cloth.warp has shape {warp.shape}; allowed is a vector, or one for each triangle")
        if not (np.isfinite(warp).all() and np.linalg.norm(np.atleast_2d(warp), axis=1).all()):
            raise ValueError("Cloth.warp has a vector without a direction; allowed are vectors along the warp")

    @classmethod
    def of(cls, material: str | Fabric, **fields: Any) -> Cloth:
        """Make a sheet of a material in `materials.FABRICS`, or a Fabric; `fields` of Cloth, such as size, override it.

        The warp is along x. The mass follows from the size. Stretch and shear give Poisson's ratio. Raises ValueError
        for an unknown material.
        """
        size, resolution = (
            table.check(table.row(table.CLOTH, name), fields.get(name, getattr(cls, name)), f"Cloth.{name}")
            for name in ("size", "resolution")
        )
        return cls(**sheet_fields(material, math.prod(size), fields, cell_of(size, resolution)))

    @classmethod
    def from_mesh(
        cls, vertices: Any, triangles: Any, material: str | Fabric = "", scale: float = 1.0, **fields: Any
    ) -> Cloth:
        """Make a cloth from a triangle mesh.

        Without a material or a shear_compliance, edges carry both stretch and shear. Pins are indices; the named pins
        of a grid do not exist. Triangles without an area, and vertices that no other triangle uses, are dropped, which
        the log reports. Particles are the remaining vertices in their order. Pins and particle_masses use the given
        numbering.

        Args:
            vertices: (N, 3) in local axes, in units of `scale`.
            triangles: (T, 3) indices of vertices.
            material: A name in `materials.FABRICS`, a Fabric, or "". The mass then follows from the area.
            scale: Length of a unit of the vertices [m].
            fields: Fields of Cloth, which override those of the material.

        Raises:
            ValueError: A triangle names a vertex that does not exist. A Simulation raises it for a mesh that is not
                manifold.
        """
        for name in ("resolution", "size"):
            if name in fields:
                raise ValueError(
                    f"Cloth.from_mesh has {name}; allowed are the material fields, the mesh gives the shape"
                )
        points = finite_array(vertices, "Cloth.from_mesh vertices")
        corners = finite_array(triangles, "Cloth.from_mesh triangles")
        wrong = corners[(corners < 0) | (corners >= len(points)) | (corners != np.floor(corners))]
        if len(wrong):
            allowed = f"whole numbers from 0 to {len(points) - 1}"
            raise ValueError(f"Cloth.from_mesh triangles name vertex {wrong[0]:g}; allowed are {allowed}")
        try:
            mesh = repair(points * table.check(table.UNIT, scale, "Cloth.from_mesh scale"), corners.astype(np.int32))
        except Unfit as error:
            raise ValueError(f"Cloth.from_mesh {error}") from None
        if mesh.told:
            _LOG.warning("Cloth.from_mesh %s", mesh.told)
        if len(mesh.points) < len(points):
            fields = _renumbered(fields, mesh.place, len(mesh.points))
        if np.shape(fields.get("warp")) == corners.shape:
            fields = {**fields, "warp": np.asarray(fields["warp"])[mesh.of]}
        points, faces = mesh.points, mesh.triangles
        if material:
            fields = sheet_fields(material, triangles_area(points, faces), fields)
        return cls(**{"pins": None, "shear_compliance": None, **fields, "vertices": points, "triangles": faces})

    @classmethod
    def from_file(
        cls,
        file: str,
        material: str | Fabric = "",
        scale: float = 1.0,
        uv: bool = False,
        named: str = "",
        **fields: Any,
    ) -> Cloth:
        """Make a cloth from a mesh file, or FILE#PART of it, as `from_mesh` does; see `mesh_file.load_mesh`.

        uv: True if `warp` is along u and v of the file's texture, such as (0, 1, 0) along v. named: what messages call
        the file. Raises ValueError likewise.
        """
        named, file = named or f"{cls.__name__}.from_file", str(file)
        if uv:
            fields["warp"] = load_warp(file, named, scale, fields.get("warp", cls.warp))
        return cls.from_mesh(*load_mesh(file, named, scale), material, scale, **fields)


@dataclass(frozen=True)
class Winch:
    """A drum at the start of a rope, which pays it out and hauls it in: see the rows of `parameters.WINCH`.

    length, shortest, longest [m], pay_out, max_rate [m/s], acceleration [m/s^2]. All but length are live.
    """

    length: float = 1e4
    pay_out: float = 0.0
    max_rate: float = 1.0
    acceleration: float = 1.0
    shortest: float = 0.0
    longest: float = 1e4

    def __post_init__(self) -> None:
        check_fields(self, table.WINCH)
        check_lengths(self.shortest, self.longest, "Winch.shortest")


def check_lengths(shortest: float, longest: float, name: str) -> None:
    """Raise ValueError where a winch's shortest length [m] is above its longest."""
    if shortest > longest:
        raise ValueError(f"{name} is {shortest:g} with a longest of {longest:g}; allowed is at most that [m]")


@dataclass(frozen=True)
class Rope:
    """A chain of particles, from `points` (N, 3) [m] or `start`, `end`, `segments`, in local axes.

    stretch_compliance [1/N] = 1/EA. bend_compliance [1/(N m^2)] = 1/EI or None for no bending. 0 is rigid. mass [kg] is
    the total, lumped by length; particle_masses (N,) [kg] overrides it. end_mass [kg]: an additional load at the last
    particle. radius [m]. pins: "start", "end", "both", None or indices. damping [s]: c = damping x constant of each
    segment; bend_damping [s]: the same of each joint, in twist too. With self_contact its parts keep twice the radius
    from one another.

    winch: a drum at the start, which must be pinned; the end may be. The part that is not paid out lies on the drum.
    The rest, measured from the end, lies along the path from the start. It bends about a hinge at the drum, and is
    straight at rest.

    twist_compliance [1/(N m^2)] = 1/GJ or None for no twist. An end is clamped while its last two particles are pinned,
    or held by a handle, which turns the rope with it. Between two clamps the rope resists twist; while an end is free
    it has none. What bends of `points` it has at rest are then in its material and turn with the clamps; without twist
    they have an amount and no direction. end_turn [rad]: turn of the end about its axis relative to the start, counted
    from when both were clamped, or positions set.
    """

    points: Any = field(default=None, repr=False, compare=False)
    start: Vector = (0.0, 0.0, 1.0)
    end: Vector = (1.0, 0.0, 1.0)
    segments: int = 32
    mass: float = 0.2
    radius: float = 0.005
    end_mass: float = 0.0
    pins: Any = "start"
    stretch_compliance: float = 1e-4
    bend_compliance: float | None = None
    damping: float = 0.0
    bend_damping: float = 0.0
    static_friction: float = 0.5
    kinetic_friction: float = 0.4
    self_contact: bool = False
    position: Vector = (0.0, 0.0, 0.0)
    orientation: Quaternion = (0.0, 0.0, 0.0, 1.0)
    particle_masses: Any = field(default=None, repr=False, compare=False)
    winch: Winch | None = None
    twist_compliance: float | None = None
    end_turn: float = 0.0

    def __post_init__(self) -> None:
        absent = tuple(name for name in ("bend_compliance", "twist_compliance") if getattr(self, name) is None)
        check_fields(self, (*table.ROPE, *table.TWIST), absent)
        if self.points is None:
            t = np.linspace(0.0, 1.0, self.segments + 1)[:, None]
            points = np.asarray(self.start) * (1.0 - t) + np.asarray(self.end) * t
        else:
            points = finite_array(self.points, "Rope.points")
        if len(points) < 2:
            raise ValueError(f"Rope.points has {len(points)}; allowed are two or more")
        for k in np.flatnonzero(np.linalg.norm(np.diff(points, axis=0), axis=1) < 1e-9)[:1]:
            place = points[k].tolist()
            raise ValueError(f"Rope has points {k} and {k + 1} both at {place}; allowed are neighbours apart")
        object.__setattr__(self, "points", points)
        object.__setattr__(self, "segments", len(points) - 1)
        _check_pins(self, ("start", "end", "both"), len(points))
        _take_masses(self, len(points))
        if self.winch is not None:
            self._check_winch()
        if self.twist_compliance is not None and self.bend_compliance is None:
            raise ValueError("Rope has twist without bending; allowed is bending alone, or both")
        if self.twist_compliance is not None and self.segments < 3:
            raise ValueError(f"Rope has twist and {self.segments} segments; allowed are at least 3")
        if self.twist_compliance is not None and self.winch is not None:
            raise ValueError("Rope.twist_compliance is set for a rope on a winch; allowed is None")
        if self.twist_compliance is None and self.end_turn:
            raise ValueError(f"Rope.end_turn is {self.end_turn:g} without twist; allowed is 0, or both")

    @classmethod
    def of(cls, material: str, **fields: Any) -> Rope:
        """Make a rope of a material in `materials.CORDS`; `fields` of Rope, such as start and end, override it.

        The mass follows from the length. Another radius than the preset's scales mass and stiffness. Raises ValueError
        for an unknown material.
        """
        path = fields.get("points")
        if path is None:
            path = (fields.get("start", cls.start), fields.get("end", cls.end))
        length = float(np.linalg.norm(np.diff(finite_array(path, "Rope.points"), axis=0), axis=1).sum())
        radius = fields.get("radius")
        if radius is not None:
            radius = table.check(table.row(table.ROPE, "radius"), radius, "Rope.radius")
        return cls(**{**rope_fields(material, length, radius), **fields})

    def _check_winch(self) -> None:
        """Raise ValueError where a rope on a winch is not held at its start, or is held between its ends."""
        if not isinstance(self.winch, Winch):
            raise ValueError(f"Rope.winch is {self.winch!r}; allowed is a Winch or None")
        pins = {"start": (0,), "both": (0, self.segments)}.get(self.pins, self.pins) if self.pins else ()
        if isinstance(pins, str) or 0 not in pins or set(pins) - {0, self.segments}:
            given = f"Rope.pins is {table.shown(self.pins)} with a winch at the start"
            raise ValueError(f"{given}; allowed is 'start' or 'both'")


def too_thick(name: str, thing: Cloth | Rope, thickness: float) -> str:
    """Return what is odd about a thickness, or radius, [m] of an object, in one sentence; "" if it may be meant."""
    if isinstance(thing, Rope):
        field, kind = "radius", "rope"
        extent = float(np.linalg.norm(np.diff(thing.points, axis=0), axis=1).sum())
    else:
        field, kind = "thickness", "cloth"
        extent = max(thing.size) if thing.vertices is None else float(np.ptp(thing.vertices, axis=0).max())
    most = _THICK * extent
    if thickness <= most * (1.0 + 1e-6):  # as float32 rounds it
        return ""
    usual = f"usual is up to {most:.3g} m, and 1 mm is 0.001"
    return f"{name}.{field} is {thickness:g} m for a {kind} of {extent:.3g} m; {usual}"


FRICTION = ("static_friction", "kinetic_friction")  # names of both coefficients


def odd_friction(who: str, static: float, kinetic: float) -> str:
    """Return what is odd about two coefficients of friction, in one sentence; "" if they may be meant."""
    if kinetic <= static:
        return ""
    return f"kinetic_friction of {who} is {kinetic:g}, above its static_friction, {static:g}; usual is at most that"


def _renumbered(fields: dict[str, Any], place: np.ndarray, count: int) -> dict[str, Any]:
    """Renumber `fields` of Cloth for `count` particles; `place` (N,) is the particle of each vertex, or -1.

    Raises ValueError for a pin at a vertex that is no particle.
    """
    pins, masses = fields.get("pins"), fields.get("particle_masses")
    if pins is not None and not isinstance(pins, str):
        pins = table.check(table.row(table.CLOTH, "pins"), pins, "Cloth.pins")
        for pin in pins:
            if not 0 <= pin < len(place) or place[pin] < 0:
                raise ValueError(f"Cloth.pins names vertex {pin}; allowed are those of triangles with an area")
        fields = {**fields, "pins": tuple(dict.fromkeys(int(place[pin]) for pin in pins))}
    if np.shape(masses) == place.shape:
        kept = place >= 0
        fields = {**fields, "particle_masses": np.bincount(place[kept], np.asarray(masses)[kept], count)}
    return fields


def _check_pins(thing: Any, names: tuple[str, ...], count: int) -> None:
    """Raise ValueError where `pins` is not None, "none", one of `names` or indices below `count`."""
    pins, name = thing.pins, f"{type(thing).__name__}.pins"
    if pins is None or pins == "none":
        return
    if isinstance(pins, str):
        if pins not in names:
            words = ", ".join([*names, "none"])
            raise ValueError(f"{name} is {pins!r}; allowed is one of {words} or a list of particle indices")
        return
    bad = [index for index in pins if not 0 <= index < count]
    if bad:
        raise ValueError(f"{name} names particle {bad[0]}; allowed are 0 to {count - 1}")


def _take_masses(thing: Any, count: int) -> None:
    """Check `particle_masses` if they are given, and set the total mass to their sum. Raises ValueError."""
    if thing.particle_masses is None:
        return
    masses, name = np.array(thing.particle_masses, dtype=np.float64), f"{type(thing).__name__}.particle_masses"
    if masses.shape != (count,) or not np.isfinite(masses).all() or masses.min() <= 0.0:
        raise ValueError(f"{name} has shape {masses.shape}; allowed are {count} finite masses > 0 [kg]")
    object.__setattr__(thing, "particle_masses", masses)
    object.__setattr__(thing, "mass", float(masses.sum()))
