# SPDX-License-Identifier: Apache-2.0
"""The public interface: a scene and settings on a device, advanced frame by frame and read back by name.

Bodies decides how objects are computed and holds their arrays. A Simulation inherits its other methods from access/.
Queries reads objects, and Ropes reads what only ropes have. Hands manages handles. Live changes parameters while the
simulation runs. Placing moves objects, and Cuts cuts them. Tensors reads and writes all worlds at once. Saving writes
the state to a file. This module handles time and state.
"""

from __future__ import annotations

import logging
import os
from numbers import Integral
from typing import Any

import warp as wp

from cloth_sim_ros.sim.access.cuts import Cuts
from cloth_sim_ros.sim.access.live import Live, compliances_of
from cloth_sim_ros.sim.access.live_values import live_value
from cloth_sim_ros.sim.access.loads import Loads
from cloth_sim_ros.sim.access.placing import Placing
from cloth_sim_ros.sim.access.report import measure_object
from cloth_sim_ros.sim.access.saving import Saving
from cloth_sim_ros.sim.access.tensors import Tensors
from cloth_sim_ros.sim.engine.bodies import Bodies
from cloth_sim_ros.sim.scene.objects import Rope, too_thick
from cloth_sim_ros.sim.scene.scene import Scene, large_meshes, odd_meshes
from cloth_sim_ros.sim.scene.settings import Settings
from cloth_sim_ros.sim.substeps.choose import Choice
from cloth_sim_ros.sim.substeps.limits import check_explicit

_LOG = logging.getLogger(__name__)


class Simulation(Live, Placing, Tensors, Cuts):
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
        thick = {name: getattr(thing, "radius", None) or thing.thickness for name, thing in scene.objects.items()}
        doubts = (too_thick(name, thing, thick[name]) for name, thing in scene.objects.items())
        for sentence in (*large_meshes(scene), *odd_meshes(scene), *filter(None, doubts)):
            _LOG.warning(sentence)
        self._bodies = Bodies(scene, settings, device, worlds, executor)
        rows = {"colliders": self._bodies.colliders.array.shape[1], "handles": len(scene.handles)}
        self._loads = {kind: Loads(self._bodies, kind, count) for kind, count in rows.items()}
        self._leaves = wp.zeros_like(self._bodies.handle_counts)
        self._pulls, self._builds_of_pulls, self._pushes = {}, 0, {}
        self._saving = Saving(self._bodies)
        materials = {name: (compliances_of(thing), thing.damping) for name, thing in scene.objects.items()}
        if settings.method == "verlet":
            for name, material in materials.items():
                check_explicit(scene, settings, name, self._bodies.elastic[name], [material])
        self._write_settings()
        self._bodies.build({name: self._bodies.choose(name, [materials[name]], thick[name]) for name in materials})
        self._frames = 0
        self._write_scene()
        self._rubbed, self._odd = {*scene.objects, *scene.colliders}, set()
        self._tell_friction()
        self._reset_handles(None)
        self.moved = self._leave_colliders()
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
        self._tell_friction()
        while frames > 0:
            self._bodies.advance()
            alike = self._bodies.alike(frames)
            self._advance(alike)
            self._frames += alike
            frames -= alike

    def make_ready(self) -> None:
        """Compile the kernels that only some frames need, so that no frame waits; may run in a thread beside `step`."""
        for batch in list(self._bodies.batches):
            batch.make_ready()

    def step_and_estimate(self) -> dict[str, float]:
        """Simulate one frame, measure its error, and return name -> that error in world 0, RMS over particles [m].

        The error is that of this frame alone, as if it started from the exact state; see substeps/control.py. Objects
        that explicit steps compute are left out. `step` measures every few frames itself.
        """
        self._bodies.advance()
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
        self._reset_handles(some)
        if world is None:
            self._frames = 0

    def get(self, name: str, world: int = 0) -> Any:
        """Return the current value of a live parameter in one world.

        It also returns the position or orientation of a collider or handle. Raises ValueError if the scene has no
        parameter of that name.
        """
        return live_value(self._bodies, name, world)

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
        self._bodies.frames.advance(self._frames, frames, self._ending, measured)

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

    def report(self, world: int = 0) -> dict[str, dict[str, float]]:
        """Return name -> measures of the object in one world.

        Every object has:

        - kinetic_energy [J]; elastic_energy [J] without self or object contact, a winch and forces of its own, up to
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
        found = {name: measure_object(batch, name, world) for name, batch in self._bodies.batch.items()}
        if self._bodies.coupled is not None:
            for name, meeting in self._bodies.coupled.report(world).items():
                found[name] |= meeting
        for name, choice in self._bodies.choices.items():
            found[name] = {"expected_error": choice.error, "bending_share": choice.bending_share} | found[name]
        for name, thing in self._bodies.scene.objects.items():
            if isinstance(thing, Rope):
                found[name] |= self._measure_rope(name, thing, world)
        return found
