# SPDX-License-Identifier: Apache-2.0
"""The public face: a scene and settings on a device, advanced frame by frame and read back by name.

A Simulation is composed of parts: Bodies (how objects are computed, and where), Queries (what is read of them), Ropes
(the same of ropes alone), Hands (what handles hold), Live (what may change while it runs), Placing (where objects are
put), Cuts (what is cut), Tensors (all worlds at once) and Saving (its state in a file). Here are time and state.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Callable
from numbers import Integral
from typing import Any

import numpy as np
import warp as wp

from cloth_sim_ros.sim.access.cuts import Cuts
from cloth_sim_ros.sim.access.hands import Hands
from cloth_sim_ros.sim.access.live import Live, compliances_of
from cloth_sim_ros.sim.access.live_values import live_value
from cloth_sim_ros.sim.access.placing import Placing
from cloth_sim_ros.sim.access.queries import Queries
from cloth_sim_ros.sim.access.report import Reporter
from cloth_sim_ros.sim.access.rope_queries import Ropes
from cloth_sim_ros.sim.access.saving import Saving
from cloth_sim_ros.sim.access.tension import Tensions
from cloth_sim_ros.sim.access.tensors import Tensors
from cloth_sim_ros.sim.access.wrench import EndWrenches
from cloth_sim_ros.sim.arrays.state import Arrays
from cloth_sim_ros.sim.colliders.collider import Collider
from cloth_sim_ros.sim.engine.bodies import Bodies
from cloth_sim_ros.sim.scene.objects import Rope
from cloth_sim_ros.sim.scene.scene import Scene, large_meshes
from cloth_sim_ros.sim.scene.settings import Settings
from cloth_sim_ros.sim.substeps.choose import Choice
from cloth_sim_ros.sim.substeps.limits import check_explicit

_LOG = logging.getLogger(__name__)


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
        for sentence in large_meshes(scene):
            _LOG.warning(sentence)
        self._bodies = Bodies(scene, settings, device, worlds, executor)
        self._queries = Queries(self._bodies)
        self._ropes = Ropes(self._bodies, self._queries)
        self._hands = Hands(self._bodies)
        self._live = Live(self._bodies, self._ropes, self._hands)
        self._tensors = Tensors(self._bodies, self._queries.loads, self._hands.loads, self._ropes)
        self._saving = Saving(self._bodies, self._hands)
        self._cuts = Cuts(self._bodies)
        self._placing = Placing(self._bodies, self._queries, self._hands)
        materials = {name: (compliances_of(thing), thing.damping) for name, thing in scene.objects.items()}
        if settings.method == "verlet":
            for name, material in materials.items():
                check_explicit(scene, settings, name, self._bodies.elastic[name], [material])
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

    @property
    def scene(self) -> Scene:
        """The scene as it is now, with colliders that were added."""
        return self._bodies.scene

    @property
    def settings(self) -> Settings:
        """The settings as they are now."""
        return self._bodies.settings

    @property
    def worlds(self) -> int:
        """The number of worlds."""
        return self._bodies.worlds

    @property
    def builds(self) -> int:
        """How often the arrays on the device were made; those of `device_arrays` hold until it changes."""
        return self._bodies.builds

    @property
    def device(self) -> str:
        """The device's name, such as "cpu" or "cuda:0"."""
        return self._bodies.device

    @property
    def method(self) -> str:
        """Methods, orders and executors in words, for diagnostics."""
        return self._bodies.method

    @property
    def choices(self) -> dict[str, Choice]:
        """Name -> how the object is computed now, in all worlds, and why."""
        return self._bodies.choices

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

        A saved state that was there before is replaced by the whole file at once, or stays. Raises ValueError where the
        file cannot be written, or where anything else is at `path`.
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

    def masses(self, name: str, world: int = 0) -> np.ndarray:
        """Masses (N,) float64 [kg] in one world, pinned particles included."""
        return self._queries.masses(name, world)

    def triangles(self, name: str, world: int = 0) -> np.ndarray:
        """Triangles (T, 3) int32, counter-clockwise seen from their normals; none for a rope. Of a sheet that tears,
        those that are left in one world."""
        return self._queries.triangles(name, world)

    def rest_positions(self, name: str, world: int = 0) -> np.ndarray:
        """Rest positions (N, 3) float32 [m] in one world, where the scene puts the object."""
        return self._queries.rest_positions(name, world)

    def springs(self, name: str, world: int = 0) -> dict[str, tuple[np.ndarray, np.ndarray, np.ndarray]]:
        """Kind -> (pairs (S, 2) int, rest_length (S,) [m], constant (S,) [N/m], infinite where rigid), as they are
        now."""
        return self._queries.springs(name, world)

    def torn(self, name: str, world: int = 0) -> dict[str, np.ndarray]:
        """Kind -> (S,) bool, which of `springs` failed in one world. Raises ValueError where the object does not
        tear."""
        return self._queries.torn(name, world)

    def tears(self, name: str) -> bool:
        """Whether an object tears."""
        return self._queries.tears(name)

    def panels_left(self, name: str, world: int) -> wp.array:
        """The triangles (T,) vec3i of a sheet that tears on the device; those that failed have three equal corners."""
        return self._queries.panels_left(name, world)

    def cut(self, name: str, polygon: Any, world: Any = None) -> int:
        """Every spring of a sheet that goes through a planar polygon (n, 3) [m] of 3 or more corners fails for good.

        Returns how many structural and shear springs did in all worlds that are cut. Raises ValueError where the
        object does not tear, or for what is no polygon.
        """
        return self._cuts.cut(name, polygon, world)

    def set_positions(self, name: str, positions: Any, world: Any = None) -> None:
        """Move all particles to `positions` (N, 3) [m], pinned ones too; history and multipliers start anew.

        Those that strain a spring by more than half are taken with a nudge, see starts.off_symmetry.
        """
        self._placing.set_positions(name, positions, world)

    def set_velocities(self, name: str, velocities: Any, world: Any = None) -> None:
        """Give all particles `velocities` (N, 3) [m/s], pinned ones stay at rest; history and multipliers start
        anew."""
        self._placing.set_velocities(name, velocities, world)

    def positions(self, name: str, world: Any = 0) -> np.ndarray:
        """Positions (N, 3) float32 [m] in one world, or (k, N, 3) in several, all for None, in one copy."""
        return self._queries.positions(name, world)

    def velocities(self, name: str, world: Any = 0) -> np.ndarray:
        """Velocities (N, 3) float32 [m/s] in one world, or (k, N, 3) in several, all for None, in one copy."""
        return self._queries.velocities(name, world)

    def device_arrays(self, name: str, world: int = 0) -> tuple[Arrays, slice, wp.Device]:
        """The arrays of the batch that holds an object in one world, where its particles lie in them, their device.

        They hold until `builds` changes: method auto may build anew when live parameters or positions are set.
        """
        return self._queries.device_arrays(name, world)

    def tensor(self, name: str, what: str) -> wp.array:
        """A view of the `what` of an object, collider or handle in all worlds, on the device.

        Of an object "positions" [m] and "velocities" [m/s], (worlds, N, 3) float32; "contact_forces" (worlds, N, 3)
        [N], of all colliders together on each particle, means over the last frame; and "recoveries", (worlds,) int32:
        how often it was put back. Of a rope "tensions" (worlds, S) float32 [N] too, see `tensions`. Of a collider or
        handle "pose", (worlds, 7) float32: x y z [m], then x y z w of the orientation; and "wrench", (worlds, 6)
        float32: force [N], then torque [N m] about its origin.

        It is no copy: it shows the state after the last frame that was launched, on Warp's stream of the device.
        Tensions, wrenches, and contact forces of several colliders are computed when they are asked for, and show that
        until they are again. A tensor goes to torch, JAX and CuPy by DLPack, and is for reading. It holds until
        `builds` changes: method auto may build anew when live parameters or positions are set.
        """
        return self._tensors.tensor(name, what)

    def write(self, name: str, what: str, array: Any, mask: Any = None, sweep: bool = True) -> None:
        """Write the `what` of a whole tensor into the worlds of a mask (worlds,) of bool, or for None into all.

        Of an object "positions" or "velocities" (worlds, N, 3), of a collider or handle "pose" (worlds, 7), which it
        reaches at the end of the next frame; without `sweep` it is there at once. The "pose" of an object takes the
        place of the scene's: it is there in its rest shape, at rest. Arrays are NumPy's, Warp's or what
        DLPack takes. Pinned particles move and stay at rest; history and multipliers of the object start anew. It waits
        for the device, to see that all numbers are allowed; otherwise nothing changes.
        """
        self._tensors.write(name, what, array, mask, sweep)

    def recovered(self) -> np.ndarray:
        """(worlds,) bool: in which worlds an object was put back at the end of the last frame, see `report`."""
        return self._tensors.recovered()

    def wrench(self, collider: str, world: int = 0) -> tuple[np.ndarray, np.ndarray]:
        """Force (3,) [N] and torque (3,) [N m] about its origin on a collider by all objects, in world axes.

        They are means over the last frame; the torque takes particles where the frame leaves them. The weight of a
        cloth that lies on the collider points down.
        """
        return self._queries.wrench(collider, world)

    def wrenches(self, world: int = 0) -> np.ndarray:
        """The same of all rows of colliders (K, 6) float32: force [N], then torque [N m]."""
        return self._queries.wrenches(world)

    def tensions(self, name: str, world: int = 0) -> np.ndarray:
        """Tensions (S,) float32 [N] of a rope's segments at the end of the last substep in one world, also where they
        are rigid. They are below 0 where a segment is pushed together, and 0 on a winch. Raises ValueError for a
        cloth."""
        return self._ropes.tensions(name, world)

    def tensions_into(self, out: wp.array, column: int, name: str, world: int = 0) -> Tensions:
        """What writes the tensions of a rope into a column of a device array (N, columns) float, a particle a row; it
        holds until `builds` changes. Raises ValueError for a cloth."""
        return self._ropes.tensions_into(out, column, name, world)

    def directors(self, name: str, world: int = 0) -> np.ndarray:
        """Unit vectors (S, 3) float64 across the segments of a rope that resists twist, which turn with its material,
        in one world, as of the last substep. Raises ValueError for what does not resist twist."""
        return self._ropes.directors(name, world)

    def end_wrenches(self, name: str, world: int = 0) -> np.ndarray:
        """(2, 6) float32: force [N] and torque [N m] in world axes with which a rope loads what holds its start, then
        its end, in one world.

        All particles held from an end on count, with their weight, and the torque is about the end particle: of a clamp
        of two particles it is the clamping moment. An end that is free loads nothing. Raises ValueError for a cloth.
        """
        return self._ropes.end_wrenches(name, world)

    def end_wrenches_into(self, out: wp.array, name: str, world: int = 0) -> EndWrenches:
        """What writes the end wrenches of a rope into a device array (2, 6) float; it holds until `builds` changes.
        Raises ValueError for a cloth."""
        return self._ropes.end_wrenches_into(out, name, world)

    def set(self, name: str, value: Any, world: Any = None) -> None:
        """Set a live parameter such as "cloth.stretch_compliance", "cloth.mass", "cloth.scale", "ball.radius",
        "gravity" or "solver.substeps".

        An array whose first axis is all worlds gives each its own number or vector. Those of the solver hold in all
        worlds. With another scale an object starts anew: its rest shape is so many times as large, and all else is as
        set, its total mass too. A sheet grows about its position, a rope from its start.
        """
        self._live.set(name, value, world)

    def set_wind(self, velocity: Any, world: Any = None) -> None:
        """Set the wind velocity [m/s] from the next frame on."""
        self._live.set_wind(velocity, world)

    def set_collider_pose(
        self,
        name: str,
        position: Any,
        orientation: Any = (0.0, 0.0, 0.0, 1.0),
        sweep: bool = True,
        world: Any = None,
    ) -> None:
        """Move a collider: it reaches the pose [m], x y z w, at the end of the next frame, swept in between.

        Arrays whose first axis is all worlds give each its own. Without `sweep` it is there at once and was never
        anywhere else: for placing it, not for pushing with it.
        """
        self._live.set_collider_pose(name, position, orientation, sweep, world)

    def add_collider(self, name: str, collider: Collider) -> None:
        """Put a collider of one of SPARE_SHAPES where there is room for one, in all worlds, from the next frame on.

        It takes the place of one of the same name that was added before.
        """
        self._live.add_collider(name, collider)

    def remove_collider(self, name: str) -> None:
        """Take away a collider that was added."""
        self._live.remove_collider(name)

    def set_handle_pose(
        self,
        name: str,
        position: Any,
        orientation: Any = (0.0, 0.0, 0.0, 1.0),
        sweep: bool = True,
        world: Any = None,
    ) -> None:
        """Move a handle: it reaches the pose [m], x y z w, at the end of the next frame, with what it holds.

        Arrays whose first axis is all worlds give each its own. Without `sweep` it is there at once: for placing an
        empty one, as what it holds would be torn along.
        """
        self._hands.set_handle_pose(name, position, orientation, sweep, world)

    def attach(self, name: str, world: Any = None) -> int | np.ndarray:
        """Grasp what is within reach and nobody holds; how many particles it holds now, see `held`."""
        return self._hands.attach(name, world)

    def release(self, name: str, world: Any = None) -> None:
        """Let go of all that it holds, which goes on with the velocity it has."""
        self._hands.release(name, world)

    def held(self, name: str, world: Any = None) -> int | np.ndarray:
        """How many particles it holds: in one world, or in each of several, all for None."""
        return self._hands.held(name, world)

    def broken(self, name: str, world: int = 0) -> int:
        """How often it has let go because the load was larger than its break_force."""
        return self._hands.broken(name, world)

    def handle_wrench(self, name: str, world: int = 0) -> tuple[np.ndarray, np.ndarray]:
        """Force (3,) [N] and torque (3,) [N m] about its origin on a handle, in world axes: mean over the last frame.

        It is what the hand feels: the weight of a cloth that hangs from it points down.
        """
        return self._hands.handle_wrench(name, world)

    def handle_wrenches(self, world: int = 0) -> np.ndarray:
        """The same of all handles (H, 6) float32: force [N], then torque [N m]."""
        return self._hands.handle_wrenches(world)

    def handle_position(self, name: str, world: int = 0) -> np.ndarray:
        """Where a handle is at the end of the last frame (3,) [m]."""
        return self._hands.handle_position(name, world)
