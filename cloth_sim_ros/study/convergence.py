# SPDX-License-Identifier: Apache-2.0
"""The converged motion of a scene's settings, with its uncertainty, and where chaos ends the comparison."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from cloth_sim_ros.ros.parameters.plan import Plan  # noqa: TID251 (free of rclpy, which a test proves)
from cloth_sim_ros.sim import Settings, Simulation, topology
from cloth_sim_ros.sim.substeps.control import AT_REST, OF_SIZE
from cloth_sim_ros.study import norms
from cloth_sim_ros.study.timing import frame_times

MOST_SWEEPS = 8192  # substeps x iterations a frame of the finest run
SHARE = {1: 1.0, 2: 1.0 / 3.0}  # order -> error of a run over its distance from the one of half as many substeps


@dataclass(frozen=True)
class Trial:
    """`frames` frames of a scene whose colliders in `moves` move smoothly from their start by those vectors [m]."""

    plan: Plan
    frames: int
    moves: Mapping[str, np.ndarray] = field(default_factory=dict)

    def place(self, sim: Simulation, frame: int) -> None:
        """Send the colliders to where they are at the end of `frame`."""
        share = 0.5 - 0.5 * np.cos(np.pi * min(1.0, (frame + 1) / self.frames))
        for name, vector in self.moves.items():
            collider = self.plan.scene.colliders[name]
            sim.set_collider_pose(name, np.add(collider.position, share * vector), collider.orientation)


@dataclass(frozen=True)
class Converged:
    """Frames (F + 1, N, 3) [m] of all objects one after another, by XPBD of `order`; the first `trusted` count.

    uncertainty [m]: their estimated RMS error; apart [m]: RMS distance of the finest runs of both orders; moved [m]:
    RMS distance from the start; scale [m]: what an error is relative to, see `scale_of`.
    """

    frames: np.ndarray
    trusted: int
    uncertainty: float
    apart: float
    moved: float
    scale: float
    order: int
    substeps: int
    iterations: int

    @property
    def chaotic(self) -> bool:
        """True if some of the frames cannot be judged."""
        return self.trusted < len(self.frames)


def converge(trial: Trial, error: float) -> Converged:
    """Double substeps and iterations of both orders until one order is known to a tenth of `error`, which is relative.

    The error of a run is SHARE times the larger of its last change and half of the one before, as one small change can
    be chance if contacts open and close. The order that is known better judges the scene. The search ends at
    MOST_SWEEPS.
    """
    substeps, iterations = 40, 2
    runs = {order: [_fine(trial, order, substeps, iterations)] for order in SHARE}
    beside, limit = _fine(trial, 2, substeps, iterations, beside=True), error * scale_of(trial.plan, runs[2][0])
    count = norms.trusted_frames(runs[2][0], beside, limit)
    count = max(count, 2)  # one frame after the start can always be judged
    while True:
        substeps, iterations = 2 * substeps, 2 * iterations
        for order, found in runs.items():
            found.append(_fine(trial, order, substeps, iterations))
        if len(runs[2]) < 3:
            continue
        known = {order: SHARE[order] * _change(found, count) for order, found in runs.items()}
        order = min(known, key=known.get)
        fine = runs[order][-1]
        scale = scale_of(trial.plan, fine[:count])
        if known[order] < 0.1 * error * scale or 4 * substeps * iterations > MOST_SWEEPS:
            apart = norms.rms(runs[1][-1][1:count] - runs[2][-1][1:count])
            moved = norms.rms(fine[1:count] - fine[0])
            return Converged(fine, count, known[order], apart, moved, scale, order, substeps, iterations)


def scale_of(plan: Plan, frames: np.ndarray) -> float:
    """Return what an error of `frames` (F + 1, N, 3) is relative to [m], as that of solver.error.

    It is the RMS distance from the start, or a tenth of the largest object where that is next to nothing.
    """
    moved = norms.rms(frames[1:] - frames[0])
    layouts = [topology.build(thing, name, direct_ropes=True).layout for name, thing in plan.scene.objects.items()]
    size = max(float(np.ptp(layout, axis=0).max()) for layout in layouts)
    return moved if moved >= AT_REST * size else OF_SIZE * size


def _change(runs: list[np.ndarray], count: int) -> float:
    """Return the larger of the last change [m] between `runs` and half of the one before, over `count` frames."""
    before, last = (norms.rms(runs[k][1:count] - runs[k - 1][1:count]) for k in (-2, -1))
    return max(last, 0.5 * before)


def frames_of(trial: Trial, settings: Settings, count: int, beside: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """Return positions (count + 1, N, 3) [m] of all objects, and milliseconds of every frame.

    beside: True to start 1e-6 m away.
    """
    sim = Simulation(trial.plan.scene, settings, device=trial.plan.device)
    sim.step(2)  # compiles
    sim.reset()
    if beside:
        _perturb(sim, trial.plan)
    found = [_positions(sim, trial.plan)]

    def look() -> None:
        found.append(_positions(sim, trial.plan))
        trial.place(sim, len(found) - 1)

    trial.place(sim, 0)
    times = frame_times(sim, count, after=look)
    return np.array(found), times


def _fine(trial: Trial, order: int, substeps: int, iterations: int, beside: bool = False) -> np.ndarray:
    steps = {"method": "xpbd", "order": order, "substeps": substeps, "iterations": iterations}
    return frames_of(trial, dataclasses.replace(trial.plan.settings, **steps), trial.frames, beside)[0]


def _perturb(sim: Simulation, plan: Plan) -> None:
    for name, thing in plan.scene.objects.items():
        rest = sim.positions(name).astype(np.float64)
        free = ~topology.build(thing, name, direct_ropes=True).pinned[:, None]
        sim.set_positions(name, rest + free * norms.perturbation(rest.shape))


def _positions(sim: Simulation, plan: Plan) -> np.ndarray:
    return np.concatenate([sim.positions(name) for name in plan.scene.objects]).astype(np.float64)
