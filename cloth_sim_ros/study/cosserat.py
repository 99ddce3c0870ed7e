# SPDX-License-Identifier: Apache-2.0
"""A solver for cosseratbench, a third-party benchmark of ropes, cables and rods, which finds it as `cloth_sim`.

It comes with `pip install cloth_sim_ros[cosserat]`. A rod becomes a Rope that is straight at rest, with a particle at
each node. A clamp of the product is two held particles, so a clamped end has one more particle behind it. A handle
holds a driven end. A load is a soft handle far away. If the answer is an equilibrium, the slowest mode is damped
critically, as in the benchmark's own solvers.
"""

from __future__ import annotations

import math
from importlib.metadata import version

import numpy as np
from cosseratbench import scenario as given
from cosseratbench.scenario import End, EndCondition, Scenario
from cosseratbench.solver import Capability, Diverged
from cosseratbench.trajectory import Trajectory
from scipy.spatial.transform import Rotation

from cloth_sim_ros.sim import Capsule, Handle, Plane, Rope, Scene, Settings, Simulation

_ERROR, _ERROR_AT_REST = 1e-5, 1e-3  # wanted errors of a motion, and on the way to an equilibrium: Settings.error
_FRAME = 1.0 / 60.0  # longest frame of the simulation [s]
_BEHIND = 0.1  # distance of the particle behind a driven end, in elements: the rod bends from its end on
_REACH = 0.2  # of the handle of a load, in elements
_FAR = 1e3  # distance of that handle [m]
_FOLLOWS = 0.05  # share of what a sliding end lacks of its load, that the next frame makes up for; waves shake more


class Solver:
    """Ropes of cloth_sim_ros in cosseratbench; the wanted error grows with `time_step_scale` squared (second order)."""

    name = "cloth_sim"
    backend_version = version("cloth_sim_ros")
    capabilities = frozenset(set(Capability) - {Capability.SHEAR})

    def __init__(self, time_step_scale: float = 1.0) -> None:
        self._scale = time_step_scale**2

    def settings(self, scenario: Scenario, *, n_elements: int, n_frames: int) -> dict[str, float]:
        """Return numbers that the benchmark shows beside the results."""
        chosen = self._settings(scenario, n_frames)
        return {"error": chosen.error, "frame_dt": chosen.frame_dt, "global_damping": chosen.global_damping}

    def _settings(self, scenario: Scenario, n_frames: int) -> Settings:
        interval = scenario.duration / (n_frames - 1)
        frame_dt = interval / math.ceil(interval / _FRAME)
        damping = 2.0 * scenario.slowest_frequency() if scenario.quasi_static else 0.0
        error = self._scale * (_ERROR_AT_REST if scenario.quasi_static else _ERROR)
        return Settings(frame_dt=frame_dt, error=error, budget=1e4, global_damping=damping)

    def run(self, scenario: Scenario, *, n_elements: int, n_frames: int) -> Trajectory:
        """Simulate rods of `n_elements` each, and return `n_frames`.

        Raises:
            Diverged: Fault recovery put a rod back.
            NotImplementedError: Rods differ in friction.
        """
        settings, (own, rub) = self._settings(scenario, n_frames), _friction(scenario)
        rods = [_Rod(f"rod{k}", rod, n_elements) for k, rod in enumerate(scenario.rods)]
        scene = Scene(
            {rod.name: rod.rope(rub, scenario.self_contact) for rod in rods},
            {f"obstacle{k}": _collider(each, own, rub) for k, each in enumerate(scenario.obstacles)},
            gravity=scenario.gravity,
            handles={end.name: end.handle for rod in rods for end in rod.ends if end.handle is not None},
            object_contact=len(rods) > 1,
        )
        sim = Simulation(scene, settings, device="cpu")
        for rod in rods:
            rod.begin(sim)
        times = np.linspace(0.0, scenario.duration, n_frames)
        seen = [[rod.nodes(sim)] for rod in rods]
        for time in times[1:]:
            while sim.time < time - 0.5 * settings.frame_dt:
                for rod in rods:
                    rod.move(sim, sim.time + settings.frame_dt)
                sim.step()
            if sim.recovered().any():
                raise Diverged("fault recovery put a rod back", time=float(time))
            for frames, rod in zip(seen, rods, strict=True):
                frames.append(rod.nodes(sim))
        positions = tuple(np.stack(frames) for frames in seen)
        turned = tuple(rod.directors(times, frames) for rod, frames in zip(rods, positions, strict=True))
        return Trajectory(times, positions, turned)


