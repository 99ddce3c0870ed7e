# SPDX-License-Identifier: Apache-2.0
"""Run one combination of case, body, method and parameters, and report the promises that it broke."""

from __future__ import annotations

import dataclasses
import itertools
import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from cloth_sim_ros.sim import Cloth, Rope, Scene, Settings, Simulation
from cloth_sim_ros.sim.colliders import shape_of
from cloth_sim_ros.study.hard.bodies import BODY, Energy, bends_by_angles, substep_of
from cloth_sim_ros.study.hard.cases import CASES, Case
from cloth_sim_ros.study.hard.trial import WHIP, Trial
from cloth_sim_ros.study.hard.trials.contact import SHAPES

METHODS: dict[str, dict[str, Any]] = {
    "xpbd 1": {"method": "xpbd", "order": 1},
    "xpbd 2": {"method": "xpbd", "order": 2},
    "auto": {"method": "auto", "substeps": 0, "iterations": 0},  # with nothing said, as users run it
    "verlet": {"method": "verlet"},  # with as many substeps as it asks for, once it has refused those that are too few
}
SUBSTEPS, ITERATIONS = (1, 5, 20, 80), (1, 10)
MOST_SUBSTEPS = 10000  # a frame, the most that Settings take
LEAST = 1e-4  # [J] that energies are compared to
DEEPEST = 1e-4  # [m]


@dataclass(frozen=True)
class Combination:
    """The choices of one run; `seed` draws those that the options leave open."""

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
    """Outcome of a run: "held", "refused" or "failed".

    A refusal is allowed if the method has no other way, says so, and changes nothing. why: the reason of the latter
    two. residual [m]: that of the run at its end. substeps: those of the run. fold: strain of the fold in which the
    body came to rest (see Energy.fold).
    """

    outcome: str
    why: str = ""
    residual: float = math.nan
    substeps: int = 0
    fold: float = 0.0


def combinations(seed: int, names: list[str] | None = None, methods: list[str] | None = None) -> Iterator[Combination]:
    """Yield every case, kind of body, method and entry of the case's grid; `seed` draws the other choices.

    names, methods: those of cases and methods to yield, or None for all.
    """
    random = np.random.default_rng(seed)
    for case in CASES.values():
        for kind, method, options in itertools.product(case.kinds, METHODS, _grid(case)):
            drawn = {"substeps": int(random.choice(SUBSTEPS)), "iterations": int(random.choice(ITERATIONS)), **options}
            own = int(random.integers(2**31))
            if case.name in (names or CASES) and method in (methods or METHODS):
                yield Combination(case.name, kind, method, drawn, own)


def _grid(case: Case) -> list[dict[str, Any]]:
    return [dict(zip(case.grid, values, strict=True)) for values in itertools.product(*case.grid.values())]


def make_trial(combination: Combination) -> Trial:
    """Make the trial of a combination, with all choices drawn.

    A scene with colliders has one of each shape, the unused ones a kilometre away, so that all share their kernels.
    """
    random = np.random.default_rng(combination.seed)
    trial = CASES[combination.case].trial(combination.kind, combination.options, random)
    there = {shape_of(collider) for collider in trial.scene.colliders.values()}
    if not there:
        return trial
    far = {f"far {name}": make(position=(0.0, 0.0, -1000.0)) for name, make in SHAPES.items() if name not in there}
    scene = dataclasses.replace(trial.scene, colliders={**trial.scene.colliders, **far})
    return dataclasses.replace(trial, scene=scene)


def judge(combination: Combination, device: str) -> Verdict:
    """Run a combination on a device and compare it with the promises of its case."""
    options, trial = combination.options, make_trial(combination)
    numbers = {name: options[name] for name in ("substeps", "iterations")}
    settings = {"frame_dt": trial.frame_dt, **numbers, **METHODS[combination.method]}
    try:
        sim = Simulation(trial.scene, Settings(**settings), device)
    except ValueError as refusal:
        wrong = _unfounded(str(refusal), trial, settings)
        if wrong:
            return Verdict("failed", wrong)
        sim = obliging(str(refusal), trial.scene, settings, device)
        wrong = keeps_state(sim, options["substeps"]) if sim else keeps_soft_state(trial.scene, settings, device)
        if wrong or sim is None:
            return Verdict("failed" if wrong else "refused", wrong or str(refusal))
    return dataclasses.replace(watch(sim, trial), substeps=sim.choices[BODY].substeps)


def _unfounded(refusal: str, trial: Trial, settings: dict) -> str:
    """Return "" if a refusal of method verlet is justified, else what is wrong with it.

    A justified refusal is one sentence. The scene has what the method lacks, or the step is unstable.
    """
    body = trial.scene.objects[BODY]
    if "; allowed is " not in refusal or "\n" in refusal or ". " in refusal:
        return f"not one sentence that says what is allowed: {refusal}"
    if "bending by angles" in refusal and bends_by_angles(body):
        return ""
    needed, hopeless = re.search(r"at least (\S+) ", refusal), "too stiff for explicit steps" in refusal
    if settings["method"] != "verlet" or not (needed or hopeless):
        return f"refused without need: {refusal}"
    energy = Energy(Simulation(trial.scene, Settings(order=1, substeps=20, method="xpbd"), "cpu"))
    rigid = min(body.stretch_compliance, getattr(body, "shear_compliance", None) or math.inf) == 0.0
    if rigid or hopeless:
        lost = rigid or energy.rounding_heat() > 5e-3
        return "" if lost and hopeless else f"refused as rigid: {refusal}"
    turning = 0.5 if isinstance(body, Rope) else 0.7  # of small motions, see sim/substeps/limits.py
    least = trial.frame_dt / (turning * energy.longest_step(body.damping))
    return "" if 0.9 * least <= float(needed[1]) <= 1.2 * least + 1.0 else f"needs {least:.0f} substeps, but: {refusal}"


