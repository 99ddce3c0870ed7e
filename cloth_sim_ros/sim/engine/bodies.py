# SPDX-License-Identifier: Apache-2.0
"""The objects of a simulation: how each is computed, and its arrays on the device."""

from __future__ import annotations

import copy
import logging
import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import warp as wp

from cloth_sim_ros.sim.arrays.live_array import LiveArray
from cloth_sim_ros.sim.arrays.model import Features
from cloth_sim_ros.sim.arrays.poses import Motions
from cloth_sim_ros.sim.arrays.state import ColliderMotion, Frame, HandleMotion
from cloth_sim_ros.sim.colliders import shapes_of
from cloth_sim_ros.sim.colliders.collider import FASTEST, SHALLOW, Collider, least_roundness
from cloth_sim_ros.sim.engine.batch import Batch
from cloth_sim_ros.sim.engine.body_state import give, take
from cloth_sim_ros.sim.engine.coupled_bodies import CoupledBodies
from cloth_sim_ros.sim.engine.frames import LONGEST, Frames
from cloth_sim_ros.sim.engine.in_step import InStep
from cloth_sim_ros.sim.engine.scaled import at_scales
from cloth_sim_ros.sim.executors.choose import EXECUTORS
from cloth_sim_ros.sim.executors.graph import Graph
from cloth_sim_ros.sim.features.collider_contact.broad_phase import FEW
from cloth_sim_ros.sim.input.checks import WorldSelection, named, on_host, worlds_of
from cloth_sim_ros.sim.input.numbers import NumbersRow
from cloth_sim_ros.sim.kernels.device import find_device
from cloth_sim_ros.sim.physics.quaternion import Motion, moved
from cloth_sim_ros.sim.scene.objects import Cloth, Rope
from cloth_sim_ros.sim.scene.scene import Scene, kind_of
from cloth_sim_ros.sim.scene.settings import Settings
from cloth_sim_ros.sim.substeps import choose as choosing
from cloth_sim_ros.sim.substeps import prices
from cloth_sim_ros.sim.substeps.choose import Choice, distinct
from cloth_sim_ros.sim.substeps.prices import Surroundings
from cloth_sim_ros.sim.substeps.speed import speed_of
from cloth_sim_ros.sim.topology import Topology
from cloth_sim_ros.sim.topology import build as build_topology
from cloth_sim_ros.sim.topology.elements import Constraints, Stitches
from cloth_sim_ros.sim.topology.line_layout import CROWDED
from cloth_sim_ros.sim.topology.seams import stitches_of

_LOG = logging.getLogger(__name__)
_MOST_WORLDS = 65536
# Ratio of lengths up to which a collider must not slip through between particles: of a sheet, and of a rope.
_PASSING, _PASSING_ROPE = 6.0, 1.2


def _missed(error: float, wanted: float, is_bounded: bool) -> str:
    """Return the end of a reason: which error is missed, if any, and what helps. is_bounded: by the budget."""
    if is_bounded:
        missed = f"its error is {error:.3g} instead of {wanted:g}; a larger solver.budget or solver.error helps"
        return f"; the budget allows no more substeps, so {missed}"
    if error > wanted:
        missed = f"its error was {error:.3g} instead of {wanted:g} in the last half second"
        causes = "from folds, sudden motion, or frames for which the budget was too small"
        return f"; {missed}, {causes}; a larger solver.budget helps against the last"
    return ""


