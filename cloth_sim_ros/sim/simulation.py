# SPDX-License-Identifier: Apache-2.0
"""The public face: a scene and settings on a device, advanced frame by frame and read back by name.

A Simulation is composed of parts: Bodies (how objects are computed, and where), Queries (what is read of them), Ropes
(the same of ropes alone), Hands (what handles hold), Live (what may change while it runs), Placing (where objects are
put), Cuts (what is cut), Tensors (all worlds at once) and Saving (its state in a file). Here are time and state.
"""

from __future__ import annotations

import functools
import os
from collections.abc import Callable
from numbers import Integral
from typing import Any

import numpy as np

from cloth_sim_ros.sim.access.cuts import Cuts
from cloth_sim_ros.sim.access.explicit import check_explicit
from cloth_sim_ros.sim.access.hands import Hands
from cloth_sim_ros.sim.access.live import Live, compliances_of
from cloth_sim_ros.sim.access.live_values import live_value
from cloth_sim_ros.sim.access.placing import Placing
from cloth_sim_ros.sim.access.queries import Queries
from cloth_sim_ros.sim.access.report import Reporter
from cloth_sim_ros.sim.access.rope_queries import Ropes
from cloth_sim_ros.sim.access.saving import Saving
from cloth_sim_ros.sim.access.tensors import Tensors
from cloth_sim_ros.sim.engine.bodies import Bodies
from cloth_sim_ros.sim.scene.objects import Rope
from cloth_sim_ros.sim.scene.scene import Scene
from cloth_sim_ros.sim.scene.settings import Settings


def _of(part: str, method: Callable) -> Callable:
    """The `method` of a part, as a method of the whole."""

    @functools.wraps(method)
    def forwarded(self, *arguments, **named):
        return method(getattr(self, part), *arguments, **named)

    return forwarded


def _its(name: str) -> property:
    """What Bodies has of this name."""
    return property(lambda self: getattr(self._bodies, name), doc=getattr(getattr(Bodies, name, None), "__doc__", None))