def obliging(refusal: str, scene: Scene, settings: dict, device: str) -> Simulation | None:
    """Return a simulation with the substeps that a refusal requires; None if it names no number, or too large a one."""
    needed = re.search(r"at least (\d+) ", refusal)
    if needed is None or int(needed[1]) > MOST_SUBSTEPS:
        return None
    return Simulation(scene, Settings(**{**settings, "substeps": int(needed[1])}), device)


def keeps_state(sim: Simulation, substeps: int) -> str:
    """Return "" if a running simulation refuses too few substeps as well and keeps its state to the bit."""
    return _stays(sim, "solver.substeps", substeps)


def keeps_soft_state(scene: Scene, settings: dict, device: str) -> str:
    """Return "" if a running simulation of a soft body refuses the stiffness of `scene` and keeps its state."""
    body = scene.objects[BODY]
    if bends_by_angles(body):
        return ""  # bending by angles is there from the start or never
    soft = {"stretch_compliance": 1.0} | ({"shear_compliance": 1.0} if isinstance(body, Cloth) else {})
    if getattr(body, "bend_compliance", None):
        soft["bend_compliance"] = 1e6
    gentle = dataclasses.replace(body, **soft)
    sim = Simulation(Scene({BODY: gentle}), Settings(**{**settings, "substeps": 100}), device)
    return _stays(sim, f"{BODY}.stretch_compliance", body.stretch_compliance)


def _stays(sim: Simulation, name: str, value: float) -> str:
    settings, before = sim.settings, [sim.positions(BODY), sim.velocities(BODY), *sim.springs(BODY)["structural"]]
    try:
        sim.set(name, value)
    except ValueError as refusal:
        after = [sim.positions(BODY), sim.velocities(BODY), *sim.springs(BODY)["structural"]]
        same = all(np.array_equal(a, b) for a, b in zip(before, after, strict=True)) and sim.settings == settings
        return "" if same else f"changed by what was refused: {refusal}"
    return f"{name} {value:g} was not refused in the running simulation"


def _shape(sim: Simulation, trial: Trial, energy: Energy, x: np.ndarray) -> tuple[str, float]:
    """Return what is wrong with the final shape or "", and `fold` of the verdict.

    Springs may be strained by trial.rest RMS more than after a good start: the same time from the rest shape, with the
    same settings, driven as at the trial's end. Nothing keeps a sheet from passing through itself. A fold in which its
    springs are in equilibrium is thus one of its shapes at rest, and the strain of that fold is allowed as well.
    """
    sim.reset()
    for _ in range(trial.frames):
        trial.drive(sim, trial.frames - 1)
        sim.step()
    good = energy.strain(sim.positions(BODY).astype(np.float64))
    strain, allowed = energy.strain(x), trial.rest + good
    if strain <= allowed:
        return "", 0.0
    fold = energy.fold(x)
    if strain <= allowed + fold:
        return "", fold
    return f"strain {strain:.3g}, from a good start {good:.3g}, in its fold {fold:.3g}", 0.0


def watch(sim: Simulation, trial: Trial) -> Verdict:
    """Run a trial and report the first promise that it breaks."""
    trial.begin(sim)
    energy = Energy(sim)
    x, v = (read(BODY).astype(np.float64) for read in (sim.positions, sim.velocities))
    stored, height = energy.at_start(x, v)
    fallen, work, momentum = 0.0, 0.0, energy.momentum(v)
    for frame in range(trial.frames):
        trial.drive(sim, frame)
        sim.step()
        x, v = (read(BODY).astype(np.float64) for read in (sim.positions, sim.velocities))
        when = f"after {(frame + 1) * trial.frame_dt:.2f} s"
        if not (np.isfinite(x).all() and np.isfinite(v).all()):
            return Verdict("failed", f"not finite {when}")
        speed = float(np.linalg.norm(v, axis=1).max())
        h = substep_of(sim)
        fastest = WHIP * trial.jump / h if trial.jump else trial.fastest
        if speed > fastest:
            return Verdict("failed", f"a particle at {speed:.4g} m/s {when}, allowed {fastest:g}")
        fallen = max(fallen, height - energy.height(x))
        if trial.velocity is not None:
            work += trial.velocity(frame) * float(energy.momentum(v) - momentum)
            momentum = energy.momentum(v)
        limit = stored + height + work + trial.slack * max(stored, energy.scale(), fallen, work, LEAST)
        if trial.conserves and sum(energy.of(x, v)) > limit:
            found = sum(energy.of(x, v, sim.report()[BODY]["residual"]))
            if found > limit:
                return Verdict("failed", f"energy {found:.4g} J {when}, allowed {limit:.4g}")
        if trial.outside and (depth := sim.report()[BODY]["particle_penetration"]) > DEEPEST:
            return Verdict("failed", f"{depth:.3g} m deep in a collider {when}")
    report = sim.report()[BODY]
    if report["recoveries"]:
        return Verdict("failed", f"put back {report['recoveries']} times")
    wrong, fold = _shape(sim, trial, energy, x) if math.isfinite(trial.rest) else ("", 0.0)
    wrong = wrong or trial.finally_(sim)
    return Verdict("failed", wrong) if wrong else Verdict("held", residual=report["residual"], fold=fold)
