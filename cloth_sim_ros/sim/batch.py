# SPDX-License-Identifier: Apache-2.0
"""The device side of all objects that share a kernel: their arrays, their state and the executor that advances them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np
import warp as wp

from cloth_sim_ros.sim import writing
from cloth_sim_ros.sim.executors.block import Block, capacity, threads_for
from cloth_sim_ros.sim.executors.graph import Graph, Member
from cloth_sim_ros.sim.executors.subdomain_plan import Unfit
from cloth_sim_ros.sim.executors.subdomains import Subdomains
from cloth_sim_ros.sim.executors.trial import Trial
from cloth_sim_ros.sim.executors.vector_rows import VectorRows, fits_rows
from cloth_sim_ros.sim.live_array import LiveArray, worlds_of
from cloth_sim_ros.sim.methods.limits import outer_steps
from cloth_sim_ros.sim.model import Features, Model
from cloth_sim_ros.sim.model_arrays import ModelArrays
from cloth_sim_ros.sim.state import Arrays, Drive, EndTurn, Frame, Material, Reel
from cloth_sim_ros.sim.state_arrays import make_states, row_of, state_of
from cloth_sim_ros.sim.topology import Topology
from cloth_sim_ros.sim.torn import Torn, own_model

Executor = Block | Graph | Subdomains | VectorRows
_forced: str | None = None
_BLOCK_OF_LINES, _GRAPH_OF_LINES = 1600, 160_000  # particles of a body and of all, on an H200
_KEPT = ("positions", "low", "good_positions", "velocities", "grips", "grip_pulls", "grip_forces")
_PAST = ("last_displacements", "last_velocities")


@contextmanager
def forced_executor(name: str | None) -> Iterator[None]:
    """For tests and studies: batches that are built within have the executor "block", "graph" or "subdomains".

    With None it is chosen, as without. Building a batch raises ValueError where a body does not fit a block of the
    device, or subdomains cannot serve it.
    """
    global _forced
    before, _forced = _forced, name
    try:
        yield
    finally:
        _forced = before


def goes_in_rows(features: Features, topology: Topology, device: wp.Device) -> bool:
    """Whether a body is computed in vector rows."""
    return _forced is None and fits_rows(features, topology, device)


@dataclass(frozen=True)
class BodyState:
    """One body in all worlds: rows of its particles (worlds, N, 4), counts (worlds, 1) and its rows of the live arrays
    (worlds,). Where it has them, also rows of Reel and Twist (worlds, 1). past: order and substeps a frame, which its
    history is of. torn: see Torn.read; None where it does not tear."""

    past: tuple[int, int]
    particles: dict[str, np.ndarray]
    counts: dict[str, np.ndarray]
    live: list[np.ndarray]
    bodies: dict[str, np.ndarray]
    torn: dict[str, np.ndarray] | None


@dataclass(frozen=True)
class Shared:
    """What all bodies of a simulation meet: colliders, handles, how many particles each of these holds (worlds, H), and
    the numbers of the scene's own forces (F,)."""

    colliders: LiveArray
    handles: LiveArray
    handle_counts: wp.array
    forces: wp.array


