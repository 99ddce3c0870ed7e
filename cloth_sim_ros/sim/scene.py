"""What exists: plain frozen descriptions of objects, colliders and wind. Nothing here touches a device.

Every number is checked on construction against the table in `cloth_sim_ros.parameters`; a bad one raises ValueError
with one sentence that names the thing, the value and what is allowed.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from cloth_sim_ros import parameters as table

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]


def _checked(thing: Any, group: tuple[table.Parameter, ...], skip: tuple[str, ...] = ()) -> None:
    """Replace every field of `thing` that has a row in `group` by its checked value."""
    rows = {parameter.name: parameter for parameter in group}
    for item in dataclasses.fields(thing):
        if item.name in rows and item.name not in (*skip, "orientation"):
            name = f"{type(thing).__name__}.{item.name}"
            object.__setattr__(thing, item.name, table.check(rows[item.name], getattr(thing, item.name), name))
    if hasattr(thing, "orientation"):
        object.__setattr__(
            thing, "orientation", unit_quaternion(thing.orientation, f"{type(thing).__name__}.orientation")
        )


def unit_quaternion(value: Any, name: str) -> Quaternion:
    """`value` (x, y, z, w) scaled to length 1. Raises ValueError if it is not four finite numbers or shorter than
    1e-6."""
    try:
        q = np.asarray(value, dtype=np.float64)
        length = float(np.linalg.norm(q))
    except (TypeError, ValueError):
        q, length = np.zeros(0), 0.0
    if q.shape != (4,) or not np.isfinite(length) or length < 1e-6:
        raise ValueError(f"{name} is {value!r}; allowed is a finite quaternion x y z w that is not zero")
    return tuple((q / length).tolist())


def finite_array(value: Any, columns: int, name: str, dtype: type = np.float64) -> np.ndarray:
    """`value` as an (N, columns) array of finite numbers, or ValueError."""
    try:
        array = np.array(value, dtype=dtype)
    except (TypeError, ValueError):
        array = np.zeros(0)
    if array.ndim != 2 or array.shape[1] != columns or len(array) == 0 or not np.isfinite(array).all():
        raise ValueError(
            f"{name} has shape {np.shape(value)}; allowed are N rows of {columns} finite numbers, N at least 1"
        )
    return array


def rotate(orientation: Quaternion, points: np.ndarray) -> np.ndarray:
    """Rows of `points` (N, 3) rotated by the unit quaternion x y z w, in float64."""
    axis, w = np.asarray(orientation[:3]), orientation[3]
    turn = 2.0 * np.cross(axis, points)
    return points + w * turn + np.cross(axis, turn)


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
    """Check `particle_masses` where they are given, and let them make up the total. Raises ValueError."""
    if thing.particle_masses is None:
        return
    masses, name = np.array(thing.particle_masses, dtype=np.float64), f"{type(thing).__name__}.particle_masses"
    if masses.shape != (count,) or not np.isfinite(masses).all() or masses.min() <= 0.0:
        raise ValueError(f"{name} has shape {masses.shape}; allowed are {count} finite masses > 0 [kg]")
    object.__setattr__(thing, "particle_masses", masses)
    object.__setattr__(thing, "mass", float(masses.sum()))


@dataclass(frozen=True)
class Cloth:
    """A rectangular sheet (or, from `Cloth.from_mesh`, any manifold triangle mesh) of springs.

    Particle (ix, iy) is index iy*nx + ix at local (ix*w/(nx-1) - w/2, iy*h/(ny-1) - h/2, 0).
    stretch_compliance, shear_compliance [m/N]: 1/constant of every spring of a square grid, borders twice as compliant;
    on a mesh the edge between triangles of area A1, A2 has constant (A1 + A2) / (compliance |e|^2), which is the same
    on a grid (Van Gelder 1998). bend_compliance: None for no bending; with bending="springs" [m/N], 1/constant of the
    distance springs over two edges; with "dihedral" [1/(N m)], 1/flexural rigidity B: each inner edge e between
    triangles A1, A2 has the energy B |e|^2 / (2 (A1 + A2)) (theta - rest)^2, which bends a grid or an equilateral mesh
    with rigidity B (Seung and Nelson 1988). shear_compliance None means no shear springs. Compliance 0 is rigid.
    mass [kg] is lumped by area; particle_masses (N,) [kg] overrides it (a heavy hem). damping [s]: c = damping x
    constant. thickness [m]: distance at which the cloth touches a collider: with its particles alone, or with
    `edge_contact` along structural and shear edges too.
    """

    resolution: tuple[int, int] = (32, 32)
    size: tuple[float, float] = (1.0, 1.0)
    mass: float = 0.2
    position: Vector = (0.0, 0.0, 0.0)
    orientation: Quaternion = (0.0, 0.0, 0.0, 1.0)
    pins: Any = "corners"
    stretch_compliance: float = 1e-3
    shear_compliance: float | None = 3e-3
    bend_compliance: float | None = None
    bending: str = "springs"
    damping: float = 0.0
    thickness: float = 0.005
    edge_contact: bool = False
    static_friction: float = 0.5
    kinetic_friction: float = 0.4
    particle_masses: Any = field(default=None, repr=False, compare=False)
    vertices: np.ndarray | None = field(default=None, repr=False, compare=False)
    triangles: np.ndarray | None = field(default=None, repr=False, compare=False)

    def __post_init__(self) -> None:
        skip = tuple(name for name in ("shear_compliance", "bend_compliance") if getattr(self, name) is None)
        _checked(self, table.CLOTH, skip)
        if self.bending == "none":
            object.__setattr__(self, "bend_compliance", None)
        if (self.vertices is None) != (self.triangles is None):
            raise ValueError("Cloth has vertices or triangles alone; allowed are both or neither")
        if min(self.size) <= 0.0:
            raise ValueError(f"Cloth.size is {self.size}; allowed are two numbers above 0 [m]")
        if self.vertices is None:
            count, names = self.resolution[0] * self.resolution[1], ("corners", "top", "edges")
        else:
            count, names = len(self.vertices), ()
        _check_pins(self, names, count)
        _take_masses(self, count)

    @classmethod
    def from_mesh(cls, vertices: Any, triangles: Any, **material: Any) -> Cloth:
        """A cloth over `vertices` (N, 3) [m] in local axes and `triangles` (T, 3); `material` are the fields of Cloth.

        Its edges carry stretch and shear alike, so it has no shear_compliance; pins are indices, "all named pins" of a
        grid do not exist. Raises ValueError for a mesh that is not manifold or names a vertex that does not exist.
        """
        for name in ("resolution", "size"):
            if name in material:
                raise ValueError(
                    f"Cloth.from_mesh has {name}; allowed are the material fields, the mesh gives the shape"
                )
        if material.get("shear_compliance") is not None:
            raise ValueError(
                "Cloth.from_mesh has shear_compliance; a mesh's edges carry shear, allowed is stretch_compliance"
            )
        points = finite_array(vertices, 3, "Cloth.from_mesh vertices")
        faces = finite_array(triangles, 3, "Cloth.from_mesh triangles").astype(np.int32)
        if faces.min() < 0 or faces.max() >= len(points):
            raise ValueError(f"Cloth.from_mesh triangles name vertex {faces.max()}; allowed are 0 to {len(points) - 1}")
        return cls(**{"pins": None, **material, "shear_compliance": None, "vertices": points, "triangles": faces})


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
        _checked(self, table.WINCH)
        check_lengths(self.shortest, self.longest, "Winch.shortest")


def check_lengths(shortest: float, longest: float, name: str) -> None:
    """Raise ValueError where a winch's shortest length [m] is above its longest."""
    if shortest > longest:
        raise ValueError(f"{name} is {shortest:g} with a longest of {longest:g}; allowed is at most that [m]")


