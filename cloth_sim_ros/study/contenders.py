# SPDX-License-Identifier: Apache-2.0
"""Contenders in the figure of error against time: the product's own methods, and the classic ones in NumPy.

To add one, add its row to CONTENDERS: a label, a function from a run to its frames and times, and what it can do.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from cloth_sim_ros.sim import Settings
from cloth_sim_ros.study import motion
from cloth_sim_ros.study.case import BODY, FRAME_DT, Case
from cloth_sim_ros.study.relaxation import position_based
from cloth_sim_ros.study.springs import SpringSystem
from cloth_sim_ros.study.timing import frame_times


@dataclass(frozen=True)
class Run:
    """A run of a case at `resolution` with springs of `constant` [N/m] on `device`, in `worlds` copies at once.

    Its result is the motion of the first copy, and the time of all.
    """

    case: Case
    resolution: int
    constant: float
    device: str
    substeps: int
    iterations: int
    worlds: int = 1


Simulate = Callable[[Run], tuple[np.ndarray, np.ndarray]]


@dataclass(frozen=True)
class Contender:
    """A method in the study. `simulate` takes a run; returns frames (F + 1, N, 3) [m], and milliseconds of each.

    Frames are not finite from a blow-up on. iterations: the numbers of iterations to try instead of the command line's,
    (1,) for a method without any. numpy: True for a reference in NumPy, timed on one core of the host. own_limit: True
    for a model without springs, which simulates only sheets and is judged by its own converged motion.
    """

    label: str
    simulate: Simulate
    iterations: tuple[int, ...] = ()
    numpy: bool = False
    own_limit: bool = False

    def takes(self, case: Case, worlds: int = 1) -> bool:
        """Return True if the method can run so many copies of `case`."""
        if self.numpy and worlds > 1:
            return False
        if self.own_limit:
            return case.springs_alone and not case.is_rope
        return case.springs_alone or not self.numpy


BUDGET = 100.0  # of `auto`, more than any run takes: its error counts, whatever the time
ERROR = 1e-3  # wanted of `auto` where others take 20 substeps


def product(**settings: object) -> Simulate:
    """Return a function that simulates a run by the product with these settings."""

    def simulate(run: Run) -> tuple[np.ndarray, np.ndarray]:
        numbers = {"frame_dt": FRAME_DT, "substeps": run.substeps, "iterations": run.iterations}
        if settings["method"] == "auto":  # it is told the error instead, which falls as that of a second order does
            error = min(ERROR * (20.0 / run.substeps) ** 2, 1.0)
            numbers |= {"substeps": 0, "iterations": 0, "error": error, "budget": BUDGET}
        chosen = Settings(**numbers, **settings)
        sim = run.case.simulation(run.resolution, run.constant, chosen, run.device, run.worlds)
        sim.step(2)  # compiles
        sim.reset()
        frames = [sim.positions(BODY, world=0)]
        times = frame_times(sim, run.case.frames, after=lambda: frames.append(sim.positions(BODY, world=0)))
        return np.array(frames, dtype=np.float64), times

    return simulate


def where_stable(simulate: Simulate) -> Simulate:
    """Return `simulate`, with frames of NaN if the product refuses explicit steps as unstable or lacking."""

    def attempt(run: Run) -> tuple[np.ndarray, np.ndarray]:
        try:
            return simulate(run)
        except ValueError as problem:
            if "'verlet'" not in str(problem):
                raise
        return np.full((run.case.frames + 1, 1, 3), np.nan), np.full(run.case.frames, np.nan)

    return attempt


def classic(make: Callable[[SpringSystem, int], motion.Step]) -> Simulate:
    """Return a function that simulates by steps in NumPy, made for a system and a number of iterations."""

    def simulate(run: Run) -> tuple[np.ndarray, np.ndarray]:
        system, x = run.case.system(run.resolution, run.constant)
        v, step = np.zeros_like(x), make(system, run.iterations)
        frames = np.full((run.case.frames + 1, *x.shape), np.nan)
        frames[0] = x
        times = []
        with np.errstate(all="ignore"):  # methods that blow up are part of the study
            for frame in range(run.case.frames):
                start = time.perf_counter()
                for _ in range(run.substeps):
                    x, v = step(system, x, v, FRAME_DT / run.substeps)
                times.append(1e3 * (time.perf_counter() - start))
                if not np.isfinite(x).all():
                    break
                frames[frame + 1] = x
        return frames, np.array(times)

    return simulate


CONTENDERS = (
    Contender("XPBD, first order", product(method="xpbd", order=1)),
    Contender("XPBD, second order", product(method="xpbd", order=2)),
    Contender("Verlet", where_stable(product(method="verlet")), iterations=(1,)),
    Contender("auto", product(method="auto"), iterations=(1,)),
    Contender("forward Euler (NumPy)", classic(lambda *_: motion.forward_euler), iterations=(1,), numpy=True),
    Contender("leapfrog Verlet (NumPy)", classic(lambda *_: motion.leapfrog), iterations=(1,), numpy=True),
    Contender("PBD (NumPy)", classic(position_based), numpy=True),
)
