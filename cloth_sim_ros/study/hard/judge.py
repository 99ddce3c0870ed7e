"""Runs one combination of case, body, method and parameters, and says what it did not keep."""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from cloth_sim_ros.sim import Settings, Simulation
from cloth_sim_ros.study.hard.bodies import BODY, Energy
from cloth_sim_ros.study.hard.cases import CASES, Case
from cloth_sim_ros.study.hard.trials import WHIP, Trial

METHODS: dict[str, dict[str, Any]] = {
    "xpbd 1": {"method": "xpbd", "order": 1},
    "xpbd 2": {"method": "xpbd", "order": 2},
    "auto": {"method": "auto"},
    "verlet": {"method": "verlet"},
    "verlet, its substeps": {"method": "verlet"},  # as many as it asks for
}
SUBSTEPS, ITERATIONS = (1, 5, 20, 80), (1, 10)
MOST_SUBSTEPS = 4000  # that a run is worth
LEAST = 1e-4  # [J] that energies are compared to
DEEPEST = 1e-4  # [m]


@dataclass(frozen=True)
class Combination:
    """What one run is made of; `seed` draws what the options leave open."""

    case: str
    kind: str
    method: str
    options: dict[str, Any]
    seed: int

    def __str__(self) -> str:
        options = ", ".join(f"{name} {value}" for name, value in self.options.items())
        return f"{self.case}; {self.kind}; {self.method}; {options}; seed {self.seed}"


@dataclass(frozen=True)
class Verdict:
    """outcome: "pass", "refused" or "failed"; why: of the latter two; residual [m] that the run reported at its end."""

    outcome: str
    why: str = ""
    residual: float = math.nan


def combinations(seed: int, names: list[str] | None = None, methods: list[str] | None = None) -> Iterator[Combination]:
    """All of them: every case, kind of body, method and entry of the case's grid, the rest drawn from `seed`."""
    random = np.random.default_rng(seed)
    for case in CASES.values():
        for kind, method, options in itertools.product(case.kinds, METHODS, _grid(case)):
            drawn = {"substeps": int(random.choice(SUBSTEPS)), "iterations": int(random.choice(ITERATIONS)), **options}
            own = int(random.integers(2**31))
            if case.name in (names or CASES) and method in (methods or METHODS):
                yield Combination(case.name, kind, method, drawn, own)


def _grid(case: Case) -> list[dict[str, Any]]:
    return [dict(zip(case.grid, values, strict=True)) for values in itertools.product(*case.grid.values())]


def judge(combination: Combination, device: str) -> Verdict:
    """Run a combination on a device and hold it against what its case promises."""
    random = np.random.default_rng(combination.seed)
    options = combination.options
    trial = CASES[combination.case].trial(combination.kind, options, random)
    settings = {**METHODS[combination.method], "frame_dt": trial.frame_dt, "iterations": options["iterations"]}
    try:
        sim = _simulation(trial, settings, options["substeps"], device, combination.method.endswith("its substeps"))
    except ValueError as refusal:
        wrong = _unfounded(str(refusal), trial, settings)
        return Verdict("failed", wrong) if wrong else Verdict("refused", str(refusal))
    return watch(sim, trial)


def _simulation(trial: Trial, settings: dict, substeps: int, device: str, obliging: bool) -> Simulation:
    try:
        return Simulation(trial.scene, Settings(substeps=substeps, **settings), device)
    except ValueError as refusal:
        needed = re.search(r"at least (\d+) ", str(refusal))
        if not obliging or needed is None or int(needed[1]) > MOST_SUBSTEPS:
            raise
        return Simulation(trial.scene, Settings(substeps=int(needed[1]), **settings), device)


def _unfounded(refusal: str, trial: Trial, settings: dict) -> str:
    """ "" if a refusal of method verlet is right: what it lacks is there, or the step is indeed unstable."""
    body = trial.scene.objects[BODY]
    bends = getattr(body, "bend_compliance", None) is not None and getattr(body, "bending", "angle") != "springs"
    if "bends by angles" in refusal and bends:
        return ""
    needed = re.search(r"at least (\S+) ", refusal)
    if settings["method"] != "verlet" or needed is None:
        return f"refused without need: {refusal}"
    energy = Energy(Simulation(trial.scene, Settings(method="xpbd", rope_solver="gauss_seidel"), "cpu"))
    rigid = min(body.stretch_compliance, getattr(body, "shear_compliance", None) or math.inf) == 0.0
    if rigid or needed[1] == "inf":
        return "" if rigid and needed[1] == "inf" else f"refused as rigid: {refusal}"
    longest = energy.longest_step(body.damping)
    least = trial.frame_dt / longest
    return "" if 0.9 * least <= float(needed[1]) <= 1.5 * least + 1.0 else f"needs {least:.0f} substeps, but: {refusal}"


def _undisturbed(sim: Simulation, trial: Trial, energy: Energy) -> float:
    """The strain after the same time from the rest shape: gravity's, and what few iterations leave."""
    if not math.isfinite(trial.rest):
        return 0.0
    sim.reset()
    sim.step(trial.frames)
    return energy.strain(sim.positions(BODY).astype(np.float64))


def watch(sim: Simulation, trial: Trial) -> Verdict:
    """Run a trial and name the first thing that it does not keep."""
    trial.begin(sim)
    energy = Energy(sim)
    x, v = (read(BODY).astype(np.float64) for read in (sim.positions, sim.velocities))
    stored, height = energy.at_start(x, v)
    h = trial.frame_dt / sim.settings.substeps
    fastest = WHIP * trial.jump / h if trial.jump else trial.fastest
    fallen, work, momentum = 0.0, 0.0, energy.momentum(v)
    for frame in range(trial.frames):
        trial.drive(sim, frame)
        sim.step()
        x, v = (read(BODY).astype(np.float64) for read in (sim.positions, sim.velocities))
        when = f"after {(frame + 1) * trial.frame_dt:.2f} s"
        if not (np.isfinite(x).all() and np.isfinite(v).all()):
            return Verdict("failed", f"not finite {when}")
        speed = float(np.linalg.norm(v, axis=1).max())
        if speed > fastest:
            return Verdict("failed", f"a particle at {speed:.4g} m/s {when}, allowed {fastest:g}")
        fallen = max(fallen, height - energy.height(x))
        if trial.velocity is not None:
            work += trial.velocity(frame) * float(energy.momentum(v) - momentum)
            momentum = energy.momentum(v)
        limit = stored + height + work + trial.slack * max(stored, energy.scale(), fallen, work, LEAST)
        if trial.conserves and sum(energy.of(x, v)) > limit:
            return Verdict("failed", f"energy {sum(energy.of(x, v)):.4g} J {when}, allowed {limit:.4g}")
        if trial.outside and (depth := sim.report()[BODY]["max_penetration"]) > DEEPEST:
            return Verdict("failed", f"{depth:.3g} m deep in a collider {when}")
    report = sim.report()[BODY]
    if report["recoveries"]:
        return Verdict("failed", f"put back {report['recoveries']} times")
    if energy.strain(x) > trial.rest + (undisturbed := _undisturbed(sim, trial, energy)):
        return Verdict("failed", f"strain {energy.strain(x):.3g}, from a good start {undisturbed:.3g}")
    wrong = trial.finally_(sim)
    return Verdict("failed", wrong) if wrong else Verdict("pass", residual=report["residual"])