@dataclass(frozen=True)
class Rope:
    """A chain of particles, from `points` (N, 3) [m] or `start`, `end`, `segments`, in local axes.

    stretch_compliance [1/N] = 1/EA; bend_compliance [1/(N m^2)] = 1/EI or None for no bending; 0 is rigid.
    mass [kg] is the total, lumped by length; particle_masses (N,) [kg] overrides it. end_mass [kg] is a load
    at the last particle, on top of either. radius [m].
    pins: "start", "end", "both", None or indices. damping [s]: c = damping x constant of each segment. edge_contact:
    whether segments touch colliders, not particles alone. winch: a drum at the start, which must be pinned; the end may
    be. What it has not paid out lies on it, and the rest, measured from the end, along the path from the start.
    twist_compliance [1/(N m^2)] = 1/GJ or None for no twist; with it both ends are clamped, the first and the last two
    particles pinned, and end_turn [rad] is by how much the end is turned about its axis against the start, from the
    shape that positions were last set to.
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
    edge_contact: bool = False
    static_friction: float = 0.5
    kinetic_friction: float = 0.4
    position: Vector = (0.0, 0.0, 0.0)
    orientation: Quaternion = (0.0, 0.0, 0.0, 1.0)
    particle_masses: Any = field(default=None, repr=False, compare=False)
    winch: Winch | None = None
    twist_compliance: float | None = None
    end_turn: float = 0.0

    def __post_init__(self) -> None:
        absent = tuple(name for name in ("bend_compliance", "twist_compliance") if getattr(self, name) is None)
        _checked(self, (*table.ROPE, *table.TWIST), absent)
        if self.points is None:
            t = np.linspace(0.0, 1.0, self.segments + 1)[:, None]
            points = np.asarray(self.start) * (1.0 - t) + np.asarray(self.end) * t
        else:
            points = finite_array(self.points, 3, "Rope.points")
        lengths = np.linalg.norm(np.diff(points, axis=0), axis=1)
        if len(points) < 2 or lengths.min(initial=np.inf) < 1e-9:
            raise ValueError(
                "Rope has fewer than two points or a segment of no length; allowed are distinct neighbours"
            )
        object.__setattr__(self, "points", points)
        object.__setattr__(self, "segments", len(points) - 1)
        _check_pins(self, ("start", "end", "both"), len(points))
        _take_masses(self, len(points))
        if self.winch is not None:
            self._check_winch()
        if self.twist_compliance is not None:
            self._check_twist()

    def _check_twist(self) -> None:
        if self.bend_compliance is None:
            raise ValueError("Rope.twist_compliance is set without bend_compliance; allowed is to set both")
        clamps = {0, 1, self.segments - 1, self.segments}
        if isinstance(self.pins, str) or self.pins is None or not clamps <= set(self.pins) or len(clamps) < 4:
            raise ValueError(
                f"Rope.pins is {self.pins!r} with twist; allowed is to clamp both ends, particles {sorted(clamps)}"
            )

    def _check_winch(self) -> None:
        if not isinstance(self.winch, Winch):
            raise ValueError(f"Rope.winch is {self.winch!r}; allowed is a Winch or None")
        pins = {"start": (0,), "both": (0, self.segments)}.get(self.pins, self.pins) if self.pins else ()
        if isinstance(pins, str) or 0 not in pins or set(pins) - {0, self.segments}:
            raise ValueError(f"Rope.pins is {self.pins!r} with a winch at the start; allowed is 'start' or 'both'")
        if self.bend_compliance is not None:
            raise ValueError(
                f"Rope.bend_compliance is {self.bend_compliance:g} with a winch; allowed is None, for no bending"
            )


@dataclass(frozen=True)
class Collider:
    """What all colliders share: a pose and Coulomb coefficients; a pair's are the geometric mean of its two sides."""

    position: Vector = (0.0, 0.0, 0.0)
    orientation: Quaternion = (0.0, 0.0, 0.0, 1.0)
    static_friction: float = 0.5
    kinetic_friction: float = 0.4

    def __post_init__(self) -> None:
        _checked(self, table.COLLIDER)