class Bodies:
    """The objects of `scene`, in batches that share a kernel.

    speed: of the device, see speed.py. builds: number of builds; results of `device_arrays` are valid until it changes.
    moves: name -> motion from the object's place in the scene to its start. scales: name -> Topology.world_scales.
    as_chosen: name -> how the object is computed, without what was measured since. handle_counts, handle_breaks
    (worlds, H): how many particles a handle holds, and how often it let go under load. grasps: handle -> the one object
    that it grasps, "" is any. Raises ValueError for a number of worlds or a device that is not allowed, and for a mesh
    that is not manifold.
    """

    def __init__(self, scene: Scene, settings: Settings, device: str, worlds: int, executor: str | None) -> None:
        if isinstance(worlds, bool) or not isinstance(worlds, int) or not 1 <= worlds <= _MOST_WORLDS:
            raise ValueError(f"worlds is {worlds!r}; allowed is a whole number from 1 to {_MOST_WORLDS}")
        if executor not in (None, *EXECUTORS):
            raise ValueError(f"executor is {executor!r}; allowed is {' or '.join(EXECUTORS)}, or None to choose")
        self.scene, self.worlds, self.builds = scene, worlds, 0
        self._executor = executor
        self.warp_device = find_device(device)
        self.settings, self.speed = settings, settings.speed or speed_of(self.warp_device)
        self.frame = LiveArray(Frame, 1, worlds, self.warp_device)
        rows = len(scene.colliders) + scene.spare_colliders
        self.shapes = shapes_of(scene.colliders.values(), scene.spare_colliders > 0)
        self.colliders = Motions(ColliderMotion, rows, worlds, self.warp_device)
        self.handles = Motions(HandleMotion, len(scene.handles), worlds, self.warp_device)
        self.handle_counts = wp.zeros((worlds, len(scene.handles)), dtype=int, device=self.warp_device)
        self.handle_breaks = wp.zeros_like(self.handle_counts)
        self.grasps = {name: handle.object for name, handle in scene.handles.items()}
        self.handle_row = {name: row for row, name in enumerate(scene.handles)}
        self._data = [collider.data(self.warp_device) for collider in scene.colliders.values()]  # kept alive
        self.fixed = len(scene.colliders)  # rows of the scene's own colliders, before the added ones
        self.collider_row = {name: row for row, name in enumerate(scene.colliders)}
        self.numbers = LiveArray(NumbersRow, len(scene.numbered), worlds, self.warp_device)
        self.numbers_row = {name: row for row, name in enumerate(scene.numbered)}
        for name, thing in scene.numbered.items():
            self.numbers.write(self.numbers_row[name], None, values=thing.numbers())
        self.moves: dict[str, Motion] = {}
        self.scales: dict[str, np.ndarray] = {}
        self._stitches: dict[str, list[Stitches]] = {}
        self.elastic = {name: self._topology(name, thing, False) for name, thing in scene.objects.items()}
        for name, seam in scene.seams.items():
            first, second = (self.elastic[each] for each in (seam.first, seam.second))
            found = stitches_of(name, seam, self.numbers_row[name], first, second)
            self._stitches.setdefault(seam.first, []).append(found)
        self.elastic = {name: self._sewn(name, topology) for name, topology in self.elastic.items()}
        self._shares = self._share_budget()
        self._sharpest: dict[str, Collider] = {}
        self._disturbed = False  # whether the next frame wakes bodies at rest, apart from changed numbers
        self._between: dict[str, set[str]] = {}  # object -> colliders that come between its particles

    def find_sharpest(self, names: Iterable[str]) -> None:
        """Find the sharpest size in any world of these colliders, unless some can be added: then all count as sharp."""
        sizes = self.colliders.mirrors()["rows"]["size"].astype(np.float64)
        found = {name: self.scene.colliders[name].sharpest(sizes[:, self.collider_row[name]]) for name in names}
        self._sharpest = {**self._sharpest, **found} if self.scene.spare_colliders == 0 else {}

    def write_data(self) -> None:
        """Write the device address of each collider's data; added colliders have none."""
        addresses = self.colliders.edit()["data"]
        addresses[:] = 0
        addresses[:, : self.fixed] = [data.id if data else 0 for data in self._data]

    def choose(self, name: str, materials: Iterable[tuple[Sequence[float], float]], thickness: float) -> Choice:
        """Choose how to compute an object with these pairs of compliances and damping, and this least thickness."""
        topology, around = self.elastic[name], replace(self._around(name), share=self._shares[name])
        choose = partial(choosing.choose, self.settings, topology, list(materials))
        choice = choose(around)
        entering = self._entering(topology, thickness, self.settings.frame_dt / choice.substeps)
        if entering and not choice.surface:
            choice = choose(replace(around, surface=True))
            entering |= self._entering(topology, thickness, self.settings.frame_dt / choice.substeps)
        self._between[name] = entering
        if choice.surface:
            choice = replace(choice, reason=f"{choice.reason}; colliders touch it between its particles too")
        scaled = "; its scale may differ between worlds" if name in self.scales else ""
        return replace(choice, reason=choice.reason + scaled)

    def _around(self, name: str) -> Surroundings:
        """What determines the cost of a substep of an object, apart from itself."""
        device, gravity = "cpu" if self.warp_device.is_cpu else "cuda", float(np.linalg.norm(self.scene.gravity))
        wind, spare = self.scene.wind is not None, self.scene.spare_colliders
        costs = [each.cost for each in self.scene.colliders.values()][: self.fixed] + [Collider.cost] * spare
        kinds = {"surface": spare > 0, "coupled": self._is_coupled(name), "sewn": name in self.scene.sewn}
        return Surroundings(device, wind, costs, self.worlds, gravity=gravity, speed=self.speed, **kinds)

    def _share_budget(self) -> dict[str, float]:
        """Share of the budget of each object. Those that advance in step count as one. A GPU runs objects side by side.

        Errors that fall as 1/n add up to the least where time goes with the root of the price of a substep.
        """
        if not self.warp_device.is_cpu:
            return dict.fromkeys(self.elastic, 1.0)
        damped = {name: [((), thing.damping)] for name, thing in self.scene.objects.items()}
        each = {name: prices.xpbd(topo, damped[name], self._around(name)) for name, topo in self.elastic.items()}
        group = {name: "" if name in self.scene.sewn or self._is_coupled(name) else name for name in each}
        whole = {key: sum(price for name, price in each.items() if group[name] == key) for key in set(group.values())}
        total = sum(map(math.sqrt, whole.values()))
        return {name: price / (math.sqrt(whole[group[name]]) * total) for name, price in each.items()}

    def _entering(self, topology: Topology, thickness: float, substep: float) -> set[str]:
        """Names of colliders that can come between particles, in substeps of length `substep` [s]."""
        scale = topology.scales_in().max()
        gap, passing = topology.widest_gap * scale, _PASSING * topology.widest_gap * scale
        if not len(topology.triangles):
            passing = _PASSING_ROPE * topology.widest_gap * scale
        else:
            # The fastest collider pushes one particle ahead before the others follow. No point of a triangle lies
            # farther from its corners than its longest side over the root of 3.
            passing = max(passing, gap + FASTEST * substep / math.sqrt(3.0))
        depth = max(thickness, SHALLOW * float(np.median(topology.springs["structural"].rest)) * scale)
        needed = least_roundness(gap, passing, depth, thickness)
        colliders = {**self.scene.colliders, **self._sharpest}
        return {name for name, each in colliders.items() if each.enters(needed, thickness)}

    def _choose_now(self, name: str) -> Choice:
        """Choose for an object with its current materials and masses."""
        rows = self.effective_materials(name, None)
        return self.choose(name, distinct(rows), float(rows["thickness"].min()))

    def effective_materials(
        self,
        name: str,
        world: WorldSelection,
        rows: np.ndarray | None = None,
        kg: np.ndarray | None = None,
        topology: Topology | None = None,
    ) -> np.ndarray:
        """Convert an object's materials in some worlds to the masses and scale of the scene, to choose substeps by.

        In place of its own are used: rows (k,) of Material, kg (k, 2) as in Masses, and topology.
        """
        rows = self.materials_of(name, world) if rows is None else rows
        masses, b = self.batch[name].masses, self.batch[name].index[name]
        topology = self.elastic[name] if topology is None else topology
        rows = masses.effective_materials(b, rows, masses.read(b, world) if kg is None else kg)
        return at_scales(topology, rows, topology.scales_in(worlds_of(world)))

    def name_collider(self, name: str, row: int, collider: Collider) -> None:
        """Register an added collider in this row."""
        self.scene = replace(self.scene, colliders={**self.scene.colliders, name: collider})
        self.collider_row[name] = row
        self.choose_again()

    def forget_collider(self, name: str) -> int:
        """Remove an added collider and return its row."""
        others = {each: collider for each, collider in self.scene.colliders.items() if each != name}
        self.scene = replace(self.scene, colliders=others)
        return self.collider_row.pop(name)

    def change_setting(self, name: str, value: Any) -> None:
        """Change a live setting of the solver."""
        if name == "speed":
            self.speed = value or speed_of(self.warp_device)
        self.settings = replace(self.settings, **{name: value})

    def start_elsewhere(self, name: str, motion: Motion) -> None:
        """Let an object start displaced by this motion from its place in the scene."""
        self.moves[name] = motion
        self.describe_again(name, self.scene.objects[name])

    def give_scales(self, name: str, scales: np.ndarray, world: WorldSelection) -> None:
        """Set an object's scales (worlds,); only those of `world` differ from before."""
        if name in self.scales:
            self.scales[name][:] = scales
            self.batch[name].scaled.write(self.chosen(world))
            self.choose_again()
        elif (scales != 1.0).any():
            self.scales[name] = scales
            self.describe_again(name, self.scene.objects[name])

    def build(self, choices: dict[str, Choice]) -> None:
        """Build all device arrays for these choices."""
        self.as_chosen = choices
        self.topologies = {
            name: self._topology(name, thing, True)
            if choices[name].method == "xpbd" and isinstance(thing, Rope)
            else self.elastic[name]
            for name, thing in self.scene.objects.items()
        }
        self.batches = self._make_batches()
        self.batch = {name: batch for batch in self.batches for name in batch.index}
        coupled = [batch for batch in self.batches if batch.features.in_step]
        itself = [name for name, thing in self.scene.objects.items() if thing.self_contact]
        self.coupled = CoupledBodies(coupled, self.topologies, itself, self.scene.object_contact) if coupled else None
        counted = [batch for batch in self.batches if batch.features.measured and isinstance(batch.executor, Graph)]
        groups = [InStep([batch], batch.executor) for batch in counted if not batch.features.in_step]
        groups += [self.coupled.in_step] if self.coupled is not None else []
        self.frames = Frames(self.batches, groups, self.settings.frame_dt, self.warp_device)
        self._write_limits()
        self.builds += 1

    def restart(self, chosen: wp.array) -> None:
        """Put all bodies back to their rest shape, at rest, in the worlds of these numbers."""
        for batch in self.batches:
            batch.restart(chosen)
        for group in self.frames.groups:
            group.forget()

    def _is_coupled(self, name: str) -> bool:
        """True if an object has self contact or contact with other objects."""
        return self.scene.objects[name].self_contact or (self.scene.object_contact and len(self.scene.objects) > 1)

    def advance(self) -> None:
        """Begin a frame: move colliders and handles to their wanted poses, and mark worlds in which any moves."""
        still = self.colliders.are_still and self.handles.are_still
        changed = self.wakes()
        self._disturbed = False
        self.colliders.advance(self.settings.frame_dt)
        self.handles.advance(self.settings.frame_dt)
        if not still:
            moves = self.colliders.moves() | self.handles.moves()
            if (moves != self.frame.read(0, None)["moves"]).any():
                self.frame.write(0, None, moves=moves)
        if changed != bool(self.frame.read(0, 0)["wakes"]):
            self.frame.write(0, None, wakes=changed)

    def wakes(self) -> bool:
        """True if the next frame computes bodies at rest, because live numbers or what holds them were changed."""
        live = [self.frame, self.colliders, self.handles, self.numbers]
        live += [rows for batch in self.batches for rows in batch.all_live()]
        return self._disturbed or any(rows.is_changed for rows in live)

    def wake(self, on: bool = True) -> None:
        """Let the next frame compute bodies at rest, because their state or what holds them was changed."""
        self._disturbed = on

    def alike(self, most: int) -> int:
        """Number of the next `most` frames that can run as one, because the host has no work between them."""
        still = self.colliders.are_still and self.handles.are_still
        # A frame before which anything was changed is one of a kind.
        alone = self.coupled is not None or self.frame.read(0, 0)["wakes"] > 0
        return min(most, LONGEST) if still and not alone else 1

    def _write_limits(self) -> None:
        """Give every body the bounds of its substeps, and mark the colliders that are tested against facets.

        These are the ones that can come between particles of any object.
        """
        between = set().union(*self._between.values())
        for name, row in self.collider_row.items():
            self.colliders.write(row, None, facets=self.scene.colliders[name].cost if name in between else 0)
        in_step = [name for batch in self.batches if batch.features.in_step for name in batch.index]
        for batch in self.batches:
            together = in_step if batch.features.in_step else batch.index
            batch.frame.iterations = max(self.as_chosen[name].iterations for name in together)
            for name in batch.index:
                topology, choice = self.elastic[name], self.as_chosen[name]
                sizes = float(np.ptp(topology.rest, axis=0).max()) * topology.scales_in()
                batch.frame.bound(batch.index[name], choice, self.settings, sizes, batch.features.in_step)
            batch.frame.write(self.settings.frame_dt)
        for group in self.frames.groups:
            group.forget()

    def choose_again(self) -> None:
        """Choose again for all objects; rebuild the device arrays around the state if any needs other kernels."""
        chosen = {name: self._choose_now(name) for name in self.batch}
        changed = [name for name, choice in chosen.items() if choice.kernels != self.as_chosen[name].kernels]
        if not changed:
            self.as_chosen = chosen
            self._write_limits()
            return
        self._build_around(chosen)
        for name in changed:
            _LOG.info("%s now %s", name, chosen[name].reason)

    def describe_again(self, name: str, thing: Cloth | Rope) -> None:
        """Replace the description of `name` by one with as many particles; the object keeps its state."""
        self.elastic[name] = self._topology(name, thing, False)
        self.scene = replace(self.scene, objects={**self.scene.objects, name: thing})
        self._shares = self._share_budget()
        self._build_around({each: self._choose_now(each) for each in self.batch})

    def _topology(self, name: str, thing: Cloth | Rope, direct_ropes: bool) -> Topology:
        found = build_topology(thing, name, direct_ropes, self.scene.wind is not None).at(self.scales.get(name))
        found = self._sewn(name, replace(found, constraints=self._constraints(name, len(found.masses))))
        places = ("rest", "origin") if name in self.moves else ()
        return replace(found, **{place: moved(getattr(found, place), self.moves[name]) for place in places})

    def _sewn(self, name: str, topology: Topology) -> Topology:
        """The topology of an object with the stitches of the seams that it is first in."""
        return replace(topology, stitches=tuple(self._stitches.get(name, ())))

    @property
    def _laws(self) -> tuple[str, ...]:
        """The names in CONSTRAINTS of the scene's constraints."""
        return tuple(sorted({kind_of(each) for each in self.scene.constraints.values()}))

    def _constraints(self, name: str, count: int) -> Constraints | None:
        """The constraints of an object of `count` particles. Raises ValueError if it has not that many."""
        particles, of = [], []
        for each, constraint in self.scene.constraints.items():
            if constraint.object == name:
                most = max(map(max, constraint.between))
                if most >= count:
                    raise ValueError(f"{each} joins particle {most}; allowed is 0 to {count - 1}, those of {name}")
                particles += constraint.between
                row = (self.numbers_row[each], self._laws.index(kind_of(constraint)))
                of += [row] * len(constraint.between)
        return Constraints(np.array(particles), np.array(of)) if particles else None

    def _build_around(self, choices: dict[str, Choice]) -> None:
        """Rebuild all device arrays and keep the state."""
        kept = {name: take(self.batch[name], name) for name in self.batch}
        self.build(choices)
        for name, state in kept.items():
            give(self.batch[name], name, state)
        self._write_limits()

    def derived(self, choices: dict[str, Choice], **parts: Any) -> Bodies:
        """Return bodies of the same structure with other choices, and other `parts`: attributes by name.

        They share all arrays that can stay. Nothing in `self` changes until `adopt`.
        """
        other = copy.copy(self)
        other._between = dict(self._between)
        vars(other).update(parts)
        scaled, things = bool(other.scales or self.scales), other.scene.objects
        changed = {name: thing for name, thing in things.items() if scaled or thing is not self.scene.objects[name]}
        other.elastic = {**self.elastic, **{name: other._topology(name, changed[name], False) for name in changed}}
        if changed:
            other._shares = other._share_budget()
        if changed or any(choices[name].kernels != self.as_chosen[name].kernels for name in choices):
            other.build(choices)
        other.as_chosen = choices
        return other

    def adopt(self, other: Bodies) -> None:
        """Become a copy of `other`; the caller takes care of the state."""
        vars(self).update(vars(other))
        self._write_limits()

    def _make_batches(self) -> list[Batch]:
        """Make a batch for each group of objects with equal features."""
        wind = self.scene.wind is not None
        crowded = self.warp_device.is_cuda and self.worlds * len(self.topologies) > self.warp_device.sm_count
        alike: dict[tuple[Features, str], dict[str, Topology]] = {}
        for name, topo in self.topologies.items():
            choice = self.as_chosen[name]
            features = Features.of(topo, wind, self.shapes, choice.order, choice.method, self.worlds > 1)
            features = replace(
                features,
                forces=tuple(map(kind_of, self.scene.forces.values())),
                constraints=self._laws if topo.constraints is not None else (),
                handles=bool(self.scene.handles),
                pinches=any(collider.opposite for collider in self.scene.colliders.values()),
                surface=choice.surface,
                coupled=self._is_coupled(name),
                sewn=name in self.scene.sewn,
                listed=self.colliders.array.shape[1] > FEW,
                line_slots=max(features.line_slots, CROWDED if crowded else 1),
            )
            alike.setdefault((features, name if name in self.scales else ""), {})[name] = topo
        return [Batch(bodies, features, self, self._executor) for (features, _), bodies in alike.items()]

    def materials_of(self, name: str, world: WorldSelection) -> np.ndarray:
        """Current rows of Material of an object in some worlds."""
        batch = self.batch[name]
        return batch.materials.read(batch.index[name], world)

    @property
    def device(self) -> str:
        """The device's name, such as "cpu" or "cuda:0"."""
        return self.warp_device.alias

    @property
    def method(self) -> str:
        """Methods, orders and executors as text for diagnostics."""
        kinds = {
            f"{self.as_chosen[name].words}, {type(batch.executor).__module__.rpartition('.')[2].replace('_', ' ')}"
            for batch in self.batches
            for name in batch.index
        }
        words = ("auto: " if self.settings.method == "auto" else "") + (" and ".join(sorted(kinds)) or "empty scene")
        return words + (f", {self.worlds} worlds" if self.worlds > 1 else "")

    @property
    def choices(self) -> dict[str, Choice]:
        """Name -> how the object is computed in the next frame, with the reason; waits for the device.

        Substeps and error are the most in any world. The error is the wanted one until one is measured.
        """
        found = dict(self.as_chosen)
        for name, choice in found.items():
            batch = self.batch[name]
            if batch.measurement is not None:
                b = batch.index[name]
                error = batch.error(b)[1] or choice.error
                substeps, reason = batch.substeps(b), choice.reason
                if substeps < choice.least:
                    reason += f"; contact leaves it {substeps} of at least {choice.least} substeps, so it is softer"
                if not self.settings.substeps:
                    reason += _missed(error, self.settings.error, batch.falls_short(b, self.settings.error))
                found[name] = replace(choice, substeps=substeps, error=error, reason=reason)
        return found

    def one(self, world: int) -> int:
        """Return `world` if it is the number of a world, else raise ValueError."""
        if isinstance(world, bool) or not isinstance(world, int) or not 0 <= world < self.worlds:
            raise ValueError(f"world is {world!r}; allowed is a whole number from 0 to {self.worlds - 1}")
        return world

    def some(self, world: Any) -> WorldSelection:
        """Return `world` if it is None (all) or the number of a world.

        For a mask (worlds,) of bool, return the numbers of its worlds. Raises ValueError for anything else.
        """
        if world is None or not (len(world.shape) if hasattr(world, "shape") else np.ndim(world)):
            return None if world is None else self.one(world)
        mask = on_host(world)
        if mask.shape != (self.worlds,) or mask.dtype != bool:
            raise ValueError(
                f"the mask of worlds has shape {mask.shape} of {mask.dtype}; allowed is ({self.worlds},) of bool"
            )
        return np.flatnonzero(mask)

    def chosen(self, some: WorldSelection) -> wp.array:
        """Numbers (k,) int32 of some worlds, on the device."""
        numbers = np.arange(self.worlds)[worlds_of(some)]
        return wp.array(numbers, dtype=int, device=self.warp_device)

    def topology(self, name: str) -> Topology:
        """The current topology of an object. Raises ValueError if there is none of that name."""
        return named(self.topologies, name, "object")
