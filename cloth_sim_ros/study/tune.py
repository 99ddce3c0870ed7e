# SPDX-License-Identifier: Apache-2.0
"""`tune`: the cheapest settings with which the user's own scene keeps a wanted error.

The scene runs from its start; colliders stay where the file puts them unless --move moves them. The reference is the
product itself at ever more substeps and iterations, until two such runs agree.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import sys
from pathlib import Path

import numpy as np

from cloth_sim_ros.sim import Settings
from cloth_sim_ros.status_line import show
from cloth_sim_ros.study.convergence import Converged, Trial, converge, frames_of
from cloth_sim_ros.study.error import finite, mark_front, table
from cloth_sim_ros.study.figures import draw_error
from cloth_sim_ros.study.norms import rms
from cloth_sim_ros.study.scene_file import read_plan, with_values
from cloth_sim_ros.study.timing import machine

METHODS = {  # label -> the settings that make it
    "XPBD, first order": {"method": "xpbd", "order": 1},
    "XPBD, second order": {"method": "xpbd", "order": 2},
    "Verlet": {"method": "verlet", "order": 1},
}
TUNED = ("method", "order", "substeps", "iterations")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `python -m cloth_sim_ros.study tune`."""
    parser.add_argument("scene", type=Path, help="the node's YAML file")
    parser.add_argument(
        "--error", type=float, default=1e-2, help="wanted error, relative to the motion, as solver.error"
    )
    parser.add_argument("--budget-ms", type=float, help="most milliseconds a frame")
    parser.add_argument("--seconds", type=float, default=1.0, help="simulated time to compare over [s]")
    parser.add_argument("--move", nargs=4, action="append", default=[], metavar=("COLLIDER", "X", "Y", "Z"))
    parser.add_argument("--device", help="cpu, cuda:0 or auto; else the file's")
    parser.add_argument("--substeps", type=int, nargs="+", default=[2, 5, 10, 20, 40, 80, 160])
    parser.add_argument("--iterations", type=int, nargs="+", default=[1, 2, 4, 8])
    parser.add_argument("--sweeps", type=int, default=320, help="most substeps x iterations a frame")
    parser.add_argument("--output", type=Path, default=Path("study"), help="folder of the YAML, JSON, PNG and SVG")


def run(arguments: argparse.Namespace) -> int:
    """Measure, print, draw, write the chosen settings and measure them again; return 1 if none keeps the budget."""
    trial = trial_of(arguments)
    plan = trial.plan
    print(f"looking for the converged motion of {arguments.scene}", file=sys.stderr, flush=True)
    exact = converge(trial, arguments.error)
    rows = sweep(trial, exact, arguments)
    own = measure("this file", trial, plan.settings, exact)
    where = machine(plan.device if plan.device != "auto" else None)
    span = (exact.trusted - 1) * plan.settings.frame_dt
    title = f"{arguments.scene.name}, {span:.3g} s, RMS motion {exact.moved:.2g} m; {where['name']} ({where['device']})"
    print(title, verdict_of(exact, arguments.error), table([row for row in rows if row["front"]]), sep="\n")
    chosen = choose(rows, arguments.error, arguments.budget_ms)
    stem = arguments.output / f"tuned_{arguments.scene.stem}"
    arguments.output.mkdir(parents=True, exist_ok=True)
    draw_error(rows, title, stem, arguments.error * exact.scale, arguments.budget_ms)
    stored = {"title": title, "machine": where, "uncertainty": exact.uncertainty, "chosen": chosen, "own": finite(own)}
    stem.with_suffix(".json").write_text(json.dumps({**stored, "rows": [finite(row) for row in rows]}, indent=1))
    print(f"the file's own settings: {_words(own)}")
    if chosen is None:
        print(f"nothing is within {arguments.budget_ms:g} ms a frame; no settings are written")
        return 1
    path = stem.with_suffix(".yaml")
    path.write_text(with_values(arguments.scene, {f"solver.{key}": chosen["settings"][key] for key in TUNED}))
    again = measure("chosen", trial, read_plan(path).settings, exact)
    kept = "meets" if again["relative"] <= arguments.error else "does not meet"
    print(f"chosen: {chosen['method']}, {_words(chosen)}")
    print(f"run again from {path}: {_words(again)}, which {kept} {arguments.error:g}")
    return 0