def _positive(thing: Any, name: str) -> None:
    value = getattr(thing, name)
    row = table.Parameter(name, "double", 1.0, "", "m", 1e-6, 1e6)
    object.__setattr__(thing, name, table.check(row, value, f"{type(thing).__name__}.{name}"))


@dataclass(frozen=True)
class Plane(Collider):
    """The half space below the plane through `point` (or `position`) with outward `normal` in world axes."""

    point: Vector | None = None
    normal: Vector | None = None

    def __post_init__(self) -> None:
        if self.point is not None:
            object.__setattr__(self, "position", self.point)
        if self.normal is not None:
            object.__setattr__(self, "orientation", _turn_to(self.normal))
        super().__post_init__()
        object.__setattr__(self, "point", self.position)
        normal = rotate(self.orientation, np.array([[0.0, 0.0, 1.0]]))[0]
        object.__setattr__(self, "normal", tuple(normal.tolist()))


def _turn_to(normal: Any) -> Quaternion:
    """The shortest rotation of local z onto `normal`."""
    try:
        n = np.asarray(normal, dtype=np.float64)
        length = float(np.linalg.norm(n))
    except (TypeError, ValueError):
        n, length = np.zeros(0), 0.0
    if n.shape != (3,) or not np.isfinite(length) or length < 1e-9:
        raise ValueError(f"Plane.normal is {normal!r}; allowed is a finite vector that is not zero")
    x, y, z = n / length
    if z < -1.0 + 1e-12:
        return (1.0, 0.0, 0.0, 0.0)
    return unit_quaternion((-y, x, 0.0, 1.0 + z), "Plane.normal")


