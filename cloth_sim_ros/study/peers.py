# SPDX-License-Identifier: Apache-2.0
"""Peers on the same springs, if installed: NVIDIA Newton (XPBD, VBD) and PositionBasedDynamics (pyPBD).

They come with `pip install cloth_sim_ros[peers]`. Each gets the masses, springs and fixed particles of the case's
SpringSystem, substeps and iterations of the run, and is judged against the same exact motion. Those without such
springs are in other_models.py. To add a peer, add a function from a run to its frames and times, and its row.
"""

from __future__ import annotations

import importlib.util
import os
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
import warp as wp

from cloth_sim_ros.study.cases import FRAME_DT
from cloth_sim_ros.study.springs import SpringSystem
from cloth_sim_ros.study.timing import milliseconds

if TYPE_CHECKING:
    from cloth_sim_ros.study.contenders import Run

Frames = tuple[np.ndarray, np.ndarray]


@dataclass(frozen=True)
class Peer:
    """A third-party solver. `simulate`(run) returns frames (F + 1, N, 3) [m] and milliseconds (F,).

    package: the module that it imports. The flags say if it runs on a GPU, on a CPU and in many `worlds` at once, and
    if it `iterates` in a substep.
    """

    label: str
    package: str
    simulate: Callable[[Run], Frames]
    on_gpu: bool
    on_cpu: bool = True
    worlds: bool = True
    iterates: bool = True

    def why_not(self, device: str, worlds: int = 1) -> str:
        """Return one sentence why it cannot stand in the figure of so many worlds on `device`, or ""."""
        if importlib.util.find_spec(self.package) is None:
            return f"{self.label} is left out: the package {self.package!r} is not installed (extra [peers])"
        if device.startswith("cuda") and not self.on_gpu:
            return f"{self.label} is left out: it runs on the CPU alone"
        if device == "cpu" and not self.on_cpu:
            return f"{self.label} is left out: it is made for GPUs"
        if worlds > 1 and not self.worlds:
            return f"{self.label} is left out: it runs one world at a time"
        return ""


def newton(method: str) -> Callable[[Run], Frames]:
    """Return Newton's solver "xpbd" or "vbd", on a GPU as one captured graph a frame."""

    def simulate(run: Run) -> Frames:
        from newton import solvers  # an optional package, imported where it is used

        system, start = run.case.system(run.resolution, run.constant)
        model = _newton_model(system, start, run)
        kind = {"xpbd": solvers.SolverXPBD, "vbd": solvers.SolverVBD}[method]
        return run_newton(kind(model, iterations=run.iterations), start, run)

    return simulate


def run_newton(solver, start: np.ndarray, run: Run) -> Frames:
    """Return frames and times of a solver of Newton's from rest at `start` (N, 3) [m] in all worlds."""
    model = solver.model
    states, control = [model.state(), model.state()], model.control()
    substeps = run.substeps + run.substeps % 2  # both states take turns and must be back in place for a graph

    def advance() -> None:
        for _ in range(substeps):
            states[0].clear_forces()
            solver.step(states[0], states[1], control, None, FRAME_DT / substeps)
            states.reverse()

    device, step = wp.get_device(model.device), advance
    advance()  # compiles
    if device.is_cuda:
        with wp.ScopedCapture(device=device) as capture:
            advance()
        step = partial(wp.capture_launch, capture.graph)
    states[0].particle_q.assign(np.tile(start.astype(np.float32), (run.worlds, 1)))
    states[0].particle_qd.zero_()
    return record(step, lambda: states[0].particle_q[: len(start)].numpy(), start, run.case.frames, device)