class _Rod:
    """A rod of the benchmark, and the rope that stands for it."""

    def __init__(self, name: str, rod: given.Rod, count: int) -> None:
        self.name, self._rod = name, rod
        nodes = rod.nodes(count)
        start, end = self.ends = [_End(name, rod, each, count) for each in End]
        self._nodes = slice(len(start.behind), len(start.behind) + count + 1)
        self._positions = np.concatenate([start.behind, nodes, end.behind])
        self._lengths = np.concatenate([start.lengths, np.full(count, rod.length / count), end.lengths])
        self._across = rod.directors(count)[[0, -1]]

    @property
    def _twists(self) -> bool:
        """True if both ends are clamped. Otherwise twist runs out at a free end."""
        return all(len(end.behind) for end in self.ends)

    def rope(self, friction: float, self_contact: bool) -> Rope:
        """Return the rope: straight at rest, along x."""
        rod, material, count = self._rod, self._rod.material, len(self._positions)
        points = self._positions[:1] + np.outer(np.concatenate([[0.0], np.cumsum(self._lengths)]), (1.0, 0.0, 0.0))
        masses = np.full(count, material.density * rod.area * rod.length / (self._nodes.stop - self._nodes.start - 1))
        masses[[self._nodes.start, self._nodes.stop - 1]] *= 0.5
        bending = material.youngs_modulus * rod.second_moment_of_area
        torsion = 2.0 * material.shear_modulus * rod.second_moment_of_area
        pins = [*range(self._nodes.start + 1)] if self.ends[0].is_pinned else []
        pins += [*range(self._nodes.stop - 1, count)] if self.ends[1].is_pinned else []
        return Rope(
            points=points,
            particle_masses=masses,
            radius=rod.radius,
            pins=tuple(pins) or None,
            stretch_compliance=1.0 / (material.youngs_modulus * rod.area),
            bend_compliance=1.0 / bending,
            twist_compliance=1.0 / torsion if self._twists else None,
            static_friction=friction,
            kinetic_friction=friction,
            self_contact=self_contact,
        )

    def begin(self, sim: Simulation) -> None:
        """Put the rope at its start, and let handles grasp it."""
        sim.set_positions(self.name, self._positions)
        for end in self.ends:
            end.begin(sim)

    def move(self, sim: Simulation, time: float) -> None:
        """Move driven ends to their poses at `time` [s]."""
        for end in self.ends:
            end.move(sim, time)

    def nodes(self, sim: Simulation) -> np.ndarray:
        """Return the nodes (N, 3) [m]."""
        return sim.positions(self.name).astype(np.float64)[self._nodes]

    def directors(self, times: np.ndarray, nodes: np.ndarray) -> np.ndarray:
        """Return directors (F, N - 1, 3) of rods `nodes` (F, N, 3) [m] at `times` (F,) [s].

        The first director turns with its clamp or, at a free start, by parallel transport over time. Parallel transport
        also carries it along the rod. Between two clamps an even twist is added, so that the last director meets that
        of the end.
        """
        start, end = self.ends
        tangents = np.diff(nodes, axis=1)
        tangents /= np.linalg.norm(tangents, axis=2, keepdims=True)
        first = [start.turn(time) @ self._across[0] for time in times]
        for k in range(1, 0 if len(start.behind) else len(times)):
            first[k] = _carried(first[k - 1], tangents[k - 1, 0], tangents[k, 0])
        found = np.empty_like(tangents)
        across = first - np.sum(first * tangents[:, 0], axis=1, keepdims=True) * tangents[:, 0]
        found[:, 0] = across / np.linalg.norm(across, axis=1, keepdims=True)
        for k in range(1, found.shape[1]):
            found[:, k] = _carried(found[:, k - 1], tangents[:, k - 1], tangents[:, k])
        if self._twists:
            wanted, last = np.stack([end.turn(time) @ self._across[1] for time in times]), found[:, -1]
            sine = np.sum(np.cross(last, wanted) * tangents[:, -1], axis=1)
            angles = np.unwrap(np.arctan2(sine, np.sum(last * wanted, axis=1)))[:, None, None]
            angles = angles * ((np.arange(found.shape[1]) + 0.5) / found.shape[1])[:, None]
            found = np.cos(angles) * found + np.sin(angles) * np.cross(tangents, found)
        return found


