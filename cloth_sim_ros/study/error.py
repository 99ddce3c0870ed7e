"""`error`: how far each setting is from the exact motion of a case, and what it costs.

A contender is a row of CONTENDERS: a label and a function from a run's numbers to its frames and times. The product's
own methods are the settings that they differ in; anything else that moves the same particles can stand beside them.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cloth_sim_ros.sim import Settings
from cloth_sim_ros.study import norms
from cloth_sim_ros.study.cases import BODY, CASES, FRAME_DT, Case
from cloth_sim_ros.study.exact import Reference, reference
from cloth_sim_ros.study.figures import draw_error
from cloth_sim_ros.study.timing import frame_times, machine


@dataclass(frozen=True)
class Run:
    """One run to make: of a case at `resolution` with springs of `constant` [N/m] on `device`."""

    case: Case
    resolution: int
    constant: float
    device: str
    substeps: int
    iterations: int


@dataclass(frozen=True)
class Contender:
    """`simulate` a run -> frames (F + 1, N, 3) [m] and milliseconds of every frame; None where it cannot."""

    label: str
    simulate: Callable[[Run], tuple[np.ndarray, np.ndarray]]


def product(**settings: object) -> Callable[[Run], tuple[np.ndarray, np.ndarray]]:
    """The product itself with some of its settings."""

    def simulate(run: Run) -> tuple[np.ndarray, np.ndarray]:
        chosen = Settings(frame_dt=FRAME_DT, substeps=run.substeps, iterations=run.iterations, **settings)
        sim = run.case.simulation(run.resolution, run.constant, chosen, run.device)
        frame_times(sim, 2)  # compiles
        sim.reset()
        frames = [sim.positions(BODY)]
        times = frame_times(sim, run.case.frames, after=lambda: frames.append(sim.positions(BODY)))
        return np.array(frames, dtype=np.float64), times

    return simulate


CONTENDERS = (
    Contender("XPBD, first order", product(method="xpbd", order=1)),
    Contender("XPBD, second order", product(method="xpbd", order=2)),
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command line of `python -m cloth_sim_ros.study error`."""
    parser.add_argument("--case", choices=sorted(CASES), default="clamped_sheet")
    parser.add_argument("--resolution", type=int, default=32, help="particles along each side")
    parser.add_argument("--constant", type=float, default=1000.0, help="spring constant [N/m]")
    parser.add_argument("--device", default="auto", help="cpu, cuda:0 or auto")
    parser.add_argument("--substeps", type=int, nargs="+", default=[5, 10, 20, 40, 80, 160, 320])
    parser.add_argument("--iterations", type=int, nargs="+", default=[1, 2, 4, 8])
    parser.add_argument("--sweeps", type=int, default=640, help="most substeps x iterations a frame")
    parser.add_argument("--output", type=Path, default=Path("study"), help="folder of the JSON, PNG and SVG")


def run(arguments: argparse.Namespace) -> int:
    """Sweep, print the table, write JSON and figures."""
    case = CASES[arguments.case]
    title = f"{case.text}, {arguments.resolution} x {arguments.resolution}, {arguments.constant:g} N/m"
    print(f"computing the exact motion of: {title}", file=sys.stderr, flush=True)
    exact = reference(case, arguments.resolution, arguments.constant)
    rows = sweep(case, exact, arguments)
    where = machine(rows[0]["device"])
    print(f"{title}; {where['name']} ({where['device']})")
    if exact.trusted <= case.frames:
        print(f"compared up to frame {exact.trusted - 1} of {case.frames}: beyond it the motion is chaotic")
    print(table(rows))
    arguments.output.mkdir(parents=True, exist_ok=True)
    path = arguments.output / f"error_{case.name}_{arguments.resolution}_{where['device'].replace(':', '')}"
    with open(path.with_suffix(".json"), "w") as file:
        json.dump({"title": title, "machine": where, "trusted_frames": exact.trusted, "rows": rows}, file, indent=1)
    draw_error(rows, f"{title}\n{where['name']}", path)
    print(f"written: {path}.json, .png, .svg")
    return 0


def sweep(case: Case, exact: Reference, arguments: argparse.Namespace) -> list[dict]:
    """One row for every contender, number of substeps and of iterations."""
    rows = []
    for contender in CONTENDERS:
        for iterations in arguments.iterations:
            for substeps in arguments.substeps:
                if substeps * iterations > arguments.sweeps:
                    continue
                print(f"{contender.label}: {substeps} x {iterations}   ", end="\r", file=sys.stderr, flush=True)
                wanted = Run(case, arguments.resolution, arguments.constant, arguments.device, substeps, iterations)
                rows.append(measure(contender, wanted, exact))
    for row in rows:
        row["front"] = not any(
            other["ms"] <= row["ms"] and other["position"] < row["position"] for other in rows if other is not row
        )
    return rows


def measure(contender: Contender, wanted: Run, exact: Reference) -> dict:
    """Error and time of one run."""
    frames, times = contender.simulate(wanted)
    found = norms.error(exact.system, frames[: exact.trusted], exact.frames[: exact.trusted])
    return {
        "case": wanted.case.name,
        "resolution": wanted.resolution,
        "constant": wanted.constant,
        "device": wanted.device,
        "method": contender.label,
        "substeps": wanted.substeps,
        "iterations": wanted.iterations,
        "ms": float(np.median(times)),
        "ms_p95": float(np.percentile(times, 95)),
        **dataclasses.asdict(found),
    }


def table(rows: list[dict]) -> str:
    """The rows by time; a star marks the Pareto front: nothing is both faster and nearer."""
    lines = [
        f"  {'method':<20} {'substeps':>8} {'iterations':>10} {'ms':>9} {'p95':>9} {'error [m]':>10} {'relative':>9}"
        f" {'strain':>9} {'max':>9}"
    ]
    for row in sorted(rows, key=lambda row: row["ms"]):
        lines.append(
            f"{'*' if row['front'] else ' '} {row['method']:<20} {row['substeps']:>8} {row['iterations']:>10}"
            f" {row['ms']:>9.3f} {row['ms_p95']:>9.3f} {row['position']:>10.2e} {row['relative']:>9.2e}"
            f" {row['strain_rms']:>9.2e} {row['strain_max']:>9.2e}"
        )
    return "\n".join(lines)
