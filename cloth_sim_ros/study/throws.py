# SPDX-License-Identifier: Apache-2.0
"""Random throws of things at sheets: the number that pass through, and the depth of the others."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

from cloth_sim_ros.sim import Box, Capsule, Cloth, Cylinder, Ellipsoid, Mesh, Scene, Settings, Simulation, Sphere
from cloth_sim_ros.sim.colliders.collider import Collider

BODY, THING = "sheet", "thing"
_SIZE, _HEIGHT, _STOP = 0.6, 1.0, 0.2  # of the sheet, where it lies, and how far beyond it the thing stops [m]
_STEPS = [(0, 0), (0, 0), (0, 0), (5, 1), (20, 1), (20, 4), (80, 1), (80, 4)]  # substeps and iterations; 0 is chosen


def _finger(**pose: object) -> Mesh:
    """A mesh of 6 cm and a radius of 1 cm."""
    shape = trimesh.creation.capsule(radius=0.01, height=0.04, count=[16, 16])
    return Mesh(shape.vertices - shape.center_mass, shape.faces, **pose)


# What is thrown, and how far it reaches from its origin [m].
THINGS: dict[str, tuple[Callable[..., Collider], float]] = {
    **{
        f"ball of {100 * radius:g} cm": (lambda radius=radius, **pose: Sphere(radius=radius, **pose), radius)
        for radius in (0.02, 0.03, 0.05, 0.1)
    },
    "capsule": (lambda **pose: Capsule(radius=0.01, half_length=0.05, **pose), 0.06),
    "thin box": (lambda **pose: Box(half_extents=(0.05, 0.05, 0.0025), **pose), 0.071),
    "cylinder": (lambda **pose: Cylinder(radius=0.015, half_length=0.04, **pose), 0.043),
    "ellipsoid": (lambda **pose: Ellipsoid(radii=(0.05, 0.03, 0.02), **pose), 0.05),
    "finger": (_finger, 0.031),
}


@dataclass(frozen=True)
class Throw:
    """A thing that comes from below at a `speed` [m/s], `aside` [m] of the middle of a sheet, turned and `spinning`.

    stiffness: that of the sheet's springs [N/m]. steps: substeps and iterations, 0 to let the solver choose.
    """

    thing: str
    speed: float
    aside: tuple[float, float]
    turn: tuple[float, ...]
    spinning: bool
    resolution: tuple[int, int]
    hung: bool
    stiffness: float
    thickness: float
    friction: float
    steps: tuple[int, int]

    def __str__(self) -> str:
        spin, held = " that spins" if self.spinning else "", "hung" if self.hung else "clamped"
        sheet = f"{self.resolution[0]} x {self.resolution[1]}, {self.stiffness:.0f} N/m, {1e3 * self.thickness:g} mm"
        steps = f"{self.steps[0]} x {self.steps[1]}" if self.steps[0] else "the defaults"
        return f"{self.thing}{spin} at {self.speed:g} m/s, a {held} sheet of {sheet}, {steps}"


def drawn(random: np.random.Generator) -> Throw:
    """Draw one of all throws."""
    side = int(random.choice([12, 16, 24, 32, 48, 64]))
    return Throw(
        thing=str(random.choice(list(THINGS))),
        speed=float(random.choice([1.0, 5.0, 10.0, 20.0])),
        aside=tuple(random.uniform(-0.1, 0.1, 2).tolist()),
        turn=tuple(Rotation.from_quat(random.standard_normal(4)).as_quat().tolist()),
        spinning=bool(random.random() < 0.4),
        resolution=(side, side if random.random() < 0.7 else int(random.choice([12, 24, 48]))),
        hung=bool(random.random() < 0.5),
        stiffness=float(10.0 ** random.uniform(2.5, 5.3)),
        thickness=float(random.choice([0.003, 0.005, 0.01])),
        friction=float(random.uniform(0.0, 1.0)),
        steps=_STEPS[random.integers(len(_STEPS))],
    )


@dataclass(frozen=True)
class Outcome:
    """Result of a throw.

    passed: True if the thing passed through a clamped sheet; a hung one gives way. depth [m]: that of the deepest
    sampled point of the sheet at the end of a frame.
    """

    passed: bool
    depth: float


def throw(each: Throw, random: np.random.Generator, device: str) -> Outcome:
    """Simulate one throw; `random` draws the turns of a spinning thing."""
    make, reach = THINGS[each.thing]
    nx, ny = each.resolution
    friction = {"static_friction": each.friction, "kinetic_friction": 0.8 * each.friction}
    sheet = Cloth(
        resolution=each.resolution,
        size=(_SIZE, _SIZE),
        position=(0.0, 0.0, _HEIGHT),
        thickness=each.thickness,
        stretch_compliance=1.0 / each.stiffness,
        shear_compliance=3.0 / each.stiffness,
        pins=(nx * (ny - 1), nx * ny - 1) if each.hung else "edges",
        **friction,
    )
    height, turn = -0.05 - reach, Rotation.from_quat(each.turn)
    thing = make(position=(*each.aside, _HEIGHT + height), orientation=each.turn, **friction)
    substeps, iterations = each.steps
    sim = Simulation(Scene({BODY: sheet}, {THING: thing}), Settings(substeps=substeps, iterations=iterations), device)
    depth, frame_dt = 0.0, sim.settings.frame_dt
    while height < _STOP:
        height = min(height + each.speed * frame_dt, _STOP)
        if each.spinning:
            turn = Rotation.from_rotvec(0.3 * random.standard_normal(3)) * turn
        sim.set_collider_pose(THING, (*each.aside, _HEIGHT + height), tuple(turn.as_quat()))
        sim.step()
        depth = max(depth, sim.report()[BODY]["max_penetration"])
    return Outcome(not each.hung and not is_above(sim, BODY, (*each.aside, _HEIGHT + height)), depth)


def is_above(sim: Simulation, name: str, point: tuple[float, ...]) -> bool:
    """Return True if a sheet lies above a point, that is, if an odd number of its triangles does."""
    corners = (sim.positions(name) - point)[sim.triangles(name)]
    following = np.roll(corners, -1, axis=1)
    areas = np.roll(corners[..., 0] * following[..., 1] - corners[..., 1] * following[..., 0], -1, axis=1)
    around = (areas > 0.0).all(axis=1) | (areas < 0.0).all(axis=1)
    return bool(((areas[around] * corners[around, :, 2]).sum(1) / areas[around].sum(1) > 0.0).sum() % 2)


def run(count: int, first: int, seed: int, device: str) -> int:
    """Throw, and print what went wrong; return 1 if anything did."""
    passed, deep = 0, 0
    for number in range(first, first + count):
        random = np.random.default_rng((seed, number))
        each = drawn(random)
        found = throw(each, random, device)
        passed, deep = passed + found.passed, deep + (not found.passed and found.depth > each.thickness)
        if found.passed or found.depth > each.thickness:
            what = "passes" if found.passed else f"gets {1e3 * found.depth:.1f} mm deep"
            print(f"{number}: {what}: {each}", flush=True)
    print(f"seed {seed}: of {count} throws {passed} pass, {deep} get deeper than the thickness")
    return 1 if passed or deep else 0