@dataclass(frozen=True)
class Sphere(Collider):
    """A ball of `radius` [m]."""

    radius: float = 0.2

    def __post_init__(self) -> None:
        super().__post_init__()
        _positive(self, "radius")


@dataclass(frozen=True)
class Capsule(Collider):
    """All points within `radius` [m] of the segment of half length `half_length` [m] along local z."""

    radius: float = 0.1
    half_length: float = 0.2

    def __post_init__(self) -> None:
        super().__post_init__()
        _positive(self, "radius")
        _positive(self, "half_length")


@dataclass(frozen=True)
class Box(Collider):
    """A box of `half_extents` (x, y, z) [m] along its local axes."""

    half_extents: Vector = (0.1, 0.1, 0.1)

    def __post_init__(self) -> None:
        super().__post_init__()
        row = table.Parameter("half_extents", "double_array", (0.1,) * 3, "", "m", 1e-6, 1e6, length=3)
        object.__setattr__(self, "half_extents", table.check(row, self.half_extents, "Box.half_extents"))


@dataclass(frozen=True)
class Wind:
    """A uniform wind [m/s]. Per triangle 1/2 rho A ((Cd - Cl)|v.n| v + Cl |v|^2 n), v the air relative to the
    surface."""

    velocity: Vector = (0.0, 0.0, 0.0)
    air_density: float = 1.225
    drag_coefficient: float = 1.2
    lift_coefficient: float = 0.6

    def __post_init__(self) -> None:
        _checked(self, table.WIND)


@dataclass(frozen=True)
class Settings:
    """How to compute: see the rows of `parameters.SOLVER`. frame_dt [s], global_damping [1/s]."""

    method: str = "xpbd"
    order: int = 1
    frame_dt: float = 1 / 60
    substeps: int = 20
    iterations: int = 1
    global_damping: float = 0.0
    schedule: str = "auto"
    rope_solver: str = "direct"

    def __post_init__(self) -> None:
        _checked(self, (*table.SOLVER, table.FRAME_DT))


@dataclass(frozen=True)
class Scene:
    """Named objects and colliders, wind (None: no air) and gravity [m/s^2]. Names are shared by topics and
    parameters."""

    objects: Mapping[str, Cloth | Rope] = field(default_factory=dict)
    colliders: Mapping[str, Collider] = field(default_factory=dict)
    wind: Wind | None = None
    gravity: Vector = (0.0, 0.0, -9.81)

    def __post_init__(self) -> None:
        _named(self.objects, (Cloth, Rope), "objects", "a Cloth or a Rope")
        _named(self.colliders, (Plane, Sphere, Capsule, Box), "colliders", "a Plane, Sphere, Capsule or Box")
        both = set(self.objects) & set(self.colliders)
        if both:
            raise ValueError(f"the name {min(both)!r} is given to an object and a collider; allowed is one of the two")
        if self.wind is not None and not isinstance(self.wind, Wind):
            raise ValueError(f"Scene.wind is {self.wind!r}; allowed is a Wind or None")
        _checked(self, (table.GRAVITY,))


def _named(things: Mapping, kinds: tuple, where: str, allowed: str) -> None:
    if not isinstance(things, Mapping):
        raise ValueError(f"Scene.{where} is {things!r}; allowed is a dict of name to {allowed}")
    for name, thing in things.items():
        if not isinstance(name, str) or not name or "." in name:
            raise ValueError(f"Scene.{where} has the name {name!r}; allowed is a word without dots")
        if name in ("solver", "wind", "gravity"):
            raise ValueError(f"Scene.{where} has the name {name!r}; allowed is a name that no group of parameters has")
        if not isinstance(thing, kinds):
            raise ValueError(f"Scene.{where}[{name!r}] is {thing!r}; allowed is {allowed}")