def trial_of(arguments: argparse.Namespace) -> Trial:
    """Return the trial to run. Raises ValueError for a file or a move that is not allowed."""
    plan = read_plan(arguments.scene)
    if arguments.device:
        plan = dataclasses.replace(plan, device=arguments.device)
    moves = {}
    for name, *vector in arguments.move:
        if name not in plan.scene.colliders:
            raise ValueError(f"--move names {name!r}; allowed is one of {', '.join(plan.scene.colliders) or 'none'}")
        moves[name] = np.array([float(number) for number in vector])
    return Trial(plan, max(1, round(arguments.seconds / plan.settings.frame_dt)), moves)


def sweep(trial: Trial, exact: Converged, arguments: argparse.Namespace) -> list[dict]:
    """Return one row for every method, number of substeps and number of iterations that the scene allows."""
    rows = []
    for label, method in METHODS.items():
        for iterations in arguments.iterations if method["method"] != "verlet" else [1]:
            for substeps in arguments.substeps:
                if substeps * iterations > arguments.sweeps:
                    continue
                show(f"{label}: {substeps} x {iterations}")
                steps = {"substeps": substeps, "iterations": iterations}
                try:
                    rows.append(
                        measure(label, trial, dataclasses.replace(trial.plan.settings, **method, **steps), exact)
                    )
                except ValueError:
                    if label != "Verlet":
                        raise
    show("")
    mark_front(rows)
    return rows


def measure(label: str, trial: Trial, settings: Settings, exact: Converged) -> dict:
    """Return the row of one run: its error and time."""
    frames, times = frames_of(trial, settings, exact.trusted - 1)
    error = rms(frames[1:] - exact.frames[1 : exact.trusted]) if np.isfinite(frames).all() else float("inf")
    return {
        "method": label,
        "device": trial.plan.device,
        "settings": dataclasses.asdict(settings),
        "substeps": settings.substeps,
        "iterations": settings.iterations,
        "ms": float(np.median(times)),
        "ms_p95": float(np.percentile(times, 95)),
        "position": error,
        "relative": error / exact.scale,
    }


def choose(rows: list[dict], error: float, budget: float | None) -> dict | None:
    """Return the cheapest row that keeps the relative error, else the most exact one.

    With a budget [ms], only rows within it count.
    """
    rows = [row for row in rows if np.isfinite(row["relative"]) and (budget is None or row["ms"] <= budget)]
    good = [row for row in rows if row["relative"] <= error]
    if good:
        return min(good, key=lambda row: row["ms"])
    return min(rows, key=lambda row: row["relative"], default=None)


def verdict_of(exact: Converged, error: float) -> str:
    """Return a sentence on how well the converged run is known."""
    steps = f"{exact.substeps} substeps x {exact.iterations} iterations of order {exact.order}"
    known, apart = exact.uncertainty / exact.scale, exact.apart / exact.scale
    text = f"converged to {known:.1e} of {exact.scale:.2g} m at {steps}"
    if exact.scale != exact.moved:
        text += "; nearly nothing moves, so errors are shares of a tenth of the largest object"
    if known > 0.2 * error:
        text += f"; that is too near the wanted {error:g} to tell settings apart reliably"
    if apart > error:
        text += f"; there the two orders are {apart:.1e} apart, as where contacts keep them from converging"
    if exact.chaotic:
        text += f"; compared over {exact.trusted - 1} frames only: beyond them the motion is chaotic"
    return text


def _words(row: dict) -> str:
    substeps = f"{row['substeps']} substeps" if row["substeps"] else "substeps as its error asks"
    error = f"an error of {row['relative']:.2e}, {row['position']:.2e} m"
    return f"{substeps} x {row['iterations'] or 1} iterations, {error}, {row['ms']:.3f} ms a frame"
