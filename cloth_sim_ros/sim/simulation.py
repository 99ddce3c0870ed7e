"""The public face: a scene and settings on a device, advanced frame by frame and read back by name."""

from __future__ import annotations

import logging
from typing import Any

import numpy as np
import warp as wp

from cloth_sim_ros.sim import topology
from cloth_sim_ros.sim.batch import Batch
from cloth_sim_ros.sim.checks import finite_array
from cloth_sim_ros.sim.choice import STRAINED, Choice, choose, is_strained
from cloth_sim_ros.sim.colliders import shapes_of
from cloth_sim_ros.sim.live import Live, compliances_of, distinct, names_of
from cloth_sim_ros.sim.live_array import LiveArray
from cloth_sim_ros.sim.model import Features
from cloth_sim_ros.sim.objects import Rope
from cloth_sim_ros.sim.poses import Colliders
from cloth_sim_ros.sim.report import Reporter
from cloth_sim_ros.sim.ropes import Ropes
from cloth_sim_ros.sim.scene import Scene
from cloth_sim_ros.sim.schedules.resident import capacity
from cloth_sim_ros.sim.schedules.rows import fits_rows
from cloth_sim_ros.sim.settings import Settings
from cloth_sim_ros.sim.starts import off_symmetry
from cloth_sim_ros.sim.state import Arrays, Frame

_LOG = logging.getLogger(__name__)
_MOST_WORLDS = 65536
_FAR = 1e6  # [m] the largest coordinate that positions may be given in