def _carried(vector: np.ndarray, before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Return unit vectors across tangents `before` (..., 3), parallel-transported to tangents `after`."""
    axis, cosine = np.cross(before, after), np.sum(before * after, axis=-1, keepdims=True)
    along = np.sum(axis * vector, axis=-1, keepdims=True)
    return cosine * vector + np.cross(axis, vector) + along / (1.0 + cosine) * axis


class _End:
    """An end of a rod: a particle behind it if it is clamped, and a handle if it is driven or pulled."""

    def __init__(self, of: str, rod: given.Rod, end: End, count: int) -> None:
        way = 1 if end is End.START else -1
        line, element = np.asarray(rod.centerline, dtype=np.float64)[::way], rod.length / count
        self.name, self.motion, self._tip = f"{of}_{end.value}", rod.motion(end), line[0]
        self._stiffness = rod.material.youngs_modulus * rod.area / rod.length  # of the whole rod [N/m]
        self.is_pinned = self.motion is None and rod.condition(end) is not EndCondition.FREE
        behind = element if self.motion is None else _BEHIND * element
        self.lengths = np.full(int(rod.condition(end) is EndCondition.CLAMPED), behind)
        outward = (line[0] - line[1]) / np.linalg.norm(line[0] - line[1])
        self.behind = line[0] + self.lengths[:, None] * outward
        self._load = np.sum([np.zeros(3), *(load.force for load in rod.loads if load.at is end)], axis=0)
        self._place, self._slid, self.handle = line[0], 0.0, None
        if self.motion is not None:
            self._place = 0.5 * (self.behind[0] + line[0])
            self.handle = Handle(tuple(self._place), reach=0.6 * self.lengths[0], object=of)
        elif self._load.any() and not self.is_pinned:
            compliance = _FAR / np.linalg.norm(self._load)
            self.handle = Handle(tuple(self._place), reach=_REACH * element, compliance=compliance, object=of)

    def begin(self, sim: Simulation) -> None:
        """Let the handle grasp. A handle that pulls goes so far away that its spring exerts the load."""
        if self.handle is not None:
            sim.attach(self.name)
        if self.handle is not None and self.motion is None:
            sim.set_handle_pose(self.name, self._place + self.handle.compliance * self._load)

    def turn(self, time: float) -> np.ndarray:
        """Return the rotation matrix (3, 3) of the end since the start."""
        return np.eye(3) if self.motion is None else self.motion.pose(time)[1]

    def move(self, sim: Simulation, time: float) -> None:
        """Move a driven end to its pose at `time` [s]. An end that slides follows the force on it."""
        if self.motion is None:
            return
        displacement, turn = self.motion.pose(time)[0], self.turn(time)
        place = self._tip + displacement + turn @ (self._place - self._tip)
        if self.motion.slides_along is not None:
            pull = sim.handle_wrench(self.name)[0] + self._load
            self._slid += _FOLLOWS * float(self.motion.axis @ pull) / self._stiffness
            place = place + self._slid * self.motion.axis
        sim.set_handle_pose(self.name, place, Rotation.from_matrix(turn).as_quat())


def _friction(scenario: Scenario) -> tuple[float, float]:
    """Return the friction of all rods in the benchmark, and that of their ropes.

    A pair has the larger coefficient there, and the geometric mean here. Ropes of frictionless rods get that of the
    roughest obstacle. Raises NotImplementedError if the two rules cannot agree.
    """
    own = {rod.friction for rod in scenario.rods}
    if len(own) > 1:
        raise NotImplementedError("rods of the same friction")
    rough = max((each.friction for each in scenario.obstacles), default=0.0)
    if own == {0.0} and rough > 0.0 and (scenario.self_contact or len(scenario.rods) > 1):
        raise NotImplementedError("rods with friction, or that touch obstacles alone")
    return max(own), max(own) or rough


def _collider(obstacle: given.Obstacle, own: float, rub: float) -> Plane | Capsule:
    """Return the collider of an obstacle, for rods with the friction `own` and ropes with `rub`."""
    friction = max(obstacle.friction, own) ** 2 / rub if rub else 0.0
    rubs = {"static_friction": friction, "kinetic_friction": friction}
    if isinstance(obstacle, given.Plane):
        return Plane(point=obstacle.point, normal=obstacle.normal, **rubs)
    turn = Rotation.align_vectors(obstacle.unit_axis[None], np.array([[0.0, 0.0, 1.0]]))[0]
    return Capsule(
        radius=obstacle.radius,
        half_length=0.5 * obstacle.length,
        position=obstacle.center,
        orientation=tuple(turn.as_quat()),
        **rubs,
    )