class Batch:
    """Bodies of equal `features`, by name, behind one another in flat arrays, in each of `worlds` worlds.

    rows: whether they are computed in vector rows. The model is there once; `states` has a row a world, and `worlds[w]`
    is what kernels know of world w.
    """

    def __init__(
        self,
        topologies: dict[str, Topology],
        features: Features,
        rows: bool,
        frame: LiveArray,
        shared: Shared,
        worlds: int,
        device: wp.Device,
    ):
        self.features, self.device = features, device
        self.index = {name: b for b, name in enumerate(topologies)}
        self._own = [array for array, has in (("reels", features.winch), ("twists", features.twist)) if has]
        self._rest = {
            name: wp.array(topology.rest[None], dtype=wp.float64, device=device)
            for name, topology in topologies.items()
        }
        self._inverse_mass = {
            name: np.where(topology.pinned, 0.0, 1.0 / topology.masses) for name, topology in topologies.items()
        }
        self._fixed = {
            name: wp.array(inverse, dtype=float, device=device) for name, inverse in self._inverse_mass.items()
        }
        self._reels = {name: _wound(topology) for name, topology in topologies.items() if topology.reel is not None}
        largest = max(len(topology.masses) for topology in topologies.values())
        self._threads = threads_for(features, largest, len(topologies) * worlds, device)
        spokes = features.method == "verlet" and not rows  # which lay out their own
        collected = ModelArrays(spokes, lanes=device.is_cpu)
        for topology in topologies.values():
            collected.add(topology)
        self.lines = collected.lines
        self._bodies = collected.bodies
        self.counts = [row["count"] for row in self._bodies]
        self.materials = LiveArray(Material, len(topologies), worlds, device)
        self.drives = LiveArray(Drive, len(topologies) if features.winch else 0, worlds, device)
        self.ends = LiveArray(EndTurn, len(topologies) if features.twist else 0, worlds, device)
        self.frame, self._shared_frame = LiveArray(Frame, 1, worlds, device), frame
        self.safe_frame = LiveArray(Frame, 1, worlds, device)
        self.substeps = self.iterations = self.safe_substeps = self._outer = 1
        self._frame_is: tuple[float, int, int, int, int] | None = None  # as it was written last
        self._live = [rows for rows in (self.materials, self.drives, self.ends) if rows.array.shape[1]]
        self.states = make_states(collected, features, shared.colliders.array.shape[1], worlds, device)
        model = collected.upload(device)
        self.worlds = [self._world(w, model, shared) for w in range(worlds)]
        self.torn = Torn(features, self.states, self.worlds, model, collected, device) if features.tears else None
        self._saved: dict[str, wp.array] | None = None
        # What meets advances together, see meeting/together.py.
        self.executor = None if features.meets else self._make_executor(rows, list(topologies.values()))
        self._trial = None
        if features.method == "verlet":
            self._trial = Trial(self.executor, self._make_safe, self.worlds, self.counts, self.lines)
        self.restart(wp.array(np.arange(worlds), dtype=int, device=device))

    def _world(self, w: int, model: Model, shared: Shared) -> Arrays:
        arrays = Arrays()
        arrays.state = state_of(self.states, w)
        arrays.model = own_model(model, arrays.state) if self.features.tears else model
        arrays.frames, arrays.materials = self.frame.array[w], self.materials.array[w]
        arrays.colliders, arrays.drives = row_of(shared.colliders.array, w), row_of(self.drives.array, w)
        arrays.handles, arrays.handle_counts = row_of(shared.handles.array, w), row_of(shared.handle_counts, w)
        arrays.forces = shared.forces
        arrays.ends = row_of(self.ends.array, w)
        return arrays

    def _make_executor(self, rows: bool, topologies: list[Topology]) -> Executor:
        if rows:
            return VectorRows(self.features, self.worlds, topologies, self.device)
        largest, limit = max(self.counts), capacity(self.device, self.features)
        # A rope is short; in a block it also leaves the forces of the air behind, which its end wrenches need.
        sheets = all(len(topology.triangles) for topology in topologies)
        if _forced == "subdomains" or (_forced is None and self.device.is_cuda and sheets):
            try:
                return Subdomains(self.features, self.worlds, [topology.layout for topology in topologies], self.device)
            except Unfit:
                if _forced == "subdomains":
                    raise
        if _forced == "block" and largest > limit:
            raise ValueError(
                f"the executor 'block' is forced on a body of {largest} particles; allowed are up to {limit} on "
                f"{self.device.alias}"
            )
        # A line solve takes a warp: a launch of all lines on all multiprocessors beats one block, until there are many.
        alone = self.device.is_cuda and self.features.lines and largest > _BLOCK_OF_LINES
        spread = alone and sum(self.counts) * len(self.worlds) < _GRAPH_OF_LINES
        if _forced == "graph" or largest > limit or (spread and _forced is None):
            return self._graph(self.features, self.worlds)
        return Block(self.features, self.worlds, self.device, largest, self._threads)

    def _graph(self, features: Features, worlds: list[Arrays]) -> Graph:
        return Graph([Member(features, worlds, self.device)], self.device)

    def _make_safe(self) -> Block | Graph:
        """XPBD of first order for bodies whose explicit frame is rejected, in substeps of its own."""
        features = replace(self.features, method="xpbd", order=1, lines=True, redoes=True)
        worlds = []
        for w, world in enumerate(self.worlds):
            arrays = Arrays()
            for name in Arrays.vars:
                setattr(arrays, name, getattr(world, name))
            arrays.frames = self.safe_frame.array[w]
            worlds.append(arrays)
        largest = max(self.counts)
        if largest > capacity(self.device, features):
            return self._graph(features, worlds)
        threads = threads_for(features, largest, len(self.counts) * len(worlds), self.device)
        return Block(features, worlds, self.device, largest, threads)

    def span(self, name: str) -> slice:
        """Where the particles of a body lie."""
        row = self._bodies[self.index[name]]
        return slice(row["particles"], row["particles"] + row["count"])

    def panels(self, name: str) -> slice:
        """Where the triangles of a sheet, or the segments of a rope, lie in Model.panels."""
        row = self._bodies[self.index[name]]
        return slice(row["panels"], row["panels_end"])

    def segments(self, name: str) -> slice:
        """Where the chain segments of a rope lie; of what has no chain, nowhere."""
        row = self._bodies[self.index[name]]
        return slice(row["segments"], row["segments_end"])

    def restart(self, chosen: wp.array) -> None:
        """All bodies to the rest shape, at rest, in the worlds of these numbers; nothing of what was before is left."""
        for rows in self.states.values():
            writing.clear(rows, slice(0, rows.shape[1]), chosen)
        if self.torn is not None:
            self.torn.mend(chosen)
        for name, reel in self._reels.items():
            for array in ("reels", "good_reels"):
                writing.put(self.states[array], self.index[name], reel, chosen)
        for name, rest in self._rest.items():
            self._put_positions(name, rest, chosen)

    def write_positions(self, name: str, positions: wp.array, chosen: wp.array) -> None:
        """Positions (worlds, N, 3) [m], or (1, N, 3) for each, into worlds of these numbers; of float64 more digits are
        kept than float32 has. History and multipliers start anew.

        What is on a drum stays there, where the first particle is put.
        """
        self._put_positions(name, positions, chosen)
        self._forget(name, chosen)

    def _put_positions(self, name: str, positions: wp.array, chosen: wp.array) -> None:
        parts = [self._part(array, self.span(name), None) for array in ("positions", "good_positions", "low")]
        inputs = [positions, self._fixed[name], chosen, self.states["reels"], self.index[name], *parts]
        dim = (len(chosen), positions.shape[1])
        wp.launch(writing.put_positions, dim=dim, inputs=inputs, device=self.device)

    def write_velocities(self, name: str, velocities: wp.array, chosen: wp.array) -> None:
        """Velocities [m/s] likewise; pinned particles stay at rest."""
        inputs = [velocities, self._fixed[name], chosen, self._part("velocities", self.span(name), None)]
        dim = (len(chosen), velocities.shape[1])
        wp.launch(writing.put_velocities, dim=dim, inputs=inputs, device=self.device)
        self._forget(name, chosen)

    def read_rows(self, array: str, name: str, world: int | None = None) -> np.ndarray:
        """A copy of a body's rows (worlds, N, 4) of an array of particles, of one world (1, N, 4) or of all."""
        return self._part(array, self.span(name), world).numpy().copy()

    def write_rows(self, array: str, name: str, rows: np.ndarray) -> None:
        """Put rows (N, 4) there in all worlds."""
        part = self._part(array, self.span(name), None)
        part.assign(np.broadcast_to(rows, (part.shape[0], *rows.shape)))

    def write_count(self, array: str, name: str, counts: np.ndarray) -> None:
        """Put a count (worlds,) of a body into an array of bodies."""
        b = self.index[name]
        self._part(array, slice(b, b + 1), None).assign(counts.reshape(-1, 1).astype(np.int32))

    def read_body(self, array: str, name: str, world: int | None) -> np.ndarray:
        """The row of "reels" or "twists" of a rope, (worlds, 1), of one world or, for None, of all."""
        b = self.index[name]
        return self._part(array, slice(b, b + 1), world).numpy()

    def write_body(self, array: str, name: str, rows: np.ndarray) -> None:
        """Put a winch or a twist where another was in all worlds, (worlds, 1) or (1, 1) rows.

        Positions are to be written after a winch, and forget a twist, which is to be written after them.
        """
        b = self.index[name]
        for each in (array, f"good_{array}"):
            part = self._part(each, slice(b, b + 1), None)
            part.assign(np.ascontiguousarray(np.broadcast_to(rows, part.shape)))

    def take(self, name: str) -> BodyState:
        """Everything of a body that outlives its arrays."""
        span, b = self.span(name), self.index[name]
        has = [array for array in (*_KEPT, *_PAST) if self.states[array].size]
        particles = {array: self._part(array, span, None).numpy() for array in has}
        has = [array for array in ("recoveries", "held", "history") if self.states[array].size]
        counts = {array: self._part(array, slice(b, b + 1), None).numpy() for array in has}
        live = [rows.read(b, None) for rows in self._live]
        past = (self.features.order, self.substeps)
        bodies = {array: self.read_body(array, name, None) for array in self._own}
        return BodyState(past, particles, counts, live, bodies, self.torn and self.torn.read(b))

    def give(self, name: str, kept: BodyState) -> None:
        """What another batch took of a body, whose pins may be others now; multipliers start anew, and so does history
        where order or substeps changed."""
        span, b = self.span(name), self.index[name]
        follows = kept.past == (self.features.order, self.substeps)
        fixed = self._inverse_mass[name] == 0.0
        for array, rows in kept.particles.items():
            if array in _PAST and not follows:
                continue
            if not self.features.winch:  # which pins what is on its drum
                rows = rows.copy()
                if array in ("positions", "good_positions"):
                    rows[..., 3] = self._inverse_mass[name]
                elif array in ("velocities", *_PAST):
                    rows[:, fixed] = 0.0
            self._part(array, span, None).assign(rows)
        for array, rows in kept.counts.items():
            if array != "history" or follows:
                self._part(array, slice(b, b + 1), None).assign(rows)
        for rows, held in zip(self._live, kept.live, strict=True):
            rows.edit()[:, b] = held
        for array, held in kept.bodies.items():
            self.write_body(array, name, held)
        if self.torn is not None:
            self.torn.write(b, kept.torn)

    def set_substeps(self, substeps: int, iterations: int, safe_substeps: int) -> None:
        """How many of each a frame has from now on, and one that is done again; other substeps have no history."""
        if substeps != self.substeps:
            self.forget_steps()
        self.substeps, self.iterations, self.safe_substeps = substeps, iterations, safe_substeps

    def write_frame(self, frame_dt: float, finer: int = 1) -> None:
        """What all objects share, and a frame of `frame_dt` [s] in `finer` times as many substeps."""
        self._frame_is = self._frame_of(frame_dt, finer)
        (substeps, iterations, self._outer), safe = self._frame_is[1:4], self._frame_is[4]
        self.frame.edit()[:] = self._shared_frame.read(0, None)[:, None]
        numbers = {"substeps": substeps, "iterations": iterations, "outer": self._outer}
        self.frame.write(0, None, dt=frame_dt / substeps, **numbers)
        self.safe_frame.edit()[:] = self._shared_frame.read(0, None)[:, None]
        self.safe_frame.write(0, None, dt=frame_dt / safe, substeps=safe, iterations=1)

    def refresh_frame(self, frame_dt: float) -> None:
        """The same where a number of the batch's own changed; what all objects share is left to the next frame."""
        if self._frame_is != self._frame_of(frame_dt, 1):
            self.write_frame(frame_dt)

    def _frame_of(self, frame_dt: float, finer: int) -> tuple[float, int, int, int, int]:
        """The length of a frame [s], its substeps, iterations and steps of slow forces, and substeps done again."""
        substeps = finer * self.substeps
        outer = max(self._outer_steps(b, frame_dt, substeps) for b in range(len(self._bodies)))
        return frame_dt, substeps, self.iterations, outer, finer * self.safe_substeps

    def _outer_steps(self, b: int, frame_dt: float, substeps: int) -> int:
        """The steps of slow forces that body b needs in a frame, in the world that needs most."""
        if not self.features.has_outer:
            return 1
        rows = self.materials.read(b, None)
        rate, softness = self._bodies[b]["plate_rate"], rows["compliance"][:, 2].astype(np.float64)
        rates = np.divide(rate, softness, out=np.zeros(len(rows)), where=(softness > 0.0) & (rate > 0.0))
        drag = float(self.frame.read(0, 0)["global_damping"][0])
        return outer_steps(substeps, frame_dt / substeps, rates, rows["damping"].astype(np.float64), drag)

    def make_ready(self) -> None:
        """Compile what only a rejected frame needs; another thread may do so meanwhile."""
        if self._trial is not None:
            self._trial.make_ready()

    def advance(self, finer: int = 1) -> None:
        """Simulate one frame, as `write_frame` was told last."""
        if self._trial is None:
            self.executor.advance(finer * self.substeps, self.iterations, self._outer)
        else:
            self._trial.advance(finer * self.substeps, self._outer, finer * self.safe_substeps)

    def upload(self) -> None:
        """Bring changed live numbers to the device."""
        self.frame.upload()
        self.safe_frame.upload()
        for rows in self._live:
            rows.upload()

    def save(self) -> None:
        """Keep the whole state aside, on the device; the room for it is taken once."""
        if self._saved is None:
            self._saved = {name: wp.empty_like(rows) for name, rows in self.states.items()}
        for name, rows in self.states.items():
            if rows.size:
                wp.copy(self._saved[name], rows)

    def restore(self) -> None:
        """The state as it was saved."""
        for name, rows in self.states.items():
            if rows.size:
                wp.copy(rows, self._saved[name])

    def forget_steps(self) -> None:
        """The length of a substep changed: order 2 starts from its first-order substep again."""
        self.states["history"].zero_()

    def _part(self, array: str, span: slice, world: int | None) -> wp.array:
        """(worlds, n) elements `span` of an array of the state, of one world or of all."""
        return self.states[array][worlds_of(world), span]

    def _forget(self, name: str, chosen: wp.array) -> None:
        segments, b = self.segments(name), self.index[name]
        for _, first, end in self.lines[b]:
            writing.clear(self.states["line_multipliers"], slice(first, end), chosen)
        spans = {}
        if segments.stop > segments.start:
            spans |= {"tensions": segments, "chain_forces": self.span(name)}
            if self.features.beam:
                spans["moments"] = segments
            if self.features.twist:
                spans |= {"couples": segments, "twists": slice(b, b + 1), "good_twists": slice(b, b + 1)}
        if self.features.looks_back:
            spans["history"] = slice(b, b + 1)
        if self.features.order == 2:
            # Whether the first substep is smooth is told by the one before it: none, from rest.
            spans |= {"last_displacements": self.span(name), "last_velocities": self.span(name)}
        for array, span in spans.items():
            writing.clear(self.states[array], span, chosen)


def _wound(topology: Topology) -> np.ndarray:
    """The row (1, 1) of Reel of a winch at rest."""
    row = np.zeros((1, 1), dtype=Reel.numpy_dtype())
    index, length = topology.reel
    row["index"], row["length"] = index, length
    row["behind"], row["total"] = topology.chain.rest[index + 1 :].sum(), topology.chain.rest.sum()
    return row