class Simulation(Ropes, Live):
    """Cloths and ropes of `scene`, computed as `settings` say on `device` ("cpu", "cuda:0" or "auto").

    Whatever takes a value raises ValueError with one sentence where the value cannot be, and changes nothing then.
    `step` may return before a GPU is done; whatever reads the state waits. `worlds` copies of the scene run side by
    side in the same launches, each with its own state, materials, collider poses, wind and gravity: what reads takes
    the number of a world, what writes takes one or, with None, all of them.
    """

    def __init__(self, scene: Scene, settings: Settings | None = None, device: str = "auto", worlds: int = 1) -> None:
        if isinstance(worlds, bool) or not isinstance(worlds, int) or not 1 <= worlds <= _MOST_WORLDS:
            raise ValueError(f"worlds is {worlds!r}; allowed is a whole number from 1 to {_MOST_WORLDS}")
        self.scene, self.settings, self.worlds = scene, settings or Settings(), worlds
        self._device = _find_device(device)
        self._frame = LiveArray(Frame, 1, worlds, self._device)
        self._colliders = Colliders(len(scene.colliders), worlds, self._device)
        self._collider_row = {name: row for row, name in enumerate(scene.colliders)}
        self._elastic = {name: topology.build(thing, name, False) for name, thing in scene.objects.items()}
        self._strained: set[str] = set()
        for name, thing in scene.objects.items():
            self._check_rope(name, thing)
        if self.settings.method == "verlet":
            for name, thing in scene.objects.items():
                self._check_explicit(name, compliances_of(thing), thing.damping, self.settings.substeps)
        self.builds = 0
        alike = {name: {(tuple(compliances_of(thing)), thing.damping)} for name, thing in scene.objects.items()}
        self._build({name: self._choose(name, materials) for name, materials in alike.items()})
        self._reporter = Reporter(self._device)
        self._frames = 0
        self._write_settings()
        self._write_scene()

    def _choose(self, name: str, materials: set[tuple]) -> Choice:
        return choose(
            self.settings, self._elastic[name], materials, self.scene.wind is not None, name in self._strained
        )

    def _build(self, choices: dict[str, Choice]) -> None:
        """Everything on the device, for these methods."""
        self._choices = choices
        self._topologies = {
            name: topology.build(thing, name, True)
            if self.settings.rope_solver == "direct" and choices[name].method == "xpbd" and isinstance(thing, Rope)
            else self._elastic[name]
            for name, thing in self.scene.objects.items()
        }
        self._batches = self._make_batches()
        self._batch = {name: batch for batch in self._batches for name in batch.index}
        self.builds += 1

    def _choose_again(self) -> None:
        """Where method auto now takes another method for an object, the device's side is built anew around the
        state."""
        if self.settings.method != "auto":
            return
        chosen = {name: self._choose(name, distinct(self._materials(name, None))) for name in self._batch}
        changed = [name for name, choice in chosen.items() if choice.words != self._choices[name].words]
        if not changed:
            self._choices = chosen
            return
        kept = {name: self._batch[name].take(name) for name in self._batch}
        self._build(chosen)
        for name, state in kept.items():
            self._batch[name].give(name, state)
        for name in changed:
            _LOG.info("%s now %s", name, chosen[name].reason)

    def _make_batches(self) -> list[Batch]:
        shapes = shapes_of(self.scene.colliders.values())
        wind = self.scene.wind is not None
        alike: dict[tuple[Features, str], dict[str, topology.Topology]] = {}
        for name, topo in self._topologies.items():
            choice, schedule = self._choices[name], self.settings.schedule
            features = Features.of(topo, wind, shapes, choice.order, choice.method, self.worlds > 1)
            if schedule == "auto" and fits_rows(features, topo, self._device):
                schedule = "rows"
            alike.setdefault((features, schedule), {})[name] = topo
        return [
            Batch(bodies, features, schedule, self._frame, self._colliders, self.worlds, self._device)
            for (features, schedule), bodies in alike.items()
        ]

    # -- what the scene holds ------------------------------------------------------------------------------------

    @property
    def device(self) -> str:
        """The device's name, such as "cpu" or "cuda:0"."""
        return self._device.alias

    @property
    def method(self) -> str:
        """Methods, orders and schedules in words, for diagnostics."""
        kinds = {
            f"{self._choices[name].words}, {type(batch.schedule).__name__.lower()}"
            for batch in self._batches
            for name in batch.index
        }
        words = ("auto: " if self.settings.method == "auto" else "") + (" and ".join(sorted(kinds)) or "empty scene")
        return words + (f", {self.worlds} worlds" if self.worlds > 1 else "")

    @property
    def choices(self) -> dict[str, Choice]:
        """Name -> how the object is computed now, in all worlds, and why."""
        return dict(self._choices)

    @property
    def fits_a_block(self) -> bool:
        """Whether the resident schedule can hold every object, each in one block of the device."""
        return all(max(batch.counts) <= capacity(self._device, batch.features) for batch in self._batches)

    @property
    def time(self) -> float:
        """Simulated time since construction or reset of all worlds [s]."""
        return self._frames * self.settings.frame_dt

    def masses(self, name: str) -> np.ndarray:
        """Masses (N,) float64 [kg], pinned particles included."""
        return self._topology(name).masses.copy()

    def triangles(self, name: str) -> np.ndarray:
        """Triangles (T, 3) int32, counter-clockwise seen from their normals; none for a rope."""
        return self._topology(name).triangles.astype(np.int32)

    def rest_positions(self, name: str) -> np.ndarray:
        """Rest positions (N, 3) float32 [m] in the world."""
        return self._topology(name).rest.astype(np.float32)

    def springs(self, name: str, world: int = 0) -> dict[str, tuple[np.ndarray, np.ndarray, np.ndarray]]:
        """Kind -> (pairs (S, 2) int, rest_length (S,) [m], constant (S,) [N/m], infinite where rigid), as they are
        now."""
        topo, batch = self._topology(name), self._batch[name]
        kinds = dict(topo.springs)
        if topo.chain is not None:
            kinds["structural"] = topo.chain
        compliance = batch.materials.read(batch.index[name], self._one(world))["compliance"][0]
        found = {}
        for kind, elements in kinds.items():
            with np.errstate(divide="ignore"):
                constant = 1.0 / (float(compliance[topology.KINDS.index(kind)]) * elements.scale)
            found[kind] = (elements.particles.astype(np.int64), elements.rest.copy(), constant)
        return found

    # -- time ----------------------------------------------------------------------------------------------------

    def step(self, frames: int = 1) -> None:
        """Simulate `frames` frames of settings.frame_dt each."""
        for _ in range(frames):
            self._colliders.advance()
            self._upload()
            for batch in self._batches:
                batch.schedule.advance(self.settings.substeps, self.settings.iterations)
            self._frames += 1

    def step_and_estimate(self) -> dict[str, float]:
        """One frame as by `step`, to the same bits, and name -> by how much it goes astray in world 0 [m].

        That is the RMS error over the particles of this frame alone, as it would be from the exact state, by Richardson
        from two trials with the set and with twice the substeps (docs/study.md says how well it tracks the true error).
        Takes four frames' time, and memory for a second state.
        """
        self._colliders.advance()
        self._upload()
        substeps = self.settings.substeps
        for batch in self._batches:
            batch.save()
        trials = [self._trial(substeps), self._trial(2 * substeps)]
        self._write_settings()
        self._upload()
        for batch in self._batches:
            batch.schedule.advance(substeps, self.settings.iterations)
        self._frames += 1
        second = {name: choice.method == "verlet" or choice.order == 2 for name, choice in self._choices.items()}
        apart = {name: np.sqrt(((trials[0][name] - trials[1][name]) ** 2).sum(1).mean()) for name in self._batch}
        return {name: float((4.0 / 3.0 if second[name] else 2.0) * apart[name]) for name in self._batch}

    def _trial(self, substeps: int) -> dict[str, np.ndarray]:
        """Positions after the frame with `substeps`, from its start without history; the state is put back."""
        self._frame.write(0, None, dt=self.settings.frame_dt / substeps, substeps=substeps)
        self._upload()
        for batch in self._batches:
            batch.forget_steps()
            batch.schedule.advance(substeps, self.settings.iterations)
        found = {}
        for name in self._batch:
            arrays, span, _ = self.device_arrays(name)
            high, low = (rows[span].numpy()[:, :3] for rows in (arrays.state.positions, arrays.state.low))
            found[name] = high.astype(np.float64) + low
        for batch in self._batches:
            batch.restore()
        return found

    def reset(self, world: int | None = None) -> None:
        """Objects and colliders back to where the scene put them, at rest; live parameters stay as they are.

        Resetting all worlds (None) sets the time to 0; one world alone goes on with the time of the others.
        """
        self._some(world)
        for batch in self._batches:
            for name in batch.index:
                batch.reset(name, world)
        for name, collider in self.scene.colliders.items():
            self._colliders.place(self._collider_row[name], world, collider.position, collider.orientation)
        if world is None:
            self._frames = 0
            self._strained.clear()
            self._choose_again()

    def _upload(self) -> None:
        self._frame.upload()
        self._colliders.upload()
        for batch in self._batches:
            batch.upload()

    # -- state ---------------------------------------------------------------------------------------------------

    def positions(self, name: str, world: int = 0) -> np.ndarray:
        """Positions (N, 3) float32 [m] in one world."""
        arrays, span, _ = self.device_arrays(name, world)
        return np.ascontiguousarray(arrays.state.positions[span].numpy()[:, :3])

    def velocities(self, name: str, world: int = 0) -> np.ndarray:
        """Velocities (N, 3) float32 [m/s] in one world."""
        arrays, span, _ = self.device_arrays(name, world)
        return np.ascontiguousarray(arrays.state.velocities[span].numpy()[:, :3])

    def take_over(self, name: str, other: Simulation) -> None:
        """An object goes on, in all worlds, from where it is in the first world of another simulation that has it with
        the same structure: positions, velocities, what a winch has paid out and the twist."""
        batch, source = self._batch[name], other._batch[name]
        if batch.features.winch:
            batch.write_body("reels", name, source.read_body("reels", name, 0), None)
        rows = other.positions(name)
        self._leave_if_strained(name, rows)
        self._batch[name].write_positions(name, rows, None)
        self.set_velocities(name, other.velocities(name))
        if batch.features.twist:
            batch.write_body("twists", name, source.read_body("twists", name, 0), None)

    def set_positions(self, name: str, positions: Any, world: int | None = None) -> None:
        """Move all particles to `positions` (N, 3) [m], pinned ones too; history and multipliers start anew.

        Those that strain a spring by more than half are taken with a nudge, see starts.off_symmetry.
        """
        rows = self._rows(name, positions, "positions", _FAR)
        if self._leave_if_strained(name, rows) and self._elastic[name].reel is None:  # what is on a drum stays there
            rows = off_symmetry(self._elastic[name], rows)
        self._batch[name].write_positions(name, rows, self._some(world))

    def _leave_if_strained(self, name: str, rows: np.ndarray) -> bool:
        """Whether positions strain a spring by more than half; `auto` then leaves the object to implicit steps."""
        strained = is_strained(self._elastic[name], rows)
        if strained and self.settings.method == "auto":
            self._leave_to_implicit(name)
        return strained

    def set_velocities(self, name: str, velocities: Any, world: int | None = None) -> None:
        """Give all particles `velocities` (N, 3) [m/s], pinned ones stay at rest; history and multipliers start
        anew."""
        rows = self._rows(name, velocities, "velocities", 1e6)
        rows[self._topology(name).pinned] = 0.0
        self._batch[name].write_velocities(name, rows, self._some(world))

    def _rows(self, name: str, values: Any, what: str, limit: float) -> np.ndarray:
        count = len(self._topology(name).masses)
        rows = finite_array(values, 3, f"{name} {what}")
        if len(rows) != count or np.abs(rows).max() > limit:
            raise ValueError(
                f"{name} {what} have {len(rows)} rows up to {np.abs(rows).max():g}; "
                f"allowed are {count} rows up to {limit:g}"
            )
        return rows

    def _leave_to_implicit(self, name: str) -> None:
        """Explicit steps are not for this object until the next reset of all worlds."""
        self._strained.add(name)
        self._choose_again()

    def device_arrays(self, name: str, world: int = 0) -> tuple[Arrays, slice, wp.Device]:
        """The arrays of the batch that holds an object in one world, where its particles lie in them, their device.

        They hold until `builds` changes: method auto may build anew when live parameters or positions are set.
        """
        self._topology(name)
        batch = self._batch[name]
        return batch.worlds[self._one(world)], batch.span(name), self._device

    def report(self, world: int = 0) -> dict[str, dict[str, float]]:
        """Name -> kinetic_energy [J], max_strain [-], max_penetration [m], residual [m], recoveries;
        of a rope also max_tension, start_tension, end_tension [N], of all, the first and the last of its segments, and
        of one on a winch paid_out [m], pay_out [m/s] and winch_stopped, whether a limit of length holds it back; of one
        that resists twist, twist [rad] from start to end and torsion [N m].

        residual is the largest violation |C + compliance x force| of a spring that the iterations left in the last
        substep; max_penetration is how much deeper than the thickness a particle lies; recoveries counts how often the
        object was put back, at rest, to where it was last good, because a particle was not finite or ran away. Method
        auto leaves what was put back or is strained by more than half to the implicit method, until the next reset.
        """
        self._one(world)
        self._upload()
        dt = self.settings.frame_dt / self.settings.substeps
        found = {name: self._reporter.measure(batch, name, dt, world) for name, batch in self._batch.items()}
        for name, thing in self.scene.objects.items():
            if isinstance(thing, Rope):
                found[name] |= self._measure_rope(name, thing, world)
        if self.settings.method == "auto":
            for name, numbers in found.items():
                hot = numbers["recoveries"] or numbers["max_strain"] > STRAINED
                if hot and self._choices[name].method == "verlet":
                    self._leave_to_implicit(name)
        return found

    def _one(self, world: int) -> int:
        """`world` if there is one of that number, else ValueError."""
        if isinstance(world, bool) or not isinstance(world, int) or not 0 <= world < self.worlds:
            raise ValueError(f"world is {world!r}; allowed is a whole number from 0 to {self.worlds - 1}")
        return world

    def _some(self, world: int | None) -> int | None:
        """`world` if it is None, for all, or there is one of that number, else ValueError."""
        return None if world is None else self._one(world)

    def _topology(self, name: str) -> topology.Topology:
        if name not in self._topologies:
            raise ValueError(f"there is no object {name!r}; allowed is {names_of(self._topologies)}")
        return self._topologies[name]


def _find_device(name: str) -> wp.Device:
    if name == "auto":
        name = "cuda:0" if wp.is_cuda_available() else "cpu"
    try:
        return wp.get_device(name)
    except Exception:
        known = ", ".join(device.alias for device in wp.get_devices())
        raise ValueError(f"device is {name!r}; allowed is auto or one of {known}") from None
