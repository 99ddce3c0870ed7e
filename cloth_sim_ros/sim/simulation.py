"""The public face: a scene and settings on a device, advanced frame by frame and read back by name.

Simulation is one class in parts that each know only those before: Bodies (how objects are computed, and where), Queries
(what is read of them), Ropes (the same of ropes alone), Live (what may change while it runs); here are time and state.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from cloth_sim_ros.sim.checks import finite_array
from cloth_sim_ros.sim.choice import is_strained
from cloth_sim_ros.sim.live import Live, compliances_of
from cloth_sim_ros.sim.objects import Rope
from cloth_sim_ros.sim.report import Reporter
from cloth_sim_ros.sim.scene import Scene
from cloth_sim_ros.sim.settings import Settings
from cloth_sim_ros.sim.starts import off_symmetry

_FAR = 1e6  # [m] the largest coordinate that positions may be given in
_FAST = 1e6  # [m/s] the same of velocities


class Simulation(Live):
    """Cloths and ropes of `scene`, computed as `settings` say on `device` ("cpu", "cuda:0" or "auto").

    Whatever takes a value raises ValueError with one sentence where the value cannot be, and changes nothing then.
    `step` may return before a GPU is done; whatever reads the state waits. `worlds` copies of the scene run side by
    side in the same launches, each with its own state, materials, collider poses, wind and gravity: what reads takes
    the number of a world, what writes takes one or, with None, all of them.
    """

    def __init__(self, scene: Scene, settings: Settings | None = None, device: str = "auto", worlds: int = 1) -> None:
        super().__init__(scene, settings or Settings(), device, worlds)
        for name, thing in scene.objects.items():
            self._check_rope(name, thing)
        materials = {name: (compliances_of(thing), thing.damping) for name, thing in scene.objects.items()}
        if self.settings.method == "verlet":
            for name, material in materials.items():
                self._check_explicit(name, *material, self.settings.substeps)
        self._write_settings()
        self._build({name: self._choose(name, [material]) for name, material in materials.items()})
        self._reporter = Reporter(self._device)
        self._finer = 1
        self._frames = 0
        self._write_scene()

    @property
    def time(self) -> float:
        """Simulated time since construction or reset of all worlds [s]."""
        return self._frames * self.settings.frame_dt

    def step(self, frames: int = 1) -> None:
        """Simulate `frames` frames of settings.frame_dt each."""
        for _ in range(frames):
            self._colliders.advance()
            self._advance()
            self._frames += 1

    def step_and_estimate(self) -> dict[str, float]:
        """One frame as by `step`, to the same bits, and name -> by how much it goes astray in world 0 [m].

        That is the RMS error over the particles of this frame alone, as it would be from the exact state, by Richardson
        from two trials, one with twice the substeps (docs/study.md says how well it tracks the true error).
        Takes four frames' time, and memory for a second state.
        """
        self._colliders.advance()
        for batch in self._batches:
            batch.save()
        trials = [self._trial(1), self._trial(2)]
        self._advance()
        self._frames += 1
        orders = {name: 2 if choice.method == "verlet" else choice.order for name, choice in self._choices.items()}
        apart = {name: np.sqrt(((trials[0][name] - trials[1][name]) ** 2).sum(1).mean()) for name in self._batch}
        return {name: float(apart[name] / (1.0 - 0.5 ** orders[name])) for name in self._batch}

    def _trial(self, finer: int) -> dict[str, np.ndarray]:
        """Positions after the frame with `finer` times the substeps, from its start without history; the state is put
        back."""
        for batch in self._batches:
            batch.forget_steps()
        self._advance(finer)
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

    def _advance(self, finer: int = 1) -> None:
        """One frame in `finer` times the substeps that are set, with the live numbers as they are now."""
        self._upload(finer)
        for batch in self._batches:
            batch.advance(finer)

    def _upload(self, finer: int = 1) -> None:
        if finer != self._finer or self._frame.is_changed:
            for batch in self._batches:
                batch.write_frame(self.settings.frame_dt, finer)
            self._finer = finer
            self._frame.upload()
        self._colliders.upload()
        for batch in self._batches:
            batch.upload()

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
        rows, some = self._rows(name, positions, "positions", _FAR), self._some(world)
        strained = self._leave_if_strained(name, rows)
        if strained and self._elastic[name].reel is None:  # what is on a drum stays there
            rows = off_symmetry(self._elastic[name], rows)
        self._batch[name].write_positions(name, rows, some)

    def _leave_if_strained(self, name: str, rows: np.ndarray) -> bool:
        """Whether positions strain a spring by more than half; `auto` then leaves the object to implicit steps."""
        strained = is_strained(self._elastic[name], rows)
        if strained and self.settings.method == "auto":
            self._leave_to_implicit(name)
        return strained

    def set_velocities(self, name: str, velocities: Any, world: int | None = None) -> None:
        """Give all particles `velocities` (N, 3) [m/s], pinned ones stay at rest; history and multipliers start
        anew."""
        rows = self._rows(name, velocities, "velocities", _FAST)
        rows[self._topology(name).pinned] = 0.0
        self._batch[name].write_velocities(name, rows, self._some(world))

    def _rows(self, name: str, values: Any, what: str, limit: float) -> np.ndarray:
        """`values` as an array (N, 3), a row a particle. Raises ValueError for another shape or beyond `limit`."""
        count = len(self._topology(name).masses)
        rows = finite_array(values, 3, f"{name} {what}")
        if len(rows) != count or np.abs(rows).max() > limit:
            raise ValueError(
                f"{name} {what} have {len(rows)} rows up to {np.abs(rows).max():g}; "
                f"allowed are {count} rows up to {limit:g}"
            )
        return rows

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
        found = {name: self._reporter.measure(batch, name, world) for name, batch in self._batch.items()}
        for name, thing in self.scene.objects.items():
            if isinstance(thing, Rope):
                found[name] |= self._measure_rope(name, thing, world)
        return found