def _newton_model(system: SpringSystem, start: np.ndarray, run: Run):
    from newton import Axis, ModelBuilder

    builder = ModelBuilder(up_axis=Axis.Z, gravity=system.gravity)
    for position, mass, fixed in zip(start, system.masses, system.fixed, strict=True):
        # A radius would make particles touch, those of other worlds too, which lie where these do.
        builder.add_particle(wp.vec3(*position), wp.vec3(0.0, 0.0, 0.0), 0.0 if fixed else float(mass), radius=0.0)
    for (i, j), constant in zip(system.pairs, system.constant, strict=True):
        builder.add_spring(int(i), int(j), float(constant), system.damping * float(constant), 0.0)
    builder.set_coloring(colours(system))  # builder.color() knows no springs: VBD would turn into Jacobi
    model = finalized(builder, run)
    model.spring_rest_length.assign(np.tile(system.rest_length.astype(np.float32), run.worlds))
    return model


def finalized(builder, run: Run):
    """Return Newton's model of all worlds of a run, from a builder of one."""
    from newton import Axis, ModelBuilder

    if run.worlds > 1:
        one, builder = builder, ModelBuilder(up_axis=Axis.Z, gravity=builder.gravity)
        builder.replicate(one, run.worlds)
    return builder.finalize(device=None if run.device == "auto" else run.device)


def colours(system: SpringSystem) -> list[np.ndarray]:
    """Return particles by colour, such that no two of one colour share a spring (greedy: the least free colour)."""
    neighbours = abs(system.incidence) @ abs(system.incidence).T
    colour = np.full(len(system.masses), -1)
    for i in range(len(colour)):
        taken = colour[neighbours.indices[neighbours.indptr[i] : neighbours.indptr[i + 1]]]
        colour[i] = np.setdiff1d(np.arange(len(taken) + 1), taken)[0]
    return [np.flatnonzero(colour == k) for k in range(colour.max() + 1)]


def pypbd(run: Run) -> Frames:
    """Simulate by XPBD of PositionBasedDynamics, whose rest lengths are those of the start and whose up axis is y."""
    os.environ.setdefault("OMP_NUM_THREADS", "1")  # one core, as the product takes
    import pypbd as library

    system, start = run.case.system(run.resolution, run.constant)
    lengths = np.linalg.norm(start[system.pairs[:, 1]] - start[system.pairs[:, 0]], axis=1)
    if not np.allclose(lengths, system.rest_length, rtol=1e-4):
        raise ValueError(f"{run.case.name} starts strained; allowed for pyPBD are cases that start at rest")
    simulation = library.Simulation.getCurrent()
    simulation.initDefault()
    model = simulation.getModel()
    model.cleanup()
    model.init()
    particles = model.getParticles()
    for x, y, z in start:
        particles.addVertex([x, z, y])
    for i, mass in enumerate(np.where(system.fixed, 0.0, system.masses)):
        particles.setMass(i, float(mass))
    for (i, j), constant in zip(system.pairs, system.constant, strict=True):
        model.addDistanceConstraint_XPBD(int(i), int(j), float(constant))
    model.initConstraintGroups()
    controller = simulation.getTimeStep()
    controller.setValueUInt(library.TimeStepController.NUM_SUB_STEPS, run.substeps)
    controller.setValueUInt(library.TimeStepController.MAX_ITERATIONS, run.iterations)
    library.TimeManager.getCurrent().setTimeStepSize(FRAME_DT)
    return record(
        lambda: controller.step(model),
        lambda: np.array(particles.getVertices())[:, [0, 2, 1]],
        start,
        run.case.frames,
        wp.get_device("cpu"),
    )


def record(step: Callable, positions: Callable, start: np.ndarray, frames: int, device: wp.Device) -> Frames:
    """Return the frames and times of `step`."""
    found, times = [start], []
    for _ in range(frames):
        times.append(milliseconds(step, device))
        found.append(np.array(positions(), dtype=np.float64))
        if not np.isfinite(found[-1]).all():  # nothing comes back from there
            found += [found[-1]] * (frames + 1 - len(found))
            break
    return np.array(found), np.array(times)


PEERS = (
    Peer("Newton XPBD", "newton", newton("xpbd"), on_gpu=True),
    Peer("Newton VBD", "newton", newton("vbd"), on_gpu=True),
    Peer("pyPBD XPBD", "pypbd", pypbd, on_gpu=False, worlds=False),
)