class Simulation:
    """Cloths and ropes of `scene`, computed as `settings` say on `device` ("cpu", "cuda:0" or "auto").

    Whatever takes a value raises ValueError with one sentence where the value cannot be, and changes nothing then.
    `step` may return before a GPU is done; whatever reads the state waits. `worlds` copies of the scene run side by
    side in the same launches. Each has its own state, materials, collider poses, wind and gravity. What reads takes the
    number of a world. What writes takes one, a mask (worlds,) of bool or, with None, all of them.

    executor: "block" has a body in one block of a GPU, or a thread of a CPU; "graph" has a launch for each part of a
    substep; None chooses.

    moved: name -> depth and way [m] of objects that the scene puts inside of a collider and that start outside of it.
    """

    def __init__(
        self,
        scene: Scene,
        settings: Settings | None = None,
        device: str = "auto",
        worlds: int = 1,
        executor: str | None = None,
    ) -> None:
        settings = Settings() if settings is None else settings
        for given, kind in ((scene, Scene), (settings, Settings)):
            if not isinstance(given, kind):
                raise ValueError(f"Simulation is given {given!r:.80}; allowed is a {kind.__name__} in its place")
        self._bodies = Bodies(scene, settings, device, worlds, executor)
        self._queries = Queries(self._bodies)
        self._ropes = Ropes(self._bodies, self._queries)
        self._hands = Hands(self._bodies)
        self._live = Live(self._bodies, self._ropes, self._hands)
        self._tensors = Tensors(self._bodies, self._queries.loads, self._hands.loads, self._ropes)
        self._saving = Saving(self._bodies, self._hands)
        self._cuts = Cuts(self._bodies)
        self._placing = Placing(self._bodies, self._queries, self._hands)
        for name, thing in scene.objects.items():
            self._ropes.check_rope(name, thing)
        materials = {name: (compliances_of(thing), thing.damping) for name, thing in scene.objects.items()}
        if self._bodies.settings.method == "verlet":
            for name, material in materials.items():
                check_explicit(self._bodies, name, *material, self._bodies.settings.substeps)
        self._live.write_settings()
        thick = {name: getattr(thing, "radius", None) or thing.thickness for name, thing in scene.objects.items()}
        self._bodies.build({name: self._bodies.choose(name, [materials[name]], thick[name]) for name in materials})
        self._reporter = Reporter(self._bodies.warp_device)
        self._finer = 1
        self._frames = 0
        self._live.write_scene()
        self._hands.reset(None)
        self.moved = self._placing.leave_colliders()
        if self.moved:
            self.reset()

    masses = _of("_queries", Queries.masses)
    triangles = _of("_queries", Queries.triangles)
    rest_positions = _of("_queries", Queries.rest_positions)
    springs, torn = _of("_queries", Queries.springs), _of("_queries", Queries.torn)
    tears, panels_left = _of("_queries", Queries.tears), _of("_queries", Queries.panels_left)
    cut = _of("_cuts", Cuts.cut)
    set_positions = _of("_placing", Placing.set_positions)
    set_velocities = _of("_placing", Placing.set_velocities)
    positions = _of("_queries", Queries.positions)
    velocities = _of("_queries", Queries.velocities)
    device_arrays = _of("_queries", Queries.device_arrays)
    tensor, write = _of("_tensors", Tensors.tensor), _of("_tensors", Tensors.write)
    recovered = _of("_tensors", Tensors.recovered)
    wrench, wrenches = _of("_queries", Queries.wrench), _of("_queries", Queries.wrenches)
    tensions = _of("_ropes", Ropes.tensions)
    tensions_into = _of("_ropes", Ropes.tensions_into)
    directors = _of("_ropes", Ropes.directors)
    end_wrenches = _of("_ropes", Ropes.end_wrenches)
    end_wrenches_into = _of("_ropes", Ropes.end_wrenches_into)
    set = _of("_live", Live.set)
    set_wind = _of("_live", Live.set_wind)
    set_collider_pose = _of("_live", Live.set_collider_pose)
    add_collider, remove_collider = _of("_live", Live.add_collider), _of("_live", Live.remove_collider)
    set_handle_pose = _of("_hands", Hands.set_handle_pose)
    attach, release = _of("_hands", Hands.attach), _of("_hands", Hands.release)
    held, broken = _of("_hands", Hands.held), _of("_hands", Hands.broken)
    handle_wrench, handle_wrenches = _of("_hands", Hands.handle_wrench), _of("_hands", Hands.handle_wrenches)
    handle_position = _of("_hands", Hands.handle_position)
    scene, settings = _its("scene"), _its("settings")
    worlds, builds = _its("worlds"), _its("builds")
    device, method = _its("device"), _its("method")
    choices = _its("choices")

    @property
    def time(self) -> float:
        """Simulated time since construction or reset of all worlds [s]."""
        return self._frames * self._bodies.settings.frame_dt

    def step(self, frames: int = 1) -> None:
        """Simulate `frames` frames of settings.frame_dt each, to the same bits as by as many calls.

        A GPU runs up to ten of them as one CUDA graph. Frames in which colliders or handles move run one by one, as the
        host tells the next one that they rest. So do those of objects that touch themselves or one another, as the host
        looks after their tree of boxes. Raises ValueError for a number of frames that cannot be.
        """
        if isinstance(frames, bool) or not isinstance(frames, Integral) or frames < 0:
            raise ValueError(f"step is asked for {frames!r} frames; allowed is a whole number, 0 or more")
        while frames > 0:
            self._begin()
            alike = self._bodies.alike(frames)
            self._advance(1, alike, self._hands.ending)
            self._frames += alike
            frames -= alike

    def _begin(self) -> None:
        self._bodies.advance()

    def make_ready(self) -> None:
        """Compile what only some frames need, so that none of them waits; may run in a thread beside `step`."""
        for batch in list(self._bodies.batches):
            batch.make_ready()

    def step_and_estimate(self) -> dict[str, float]:
        """One frame as by `step`, to the same bits, and name -> by how much it goes astray in world 0 [m].

        That is the RMS error over the particles of this frame alone, as it would be from the exact state. It comes by
        Richardson from two trials, one with twice the substeps. docs/explanation/study.md says how well it tracks the
        true error. Takes four frames' time, and memory for a second state.
        """
        self._begin()
        for batch in self._bodies.batches:
            batch.save()
        trials = [self._trial(1), self._trial(2)]
        self._advance(ending=self._hands.ending)
        self._frames += 1
        # Explicit steps are of second order, but for the air.
        explicit = 1 if self._bodies.scene.wind is not None else 2
        orders = {
            name: explicit if choice.method == "verlet" else choice.order
            for name, choice in self._bodies.choices.items()
        }
        apart = {name: np.sqrt(((trials[0][name] - trials[1][name]) ** 2).sum(1).mean()) for name in self._bodies.batch}
        return {name: float(apart[name] / (1.0 - 0.5 ** orders[name])) for name in self._bodies.batch}

    def _trial(self, finer: int) -> dict[str, np.ndarray]:
        """Positions after the frame with `finer` times the substeps, from its start without history; the state is put
        back."""
        for batch in self._bodies.batches:
            batch.forget_steps()
        self._advance(finer)
        found = {}
        for name in self._bodies.batch:
            arrays, span, _ = self._queries.device_arrays(name)
            high, lo = (rows[span].numpy()[:, :3] for rows in (arrays.state.positions, arrays.state.position_lo))
            found[name] = high.astype(np.float64) + lo
        for batch in self._bodies.batches:
            batch.restore()
        return found

    def reset(self, world: Any = None) -> None:
        """Objects, colliders and handles back to where the scene put them, at rest; live parameters stay as they are.

        Resetting all worlds (None) sets the time to 0; some alone go on with the time of the others.
        """
        some = self._bodies.some(world)
        chosen = self._bodies.chosen(some)
        for batch in self._bodies.batches:
            batch.restart(chosen)
        for name, collider in self._bodies.scene.colliders.items():
            self._bodies.colliders.place(self._bodies.collider_row[name], some, collider.position, collider.orientation)
        self._hands.reset(some)
        if world is None:
            self._frames = 0

    def get(self, name: str, world: int = 0) -> Any:
        """What `set` has set last, or the scene before, of a live parameter in one world; the position or orientation
        of a collider or handle too. Raises ValueError where the scene has none of that name."""
        return live_value(self._bodies, self._hands, name, world)

    def save(self, path: str | os.PathLike, notes: Any = None) -> None:
        """Write the whole state of all worlds into one .npz file, and `notes` of what JSON can hold.

        What was there before is replaced by the whole file at once, or stays. Raises ValueError where it cannot be.
        """
        self._saving.save(path, self._frames, notes)

    def load(self, path: str | os.PathLike) -> Any:
        """Go on from what `save` wrote of a scene of the same structure, to the same bits, and return its notes.

        Live numbers, pins, added colliders and grasps become those of the file; `builds` may change. Raises ValueError
        for a file that is damaged, or not of such a scene on such a device. Nothing changes then.
        """
        self._frames, notes = self._saving.load(path)
        return notes

    def _advance(self, finer: int = 1, frames: int = 1, ending: Callable[[], None] | None = None) -> None:
        """Frames as by `Frames.advance`, with the live numbers as they are now."""
        self._upload(finer)
        self._bodies.frames.advance(finer, frames, ending)

    def _upload(self, finer: int = 1) -> None:
        if finer != self._finer or self._bodies.frame.is_changed:
            for batch in self._bodies.batches:
                batch.frame.write(self._bodies.settings.frame_dt, finer)
            self._finer = finer
            self._bodies.frame.upload()
        self._bodies.colliders.upload()
        self._bodies.handles.upload()
        for batch in self._bodies.batches:
            batch.upload()

    def take_over(self, name: str, other: Simulation) -> None:
        """An object goes on, in all worlds, from where it is in the first world of another simulation. That one has to
        have it with the same structure. It keeps positions, velocities, what a winch has paid out and the twist. Its
        scale is not taken along. Raises ValueError, and then nothing has changed."""
        if not isinstance(other, Simulation):
            raise ValueError(f"take_over of {name} is from {other!r}; allowed is a Simulation")
        self._placing.take_over(name, other._placing)
        self.moved.pop(name, None)

    def report(self, world: int = 0) -> dict[str, dict[str, float]]:
        """Name -> kinetic_energy [J], max_strain [-], max_penetration [m], particle_penetration [m], contacts, residual
        [m], recoveries, redone, substeps, iterations, expected_error and bending_share. A rope also has max_tension,
        start_tension and end_tension [N]: of all, the first and the last of its segments. On a winch it has paid_out
        [m], pay_out [m/s] and winch_stopped, whether a limit of length holds it back. One that resists twist has twist
        [rad] from start to end and torsion [N m]. A sheet that tears has torn, the springs that failed.

        residual is the largest violation |C + compliance x force| of a spring that the iterations left in the last
        substep. max_penetration is how much deeper than the thickness the surface lies, and particle_penetration how
        much deeper a particle does. contacts counts particles that colliders push, or facets around them. recoveries
        counts how often the object was put back, at rest, to where it was last good, because a particle was not finite
        or ran away. redone counts frames of explicit steps that were done again by XPBD. expected_error is meant as
        solver.error is, for the world where it is largest. bending_share is the share of a sheet's bending rigidity
        that acts.

        Of what is kept apart from itself or others, pairs is how many corners and triangles, or edges, are near one
        another in the whole world. pairs_lost is for how many of them there was no room. crossings is how many edges of
        the object go through a triangle of what it is kept apart from.
        """
        self._bodies.one(world)
        self._upload()
        found = {name: self._reporter.measure(batch, name, world) for name, batch in self._bodies.batch.items()}
        if self._bodies.coupled is not None:
            for name, meeting in self._bodies.coupled.report(world).items():
                found[name] |= meeting
        for name, choice in self._bodies.choices.items():
            found[name] |= {"expected_error": choice.error, "bending_share": choice.bending_share}
        for name, thing in self._bodies.scene.objects.items():
            if isinstance(thing, Rope):
                found[name] |= self._ropes.measure_rope(name, thing, world)
        return found
