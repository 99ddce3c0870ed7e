# SPDX-License-Identifier: Apache-2.0
"""The device side of all objects that share a kernel: their arrays, their state and the executor that advances them."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import warp as wp

from cloth_sim_ros.sim.arrays import writing
from cloth_sim_ros.sim.arrays.live_array import LiveArray
from cloth_sim_ros.sim.arrays.masses import Masses
from cloth_sim_ros.sim.arrays.model import Features, Model
from cloth_sim_ros.sim.arrays.model_arrays import ModelArrays
from cloth_sim_ros.sim.arrays.state import Arrays, Material
from cloth_sim_ros.sim.engine.batch_frame import BatchFrame
from cloth_sim_ros.sim.engine.frame import run_frame
from cloth_sim_ros.sim.engine.ledger import Ledger
from cloth_sim_ros.sim.engine.measure import Measurement, threads_of
from cloth_sim_ros.sim.engine.saved import Saved
from cloth_sim_ros.sim.engine.scaled import Scaled
from cloth_sim_ros.sim.engine.state_arrays import make_states, row_of, rows_by_array, state_of
from cloth_sim_ros.sim.engine.torn import Torn
from cloth_sim_ros.sim.executors.block import Block
from cloth_sim_ros.sim.executors.choose import make_executor, make_safe_executor
from cloth_sim_ros.sim.executors.trial import Trial
from cloth_sim_ros.sim.features.tearing.arrays import LEFT
from cloth_sim_ros.sim.features.twist.arrays import EndTurn
from cloth_sim_ros.sim.features.winch.arrays import Drive, WinchState
from cloth_sim_ros.sim.input.checks import WorldSelection, worlds_of
from cloth_sim_ros.sim.kernels.compiled import loading
from cloth_sim_ros.sim.substeps.control import control
from cloth_sim_ros.sim.substeps.energy import find_energies
from cloth_sim_ros.sim.topology import Topology


class Batch:
    """Bodies of equal `features`, by name, behind one another in flat arrays, in each of `worlds` worlds.

    All worlds share one model, except for a `scaled` body, which is alone in its batch. `states` has a row per world.
    `worlds[w]` are the Arrays of world w, and `given` is all of them in one array, for kernels. rest: name -> rest
    positions in the form of `write_positions`. shared: the Bodies, with the live numbers that all batches share.
    """

    def __init__(self, topologies: dict[str, Topology], features: Features, shared: Any, executor: str | None):
        worlds, device = shared.worlds, shared.warp_device
        self.features, self.device = features, device
        self.index = {name: b for b, name in enumerate(topologies)}
        self._local, self.rest = (
            {name: wp.array(getattr(t, part)[None], dtype=wp.float64, device=device) for name, t in topologies.items()}
            for part in ("layout", "rest")
        )
        self._winches = {name: _wound(topology) for name, topology in topologies.items() if topology.winch is not None}
        collected = ModelArrays(features.method == "verlet", device.is_cpu, features.line_slots)
        for topology in topologies.values():
            collected.add(topology)
        self.lines = collected.lines
        self._bodies, self._stitches = collected.bodies, collected.stitches
        self.counts = [row["count"] for row in self._bodies]
        self._spans = [slice(row["particles"], row["particles"] + row["count"]) for row in self._bodies]
        self.materials = LiveArray(Material, len(topologies), worlds, device)
        self.drives = LiveArray(Drive, len(topologies) if features.winch else 0, worlds, device)
        self.ends = LiveArray(EndTurn, len(topologies) if features.twist else 0, worlds, device)
        name, topology = next(iter(topologies.items()))
        self.scaled = Scaled(topology, collected, device) if topology.world_scales is not None else None
        if self.scaled is not None:
            self._local[name], self.rest[name] = self.scaled.layout, self.scaled.rest
        self.frame = BatchFrame(shared.frame, len(topologies), worlds, device)
        self.live = [rows for rows in (self.materials, self.drives, self.ends) if rows.array.shape[1]]
        colliders = shared.colliders.array.shape[1]
        state, self.states = make_states(collected, features, colliders, worlds, device)
        self.masses = Masses(list(topologies.values()), self._spans, self.materials, worlds, device)
        model = collected.upload(device)
        self.worlds = [self._world(w, model, shared) for w in range(worlds)]
        self.given = wp.array(self.worlds, dtype=Arrays, device=device)
        self.torn = Torn(features, self.states, self.given, model, collected, device) if features.tears else None
        # Bodies in step advance together, see engine/coupled_bodies.py.
        self.executor = None
        if not features.in_step:
            with loading(_measuring(features, max(self.counts), device), device):
                self.executor = make_executor(features, self.worlds, self.counts, device, executor)
        self.saved = self.measurement = self.ledger = None
        if features.measured:
            second, block = features.order == 2, threads_of(max(self.counts), device)
            alone = isinstance(self.executor, Block)
            self.saved = Saved(state, self.states, colliders if features.listed else 0)
            self.measurement = Measurement(
                self.given, self.saved, collected.particles, second, alone, features.chain, block
            )
        if features.audited:
            self.ledger = Ledger(self.given, self.saved, self.lines, second, block, max(self.counts))
        self._trial = None
        if features.method == "verlet":
            frame = self.frame
            numbers = (frame.safe_rows.array, frame.safe_limits.array)
            safe = partial(make_safe_executor, features, self.worlds, numbers, self.counts, device)
            self._trial = Trial(self._advance_explicit, safe, self.worlds, self.counts, self.lines)
        self.restart(wp.array(np.arange(worlds), dtype=int, device=device))

    def _world(self, w: int, model: Model, shared: Any) -> Arrays:
        arrays = Arrays()
        arrays.state = state_of(self.states, w)
        own = {name: getattr(arrays.state.tearing, name) for name in LEFT} if self.features.tears else {}
        if self.features.winch:
            own = {"particle_masses": self.masses.masses[w]}
        if self.scaled is not None:
            own = {name: rows[w] for name, rows in self.scaled.own.items()}
        arrays.model = _with_own(model, own) if own else model
        arrays.frames, arrays.materials = self.frame.rows.array[w], self.materials.array[w]
        arrays.limits = self.frame.limits.array[w]
        arrays.colliders, arrays.drives = row_of(shared.colliders.array, w), row_of(self.drives.array, w)
        arrays.handles, arrays.handle_counts = row_of(shared.handles.array, w), row_of(shared.handle_counts, w)
        arrays.numbers = row_of(shared.numbers.array, w)
        arrays.ends = row_of(self.ends.array, w)
        return arrays

    def span(self, name: str) -> slice:
        """Slice of a body's particles."""
        return self._spans[self.index[name]]

    def panels(self, name: str) -> slice:
        """Slice of a sheet's triangles, or of a rope's segments, in Model.panels."""
        row = self._bodies[self.index[name]]
        return slice(row["panels"], row["panels_end"])

    def segments(self, name: str) -> slice:
        """Slice of a rope's chain segments; empty for a body without a chain."""
        row = self._bodies[self.index[name]]
        return slice(row["segments"], row["segments_end"])

    def stitches(self, name: str) -> slice:
        """Slice of the stitches of the seams that a body is first in."""
        return self._stitches[self.index[name]]

    def write_masses(self, name: str, kg: np.ndarray, world: WorldSelection) -> None:
        """Set a body's mass and end mass (k, 2) [kg] in some worlds; particles pinned or on a drum stay held."""
        b, span = self.index[name], self.span(name)
        self.masses.write(b, world, kg)
        self.masses.put(b, world, [self.part(array, span, None) for array in ("positions", "good_positions")])

    def restart(self, chosen: wp.array) -> None:
        """Reset all bodies to their rest shape, at rest, in the worlds of these numbers; clear all other state."""
        for rows in self.states.values():
            writing.clear(rows, slice(0, rows.shape[1]), chosen)
        if self.torn is not None:
            self.torn.mend(chosen)
        for name, winch in self._winches.items():
            for array in ("winches", "good_winches"):
                writing.put(self.states[array], self.index[name], winch, chosen)
        for name, rest in self.rest.items():
            self._put_positions(name, rest, chosen)

    def write_positions(self, name: str, positions: wp.array, chosen: wp.array) -> None:
        """Write positions (worlds, N, 3) [m], or (1, N, 3) for all, in worlds of these numbers.

        float64 positions keep more digits than float32 has. History and multipliers are cleared. Particles on a drum
        stay there, at the position of the first particle.
        """
        self._put_positions(name, positions, chosen)
        self._forget(name, chosen)

    def _put_positions(self, name: str, positions: wp.array, chosen: wp.array) -> None:
        parts = [self.part(array, self.span(name), None) for array in ("positions", "good_positions", "position_lo")]
        inverse = self.masses.inverse[:, self.span(name)]
        inputs = [positions, inverse, chosen, self.states["winches"], self.index[name], *parts]
        dim = (len(chosen), positions.shape[1])
        wp.launch(writing.put_positions, dim=dim, inputs=inputs, device=self.device)

    def write_pose(self, name: str, poses: np.ndarray, chosen: wp.array) -> None:
        """Place a body in its rest shape, at rest, at poses (worlds, 7) in these worlds.

        A pose is x y z [m], then a unit quaternion x y z w.
        """
        points, poses = self._local[name], wp.array(poses, dtype=wp.float64, device=self.device)
        values = wp.zeros((poses.shape[0], *points.shape[1:]), dtype=wp.float64, device=self.device)
        dim = (len(chosen), points.shape[1])
        wp.launch(writing.place, dim=dim, inputs=[points, poses, chosen, values], device=self.device)
        self.write_positions(name, values, chosen)
        writing.clear(self.states["velocities"], self.span(name), chosen)

    def write_velocities(self, name: str, velocities: wp.array, chosen: wp.array) -> None:
        """Write velocities [m/s] likewise; pinned particles stay at rest."""
        inverse = self.masses.inverse[:, self.span(name)]
        inputs = [velocities, inverse, chosen, self.part("velocities", self.span(name), None)]
        dim = (len(chosen), velocities.shape[1])
        wp.launch(writing.put_velocities, dim=dim, inputs=inputs, device=self.device)
        self._forget(name, chosen)

    def read_rows(self, array: str, name: str, world: int | None = None) -> np.ndarray:
        """Copy a body's rows of a particle array: (1, N, 4) of one world, or (worlds, N, 4) of all."""
        return self.part(array, self.span(name), world).numpy().copy()

    def write_rows(self, array: str, name: str, rows: np.ndarray) -> None:
        """Write rows (N, 4) of a body's particles in all worlds."""
        part = self.part(array, self.span(name), None)
        part.assign(np.broadcast_to(rows, (part.shape[0], *rows.shape)))

    def write_count(self, array: str, name: str, counts: np.ndarray) -> None:
        """Write a body's counts (worlds,) into an array of bodies."""
        b = self.index[name]
        self.part(array, slice(b, b + 1), None).assign(counts.reshape(-1, 1).astype(np.int32))

    def read_body(self, array: str, name: str, world: int | None) -> np.ndarray:
        """Read a rope's row of "winches" or "twists" (worlds, 1), of one world or, for None, of all."""
        b = self.index[name]
        return self.part(array, slice(b, b + 1), world).numpy()

    def write_body(self, array: str, name: str, rows: np.ndarray) -> None:
        """Write a winch or a twist in all worlds, from (worlds, 1) or (1, 1) rows.

        Write positions after a winch. Writing positions clears the twist, so write a twist after them.
        """
        b = self.index[name]
        for each in (array, f"good_{array}"):
            part = self.part(each, slice(b, b + 1), None)
            part.assign(np.ascontiguousarray(np.broadcast_to(rows, part.shape)))

    def make_ready(self) -> None:
        """Compile the kernels that only a rejected frame needs; may run in another thread."""
        if self._trial is not None:
            self._trial.make_ready()

    def advance(self, measured: bool) -> None:
        """Simulate one frame with the numbers last uploaded; if it is `measured`, choose the substeps of the next."""
        if self._trial is not None:
            self._trial.advance()
        else:
            run_frame([self], measured, lambda divisor: self.executor.advance(), self.executor.advance)

    def _advance_explicit(self) -> None:
        if isinstance(self.executor, Block):
            self.executor.advance()
        else:
            self.executor.advance(self.substeps(), self.frame.iterations)

    def substeps(self, b: int | None = None, world: int | None = None) -> int:
        """Most substeps that a body, or body b of one world, takes in the next frame.

        If they are measured, it waits for the device.
        """
        each = self._substeps()[worlds_of(world)]
        return int((each if b is None else each[:, b]).max())

    def _substeps(self) -> np.ndarray:
        """Substeps (worlds, B) of the next frame."""
        limits = self.frame.limits.mirrors()["rows"]
        if self.measurement is None:
            return limits["start"]
        chosen = self.states["substeps"].numpy()
        bounded = np.clip(chosen, limits["fewest"], limits["most"]) if self.frame.limits.is_changed else chosen
        return np.where(chosen > 0, bounded, limits["start"])

    def falls_short(self, b: int, wanted: float) -> bool:
        """True if the error of body b exceeds the wanted one in a world where its budget pays no more substeps."""
        limits, most = self.frame.limits.mirrors()["rows"][:, b], self.measurement.most.numpy()[:, b]
        pays = np.where((most > 0) & (not self.frame.limits.is_changed), most, limits["most"])
        errors = self.states["errors"].numpy()[:, b, 2:].max(axis=1)
        return bool(((errors > wanted) & (self._substeps()[:, b] >= pays)).any())

    def error(self, b: int, world: int | None = None) -> tuple[float, float]:
        """Measured error of body b: that of the last measured frame [m], and the share in the units of solver.error.

        The largest over all worlds if `world` is None; waits for the device.
        """
        frame, _, now, before = self.states["errors"].numpy()[worlds_of(world), b].max(axis=0).tolist()
        return frame, max(now, before)

    def all_live(self) -> list[LiveArray]:
        """The live numbers whose change wakes bodies at rest."""
        return [*self.live, self.frame.limits]

    def upload(self) -> None:
        """Copy changed live numbers to the device, and bring the substeps within changed limits."""
        bounded = self.frame.limits.is_changed and self.measurement is not None
        self.frame.upload()
        if bounded:
            self.measurement.change(0)
        for rows in self.live:
            rows.upload()

    def part(self, array: str, span: slice, world: int | None) -> wp.array:
        """View (worlds, n) of elements `span` of a state array, of one world or of all."""
        return self.states[array][worlds_of(world), span]

    def spans(self, name: str) -> dict[str, list[slice]]:
        """Kind of rows, see `rows_by_array` -> where those of a body are."""
        b, span = self.index[name], self.span(name)
        each = self.states["contacts"].shape[1] // self.states["positions"].shape[1]
        return {
            **dict.fromkeys(("count", "body"), [slice(b, b + 1)]),
            "particle": [span],
            "segment": [self.segments(name)],
            "stitch": [self.stitches(name)],
            "line": [slice(first, end) for _, first, end in self.lines[b]],
            "contact": [slice(each * span.start, each * span.stop)],
        }

    def _forget(self, name: str, chosen: wp.array) -> None:
        spans = self.spans(name)
        # A substep counts as smooth by the one before it, so clear those, as from rest.
        core = {"history": "body", "last_displacements": "particle", "last_velocities": "particle"}
        for array, row in (core | rows_by_array("FORGOTTEN")).items():
            for span in spans[row] if self.states[array].size else ():
                writing.clear(self.states[array], span, chosen)


def _measuring(features: Features, largest: int, device: wp.Device) -> dict[wp.Kernel, int]:
    """Kernels that measure bodies of up to `largest` particles, one of each module, and the threads of their blocks."""
    kernels = [control] * features.measured + [find_energies] * features.audited
    return dict.fromkeys(kernels, threads_of(largest, device))


def _with_own(model: Model, own: dict[str, wp.array]) -> Model:
    """The model of one world, with some arrays replaced by its own."""
    found = Model()
    for name in Model.vars:
        setattr(found, name, own.get(name, getattr(model, name)))
    return found


def _wound(topology: Topology) -> np.ndarray:
    """WinchState row (1, 1) of a winch at rest."""
    row = np.zeros((1, 1), dtype=WinchState.numpy_dtype())
    index, length = topology.winch
    row["index"], row["length"] = index, length
    row["behind"], row["total"] = topology.chain.rest[index + 1 :].sum(), topology.chain.rest.sum()
    return row
