# SPDX-License-Identifier: Apache-2.0
"""The public interface: a scene and settings on a device, advanced frame by frame and read back by name.

A Simulation is composed of parts. Bodies decides how objects are computed and holds their arrays. Queries reads
objects, and Ropes reads what only ropes have. Hands manages handles. Live changes parameters while the simulation
runs. Placing moves objects, and Cuts cuts them. Tensors reads and writes all worlds at once. Saving writes the state to
a file. This module handles time and state.
"""

from __future__ import annotations

import logging
import os
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
from cloth_sim_ros.sim.scene.scene import Scene, large_meshes, loose_meshes
from cloth_sim_ros.sim.scene.settings import Settings
from cloth_sim_ros.sim.substeps.choose import Choice
from cloth_sim_ros.sim.substeps.limits import check_explicit

_LOG = logging.getLogger(__name__)


class Simulation:
    """Cloths and ropes of a scene, simulated on a device.

    Every method that takes a value raises ValueError with one sentence if the value is not allowed. Nothing changes
    then. `step` may return before a GPU is done; methods that read the state wait for it.

    The `worlds` copies of the scene run side by side in the same launches. Each has its own state, materials, collider
    poses, wind and gravity. Methods that read take the number of a world. Methods that write take a number, a mask
    (worlds,) of bool, or None for all worlds.

    Args:
        scene: The objects, colliders, handles and forces.
        settings: The solver's settings; None takes the defaults.
        device: "cpu", a GPU such as "cuda:0", or "auto".
        worlds: The number of copies of the scene.
        executor: "block" computes each body in one block of a GPU or one thread of a CPU. "graph" launches each part
            of a substep separately. None chooses.

    Attributes:
        moved: Name -> (depth, distance moved) [m] of each object that the scene places inside a collider and that
            starts outside it.

    Raises:
        ValueError: An argument is not allowed.
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
        for sentence in (*large_meshes(scene), *loose_meshes(scene)):
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
        """Number of times the device arrays were built; results of `device_arrays` are valid until it changes."""
        return self._bodies.builds

    @property
    def device(self) -> str:
        """Name of the device, as Warp calls it."""
        return self._bodies.device

    @property
    def method(self) -> str:
        """Methods, orders and executors as text for diagnostics."""
        return self._bodies.method

    @property
    def choices(self) -> dict[str, Choice]:
        """Name -> the method and substeps chosen for the object in all worlds, with the reason."""
        return self._bodies.choices

    @property
    def time(self) -> float:
        """Simulated time since construction or reset of all worlds [s]."""
        return self._frames * self._bodies.settings.frame_dt

    def step(self, frames: int = 1) -> None:
        """Simulate `frames` frames of settings.frame_dt each, bit-identical to as many single calls.

        A GPU runs up to ten frames as one CUDA graph. Frames in which colliders or handles move run one by one, because
        the host has to mark them as resting in the next frame. Frames with self contact or object contact also run one
        by one, because the host maintains their tree of boxes. Raises ValueError unless `frames` is a whole number of 0
        or more.
        """
        if isinstance(frames, bool) or not isinstance(frames, Integral) or frames < 0:
            raise ValueError(f"step is asked for {frames!r} frames; allowed is a whole number, 0 or more")
        while frames > 0:
            self._begin()
            alike = self._bodies.alike(frames)
            self._advance(alike)
            self._frames += alike
            frames -= alike

    def _begin(self) -> None:
        self._bodies.advance()

    def make_ready(self) -> None:
        """Compile the kernels that only some frames need, so that no frame waits; may run in a thread beside `step`."""
        for batch in list(self._bodies.batches):
            batch.make_ready()

    def step_and_estimate(self) -> dict[str, float]:
        """Simulate one frame, measure its error, and return name -> that error in world 0, RMS over particles [m].

        The error is that of this frame alone, as if it started from the exact state; see substeps/control.py. Objects
        that explicit steps compute are left out. `step` measures every few frames itself.
        """
        self._begin()
        self._advance(1, measured=True)
        self._frames += 1
        batches = {name: batch for name, batch in self._bodies.batch.items() if batch.measurement is not None}
        return {name: batch.error(batch.index[name], 0)[0] for name, batch in batches.items()}

    def reset(self, world: Any = None) -> None:
        """Put objects, colliders and handles back to where the scene placed them, at rest.

        Live parameters keep their values. Resetting all worlds (None) sets the time to 0; resetting some does not.
        """
        some = self._bodies.some(world)
        chosen = self._bodies.chosen(some)
        self._bodies.restart(chosen)
        for name, collider in self._bodies.scene.colliders.items():
            self._bodies.colliders.place(self._bodies.collider_row[name], some, collider.position, collider.orientation)
        self._hands.reset(some)
        if world is None:
            self._frames = 0

    def get(self, name: str, world: int = 0) -> Any:
        """Return the current value of a live parameter in one world.

        It also returns the position or orientation of a collider or handle. Raises ValueError if the scene has no
        parameter of that name.
        """
        return live_value(self._bodies, self._hands, name, world)

    def save(self, path: str | os.PathLike, notes: Any = None) -> None:
        """Write the whole state of all worlds, and JSON-serializable `notes`, into one .npz file.

        An earlier saved state at `path` is replaced atomically. Raises ValueError if the file cannot be written, or if
        `path` holds anything but a saved state.
        """
        self._saving.save(path, self._frames, notes)

    def load(self, path: str | os.PathLike) -> Any:
        """Continue, bit-identically, from a file that `save` wrote, and return its notes.

        The file's scene must have the same structure. Live numbers, pins, added colliders and grasps become those of
        the file; `builds` may change. Raises ValueError if the file is damaged, or from another structure or kind of
        device. Nothing changes then.
        """
        self._frames, wakes, notes = self._saving.load(path)
        self._upload()  # so that what came from the file counts as no change, which would wake bodies at rest
        self._bodies.wake(wakes)
        return notes

    def _advance(self, frames: int, measured: bool = False) -> None:
        """Upload the live numbers, then advance by `Frames.advance`."""
        self._upload()
        self._bodies.frames.advance(self._frames, frames, self._hands.ending, measured)

    def _upload(self) -> None:
        if self._bodies.frame.is_changed:
            for batch in self._bodies.batches:
                batch.frame.write(self._bodies.settings.frame_dt)
            self._bodies.frame.upload()
        self._bodies.colliders.upload()
        self._bodies.handles.upload()
        self._bodies.numbers.upload()
        for batch in self._bodies.batches:
            batch.upload()

    def take_over(self, name: str, other: Simulation) -> None:
        """Continue an object, in all worlds, from its state in the first world of another simulation.

        The object must have the same structure there. Positions, velocities, the length a winch has paid out, twist,
        torn springs and grasps carry over; the scale does not. Raises ValueError if the structure differs; nothing
        changes then.
        """
        if not isinstance(other, Simulation):
            raise ValueError(f"take_over of {name} is from {other!r}; allowed is a Simulation")
        self._placing.take_over(name, other._placing)
        self.moved.pop(name, None)

    def report(self, world: int = 0) -> dict[str, dict[str, float]]:
        """Return name -> measures of the object in one world.

        Every object has:

        - kinetic_energy [J]; elastic_energy [J] of a sheet without self or object contact and forces of its own, up to
          a constant if it is curved at rest; max_strain, the largest relative change of a spring's length [-].
        - max_penetration, by which the surface lies deeper than the thickness in a collider [m]; particle_penetration,
          the same for the deepest particle [m].
        - contacts, the number of particles that colliders push, directly or through the facets around them.
        - residual, the largest violation of a spring that the iterations left in the last substep [m].
        - recoveries, how often the object was put back to its last good positions, at rest, because a particle was not
          finite or ran away; redone, the number of frames that were computed again with more substeps, as they gained
          energy or were not finite, or by XPBD instead of explicit steps.
        - substeps and iterations, per frame and per substep.
        - error_per_frame, the measured error of the last measured frame, RMS over particles [m]; not of explicit steps.
        - expected_error, the error of the last half second in the units of solver.error; bending_share, the share of a
          sheet's bending rigidity that acts.

        A rope also has max_tension, start_tension and end_tension [N], over all segments, the first and the last. A
        rope on a winch has paid_out [m], pay_out [m/s] and winch_stopped (a length limit holds the winch). A rope that
        resists twist has twist [rad] from start to end and torsion [N m]. A sheet that tears has torn, the number of
        failed structural and shear springs.

        Objects with self contact or object contact have counts of contact pairs. pairs counts corner-triangle and
        edge-edge pairs that are near one another in the whole world. pairs_lost counts pairs for which there was no
        room. crossings counts edges of the object that go through a triangle it is kept apart from.
        """
        self._bodies.one(world)
        self._upload()
        found = {name: self._reporter.measure(batch, name, world) for name, batch in self._bodies.batch.items()}
        if self._bodies.coupled is not None:
            for name, meeting in self._bodies.coupled.report(world).items():
                found[name] |= meeting
        for name, choice in self._bodies.choices.items():
            found[name] = {"expected_error": choice.error, "bending_share": choice.bending_share} | found[name]
        for name, thing in self._bodies.scene.objects.items():
            if isinstance(thing, Rope):
                found[name] |= self._ropes.measure_rope(name, thing, world)
        return found

    def masses(self, name: str, world: int = 0) -> np.ndarray:
        """Masses (N,) float64 [kg] in one world, pinned particles included."""
        return self._queries.masses(name, world)

    def triangles(self, name: str, world: int = 0) -> np.ndarray:
        """Triangles (T, 3) int32, counter-clockwise seen from their normals; none for a rope.

        A sheet that tears returns the triangles that are left in one world.
        """
        return self._queries.triangles(name, world)

    def rest_positions(self, name: str, world: int = 0) -> np.ndarray:
        """Rest positions (N, 3) float32 [m] in one world, at the object's place in the scene."""
        return self._queries.rest_positions(name, world)

    def springs(self, name: str, world: int = 0) -> dict[str, tuple[np.ndarray, np.ndarray, np.ndarray]]:
        """Return kind -> (pairs, rest_length, constant) of the springs as they are now.

        pairs is (S, 2) int, rest_length (S,) [m], and constant (S,) [N/m], infinite for rigid springs. The springs of a
        mesh with a shear_compliance are coupled, so that they alone do not say its energy.
        """
        return self._queries.springs(name, world)

    def stitches(self, seam: str, world: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the stitches of a seam in one world, in the order of its lines.

        Args:
            seam: The name of a seam.
            world: The number of the world.

        Returns:
            gaps (E, 3) [m], from the point of the second object to that of the first; forces (E, 3) [N] on the point of
            the first object in the last substep; and broken (E,) of bool.

        Raises:
            ValueError: There is no such seam.
        """
        return self._queries.stitches(seam, world)

    def torn(self, name: str, world: int = 0) -> dict[str, np.ndarray]:
        """Return kind -> (S,) bool, True for each of `springs` that failed in one world.

        Raises ValueError if the object does not tear.
        """
        return self._queries.torn(name, world)

    def tears(self, name: str) -> bool:
        """Return True if an object can tear."""
        return self._queries.tears(name)

    def panels_left(self, name: str, world: int) -> wp.array:
        """Triangles (T,) vec3i of a sheet that tears, on the device; failed triangles have three equal corners."""
        return self._queries.panels_left(name, world)

    def cut(self, name: str, polygon: Any, world: Any = None) -> int:
        """Cut a sheet: every spring that crosses a planar polygon fails for good.

        Args:
            name: The sheet; it must have a tear_strain above 0.
            polygon: Corners (n, 3) [m], 3 or more.
            world: The number of a world, a mask (worlds,) of bool, or None for all.

        Returns:
            The number of structural and shear springs that failed, over all worlds that are cut.

        Raises:
            ValueError: The object does not tear, or the polygon is not flat or has no area.
        """
        return self._cuts.cut(name, polygon, world)

    def set_positions(self, name: str, positions: Any, world: Any = None) -> None:
        """Move all particles to `positions`, pinned ones too; history and multipliers are cleared.

        Positions that strain a spring by more than half get a small perturbation, see starts.off_symmetry.

        Args:
            name: The object.
            positions: (N, 3) [m].
            world: The number of a world, a mask (worlds,) of bool, or None for all.

        Raises:
            ValueError: The positions have another shape, or are not finite or too large.
        """
        self._placing.set_positions(name, positions, world)

    def set_velocities(self, name: str, velocities: Any, world: Any = None) -> None:
        """Set the velocities of all particles; pinned ones stay at rest, and history and multipliers are cleared.

        Args:
            name: The object.
            velocities: (N, 3) [m/s].
            world: The number of a world, a mask (worlds,) of bool, or None for all.

        Raises:
            ValueError: The velocities have another shape, or are not finite or too large.
        """
        self._placing.set_velocities(name, velocities, world)

    def positions(self, name: str, world: Any = 0) -> np.ndarray:
        """Positions (N, 3) float32 [m] in one world, or (k, N, 3) in several (None: all), in one copy."""
        return self._queries.positions(name, world)

    def velocities(self, name: str, world: Any = 0) -> np.ndarray:
        """Velocities (N, 3) float32 [m/s] in one world, or (k, N, 3) in several (None: all), in one copy."""
        return self._queries.velocities(name, world)

    def device_arrays(self, name: str, world: int = 0, writes: bool = True) -> tuple[Arrays, slice, wp.Device]:
        """Return the arrays of an object's batch in one world, the slice of its particles in them, and the device.

        They are valid until `builds` changes. Method auto may rebuild them when live parameters or positions are set.
        A caller that `writes` to them wakes bodies at rest.
        """
        return self._queries.device_arrays(name, world, writes)

    def tensor(self, name: str, what: str) -> wp.array:
        """Return a view of one quantity of an object, collider or handle in all worlds, on the device.

        Objects have:
            "positions": (worlds, N, 3) float32 [m].
            "velocities": (worlds, N, 3) float32 [m/s].
            "contact_forces": (worlds, N, 3) [N], the sum over colliders on each particle, mean over the last frame.
            "recoveries": (worlds,) int32, the number of times the object was put back.
            "tensions": (worlds, S) float32 [N], ropes only, see `tensions`.

        Colliders and handles have:
            "pose": (worlds, 7) float32, position x y z [m], then orientation x y z w.
            "wrench": (worlds, 6) float32, force [N], then torque [N m] about the origin.

        The view shows the state after the last launched frame, on Warp's stream of the device. Tensions, wrenches, and
        contact forces of several colliders are computed by this call and change only with the next one. A tensor goes
        to torch, JAX and CuPy by DLPack; treat it as read-only. It is valid until `builds` changes. Method auto may
        rebuild the arrays when live parameters or positions are set.
        """
        return self._tensors.tensor(name, what)

    def write(self, name: str, what: str, array: Any, mask: Any = None, sweep: bool = True) -> None:
        """Write one quantity of an object, collider or handle in many worlds.

        Pinned particles move and stay at rest. History and multipliers of the object are cleared. The call waits for
        the device to check all numbers.

        Args:
            name: The object, collider or handle.
            what: "positions" [m] or "velocities" [m/s] (worlds, N, 3) of an object, or "pose" (worlds, 7) of any. The
                "pose" of an object places its rest shape there, at rest. "rest_turns" [-] (worlds, N - 2, 2) of a rope
                that resists twist: the turn of each joint at rest, along its two directors. "lags" [rad] (worlds,
                N - 1) of one, after positions and velocities: by what its segments are turned about themselves beyond
                their balance as the motion begins, if clamps hold both ends.
            array: An array of NumPy or Warp, or any that DLPack takes; its first axis is all worlds.
            mask: (worlds,) of bool, the worlds to write; None writes all.
            sweep: If True, a collider or handle reaches the pose at the end of the next frame. If False, it is there
                at once.

        Raises:
            ValueError: A name, shape or number is not allowed; nothing changes then.
        """
        self._tensors.write(name, what, array, mask, sweep)

    def recovered(self) -> np.ndarray:
        """(worlds,) bool: True where an object was put back at the end of the last frame, see `report`."""
        return self._tensors.recovered()

    def wrench(self, collider: str, world: int = 0) -> tuple[np.ndarray, np.ndarray]:
        """Force (3,) [N] and torque (3,) [N m] of all objects on a collider, about its origin, in world axes.

        Both are means over the last frame. The torque uses particle positions at the end of the frame. The weight of a
        cloth that lies on the collider points down.
        """
        return self._queries.wrench(collider, world)

    def wrenches(self, world: int = 0) -> np.ndarray:
        """Wrenches of all rows of colliders (K, 6) float32: force [N], then torque [N m], see `wrench`."""
        return self._queries.wrenches(world)

    def tensions(self, name: str, world: int = 0) -> np.ndarray:
        """Tensions (S,) float32 [N] of a rope's segments at the end of the last substep in one world.

        Rigid segments have tensions too. A tension is below 0 for a compressed segment, and 0 for a segment on a winch.
        Raises ValueError for a cloth.
        """
        return self._ropes.tensions(name, world)

    def tensions_into(self, out: wp.array, column: int, name: str, world: int = 0) -> Tensions:
        """Return an object whose launch() writes the tensions of a rope into a column of a device array.

        Args:
            out: (N, columns) float on the device, one row per particle.
            column: The column to write.
            name: The rope.
            world: The number of the world.

        Returns:
            A Tensions, valid until `builds` changes.

        Raises:
            ValueError: The object is a cloth.
        """
        return self._ropes.tensions_into(out, column, name, world)

    def directors(self, name: str, world: int | None = 0) -> np.ndarray:
        """Unit vectors (S, 3) float64 across a rope's segments, which turn with its material, in one world.

        They are those of the last substep, (worlds, S, 3) in all worlds for None. Raises ValueError if the object does
        not resist twist.
        """
        return self._ropes.directors(name, world)

    def end_wrenches(self, name: str, world: int = 0) -> np.ndarray:
        """Loads (2, 6) float32 of a rope on the supports of its start and its end, in one world.

        Each row is force [N], then torque [N m] about the end particle, in world axes. All particles held from an end
        on count, with their weight. With a clamp of two particles the torque is the clamping moment. A free end has no
        load. Raises ValueError for a cloth.
        """
        return self._ropes.end_wrenches(name, world)

    def end_wrenches_into(self, out: wp.array, name: str, world: int = 0) -> EndWrenches:
        """Return an object that writes the end wrenches of a rope into a device array (2, 6) float.

        It is valid until `builds` changes. Raises ValueError for a cloth.
        """
        return self._ropes.end_wrenches_into(out, name, world)

    def set(self, name: str, value: Any, world: Any = None) -> None:
        """Set a live parameter.

        Setting a scale restarts the object with its rest shape scaled; all else stays as set, the total mass too. A
        sheet grows about its position, a rope from its start.

        Args:
            name: Such as "cloth.stretch_compliance", "cloth.mass", "cloth.scale", "ball.radius", "gravity" or
                "solver.substeps".
            value: One value, or an array whose first axis is all worlds.
            world: The number of a world, a mask (worlds,) of bool, or None for all. Solver settings take None only.

        Raises:
            ValueError: The name or value is not allowed; nothing changes then.
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
        """Move a collider to a pose.

        Args:
            name: The collider.
            position: (3,) [m], or an array whose first axis is all worlds.
            orientation: Quaternion (4,) x y z w, or an array whose first axis is all worlds.
            sweep: If True, the collider sweeps to the pose and reaches it at the end of the next frame. If False, it is
                there at once, without a motion: for placing it, not for pushing.
            world: The number of a world, a mask (worlds,) of bool, or None for all.

        Raises:
            ValueError: There is no such collider, or the pose is not allowed.
        """
        self._live.set_collider_pose(name, position, orientation, sweep, world)

    def squeeze(self, name: str, load: float, gap: float, world: Any = None) -> None:
        """Let a collider and its opposite one press on what both touch, from the next frame on.

        Each point between them is pressed from both sides by `load`, beyond what its depth gives, until it leaves the
        space between them. Friction and wrenches have the load. Points that one of them touches alone have none.

        Args:
            name: One of two colliders that are each other's `opposite`.
            load: On each point [N]; 0 is none.
            gap: Distance between the two surfaces [m].
            world: The number of a world, a mask (worlds,) of bool, or None for all.

        Raises:
            ValueError: There is no such collider, or the load is not allowed.
        """
        self._live.squeeze(name, load, gap, world)

    def is_squeezing(self, name: str, world: int = 0) -> bool:
        """True if a collider and its opposite one squeezed anything in the last frame, see `squeeze`."""
        return self._live.is_squeezing(name, world)

    def thinnest(self, world: int = 0) -> float:
        """Least thickness, or radius, of the objects [m]."""
        return self._live.thinnest(world)

    def add_collider(self, name: str, collider: Collider) -> None:
        """Add a collider of one of SPARE_SHAPES in all worlds, from the next frame on.

        It replaces an added collider of the same name. Raises ValueError if no spare collider is left.
        """
        self._live.add_collider(name, collider)

    def remove_collider(self, name: str) -> None:
        """Remove an added collider."""
        self._live.remove_collider(name)

    def set_handle_pose(
        self,
        name: str,
        position: Any,
        orientation: Any = (0.0, 0.0, 0.0, 1.0),
        sweep: bool = True,
        world: Any = None,
    ) -> None:
        """Move a handle, and the particles it holds, to a pose.

        Args:
            name: The handle.
            position: (3,) [m], or an array whose first axis is all worlds.
            orientation: Quaternion (4,) x y z w, or an array whose first axis is all worlds.
            sweep: If True, the handle reaches the pose at the end of the next frame. If False, it is there at once:
                for placing an empty handle, as a jump would tear along the particles it holds.
            world: The number of a world, a mask (worlds,) of bool, or None for all.

        Raises:
            ValueError: There is no such handle, or the pose is not allowed.
        """
        self._hands.set_handle_pose(name, position, orientation, sweep, world)

    def attach(self, name: str, world: Any = None) -> int | np.ndarray:
        """Grasp the free particles within reach of a handle; return how many it holds now, see `held`."""
        return self._hands.attach(name, world)

    def release(self, name: str, world: Any = None) -> None:
        """Release all particles that a handle holds; they keep their velocities."""
        self._hands.release(name, world)

    def held(self, name: str, world: Any = None) -> int | np.ndarray:
        """Number of particles that a handle holds: in one world, or in each of several (None: all)."""
        return self._hands.held(name, world)

    def broken(self, name: str, world: int = 0) -> int:
        """Number of times a handle let go because its load exceeded its break_force."""
        return self._hands.broken(name, world)

    def handle_wrench(self, name: str, world: int = 0) -> tuple[np.ndarray, np.ndarray]:
        """Force (3,) [N] and torque (3,) [N m] on a handle about its origin, in world axes, mean over the last frame.

        The weight of a cloth that hangs from the handle points down.
        """
        return self._hands.handle_wrench(name, world)

    def handle_wrenches(self, world: int = 0) -> np.ndarray:
        """Wrenches of all handles (H, 6) float32: force [N], then torque [N m], see `handle_wrench`."""
        return self._hands.handle_wrenches(world)

    def handle_position(self, name: str, world: int = 0) -> np.ndarray:
        """Position (3,) [m] of a handle at the end of the last frame."""
        return self._hands.handle_position(name, world)
