# SPDX-License-Identifier: Apache-2.0
"""Motion of a SpringSystem by explicit steps: the exact solution in the limit of small steps, and the classic methods.

Frames are the samples at equal intervals `frame_dt` [s] that every comparison uses: positions (F + 1, N, 3), the start
first.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from cloth_sim_ros.study.springs import SpringSystem

Step = Callable[[SpringSystem, np.ndarray, np.ndarray, float], tuple[np.ndarray, np.ndarray]]


def forward_euler(system: SpringSystem, x: np.ndarray, v: np.ndarray, h: float) -> tuple[np.ndarray, np.ndarray]:
    """x + h v, v + h a(x, v): first order, and every step adds energy (Euler 1768)."""
    return x + h * v, v + h * system.accelerations(x, v)


def leapfrog(system: SpringSystem, x: np.ndarray, v: np.ndarray, h: float) -> tuple[np.ndarray, np.ndarray]:
    """Kick, drift, kick: velocity Verlet, second order, symplectic without damping (Verlet 1967).

    Dampers are taken at the velocity before the kick, which is first order in the damping alone.
    """
    middle = v + 0.5 * h * system.accelerations(x, v)
    x = x + h * middle
    return x, middle + 0.5 * h * system.accelerations(x, middle)


def runge_kutta_4(system: SpringSystem, x: np.ndarray, v: np.ndarray, h: float) -> tuple[np.ndarray, np.ndarray]:
    """The classic fourth-order method of Runge and Kutta (1901) for x' = v, v' = a(x, v)."""
    a1 = system.accelerations(x, v)
    v2 = v + 0.5 * h * a1
    a2 = system.accelerations(x + 0.5 * h * v, v2)
    v3 = v + 0.5 * h * a2
    a3 = system.accelerations(x + 0.5 * h * v2, v3)
    v4 = v + h * a3
    a4 = system.accelerations(x + h * v3, v4)
    return x + h / 6.0 * (v + 2.0 * v2 + 2.0 * v3 + v4), v + h / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4)


def frames_by(
    step: Step, system: SpringSystem, x: np.ndarray, v: np.ndarray, frame_dt: float, frames: int, substeps: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return positions and velocities (frames + 1, N, 3) under `substeps` calls of `step` a frame."""
    x, v = np.array(x, dtype=np.float64), np.array(v, dtype=np.float64)
    v[system.fixed] = 0.0
    positions, velocities = [x], [v]
    for _ in range(frames):
        for _ in range(substeps):
            x, v = step(system, x, v, frame_dt / substeps)
        positions.append(x)
        velocities.append(v)
    return np.array(positions), np.array(velocities)


def stable_substeps(system: SpringSystem, frame_dt: float) -> int:
    """Return the substeps a frame with which runge_kutta_4 is stable: w h < 2.7, and tau w^2 h < 2.7 with dashpots."""
    fastest = system.fastest()
    rate = max(fastest, system.damping * fastest**2, system.global_damping)
    return max(1, int(np.ceil(frame_dt * rate / 2.7)))


def exact_frames(
    system: SpringSystem, x: np.ndarray, v: np.ndarray, frame_dt: float, frames: int, tolerance: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the exact motion: positions and velocities (frames + 1, N, 3) to better than `tolerance` / 100 [m].

    The method is runge_kutta_4. Substeps are doubled until the positions change by less than tolerance / 100; the finer
    run is returned. Raises ArithmeticError if six halvings were not enough, as in a chaotic motion.
    """
    substeps = stable_substeps(system, frame_dt)
    coarse = frames_by(runge_kutta_4, system, x, v, frame_dt, frames, substeps)
    for _ in range(6):
        substeps *= 2
        fine = frames_by(runge_kutta_4, system, x, v, frame_dt, frames, substeps)
        if np.abs(fine[0] - coarse[0]).max() < tolerance / 100.0:
            return fine
        coarse = fine
    raise ArithmeticError(f"halving the step down to {frame_dt / substeps:g} s still changes the motion")
