# SPDX-License-Identifier: Apache-2.0
"""`error`: the error of each method against the exact motion of a case at every setting, and its cost."""

from __future__ import annotations

import argparse
import dataclasses
import json
import math
import sys
from pathlib import Path

import numpy as np
import warp as wp

from cloth_sim_ros.status_line import show
from cloth_sim_ros.study import elongation, norms
from cloth_sim_ros.study.case import Case
from cloth_sim_ros.study.cases import CASES
from cloth_sim_ros.study.contenders import CONTENDERS, Contender, Run
from cloth_sim_ros.study.exact import Reference, reference
from cloth_sim_ros.study.figures import draw_error, usable
from cloth_sim_ros.study.other_models import OTHER_MODELS, Limit, limit
from cloth_sim_ros.study.peers import PEERS
from cloth_sim_ros.study.timing import machine

# Columns that only comparisons with the exact motion of the same springs have.
EXACT = (("relative", "relative"), ("strain_rms", "strain"), ("strain_max", "max"))

# Errors that prices are told for, in metres and as shares of the motion.
LEVELS = {"position": (1e-2, 1e-3, 1e-4, 1e-5), "relative": (1e-1, 1e-2, 1e-3, 1e-4)}
UNITS = {"position": "m", "relative": "of the motion"}

# In so many rounds the product's runs that prices name, or would if they took so much less, are timed again.
ROUNDS = 5
CLOSE = 2.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `python -m cloth_sim_ros.study error`."""
    parser.add_argument("--case", choices=[*CASES, "all", "elongation"], default="clamped_sheet")
    parser.add_argument("--resolution", type=int, help="particles along a side, segments of a chain")
    parser.add_argument("--constant", type=float, help="spring constant [N/m]")
    parser.add_argument("--seconds", type=float, help="how long to compare [s]; else as long as the case")
    parser.add_argument("--device", default="auto", help="cpu, cuda:0 or auto")
    parser.add_argument("--substeps", type=int, nargs="+", default=[1, 2, 3, 4, 5, 10, 20, 40, 80, 160, 320, 640])
    parser.add_argument("--iterations", type=int, nargs="+", default=[1, 2, 4, 8])
    parser.add_argument("--sweeps", type=int, default=640, help="most substeps x iterations a frame")
    parser.add_argument("--numpy-sweeps", type=int, default=320, help="the same for the methods in NumPy; 0: none")
    parser.add_argument("--peers", action="store_true", help="also Newton, pyPBD and MuJoCo's flex, if installed")
    parser.add_argument("--worlds", type=int, default=1, help="copies at once; times are of all of them")
    parser.add_argument("--output", type=Path, default=Path("study"), help="folder of the JSON, PNG and SVG")


def run(arguments: argparse.Namespace) -> int:
    """Sweep, print the tables, write JSON and figures."""
    if arguments.case == "elongation":
        return elongation.run(arguments)
    arguments.output.mkdir(parents=True, exist_ok=True)
    arguments.contenders = (*CONTENDERS, *(peers_on(arguments.device, arguments.worlds) if arguments.peers else ()))
    for case in CASES.values() if arguments.case == "all" else [CASES[arguments.case]]:
        judge(case if arguments.seconds is None else case.lasting(arguments.seconds), arguments)
    return 0


def peers_on(device: str, worlds: int = 1) -> list[Contender]:
    """Return the peers that can run so many copies on `device`; print to standard error why the others cannot."""
    chosen = wp.get_device(None if device == "auto" else device).alias
    found = []
    for peer in (*PEERS, *OTHER_MODELS):
        problem = peer.why_not(chosen, worlds)
        if problem:
            print(problem, file=sys.stderr)
        else:
            iterations = () if peer.iterates else (1,)
            found.append(Contender(peer.label, peer.simulate, iterations, own_limit=peer in OTHER_MODELS))
    return found


def judge(case: Case, arguments: argparse.Namespace) -> None:
    """Sweep one case; write its table, JSON and figures."""
    resolution, constant = arguments.resolution or case.resolution, arguments.constant or case.constant
    title = case.title(resolution, constant) + f", {arguments.worlds} worlds" * (arguments.worlds > 1)
    print(f"computing the exact motion of: {title}", file=sys.stderr, flush=True)
    exact = reference(case, resolution, constant)
    rows = sweep(case, exact, resolution, constant, arguments)
    where = machine(arguments.device if arguments.device != "auto" else None)
    print(f"{title}; {where['name']} ({where['device']})")
    if exact.trusted <= case.frames:
        print(f"compared up to frame {exact.trusted - 1} of {case.frames}: beyond it the motion is chaotic")
    print(table(rows), "cheapest for an error of", prices(rows), sep="\n")
    size = f"{resolution}" + f"x{arguments.worlds}" * (arguments.worlds > 1)
    path = arguments.output / f"error_{case.name}_{size}_{where['device'].replace(':', '')}"
    stored = {"title": title, "machine": where, "trusted_frames": exact.trusted, "rows": [finite(row) for row in rows]}
    path.with_suffix(".json").write_text(json.dumps(stored, indent=1))
    draw_error(rows, f"{title}\n{where['name']}", path)
    print(f"written: {path}.json, .png, .svg\n", flush=True)


def sweep(case: Case, exact: Reference, resolution: int, constant: float, arguments: argparse.Namespace) -> list[dict]:
    """Return one row for every contender, number of substeps and number of iterations."""
    rows, again = [], []
    for contender in arguments.contenders:
        if not contender.takes(case, arguments.worlds):
            continue
        own = own_limit(contender, case, resolution, constant, arguments) if contender.own_limit else None
        for iterations in contender.iterations or arguments.iterations:
            for substeps in arguments.substeps:
                if substeps * iterations > (arguments.numpy_sweeps if contender.numpy else arguments.sweeps):
                    continue
                show(f"{contender.label}: {substeps} x {iterations}")
                numbers = (substeps, iterations, arguments.worlds)
                wanted = Run(case, resolution, constant, arguments.device, *numbers)
                if own is None:
                    rows.append(measure(contender, wanted, exact))
                    if contender in CONTENDERS and not contender.numpy:
                        again.append((rows[-1], contender, wanted))
                elif own.judges(substeps, iterations):
                    judge_by = dataclasses.replace(exact, frames=own.frames)
                    told = {"limit": f"{own.substeps} x {own.iterations}", "limit_known": own.known}
                    rows.append({**measure(contender, wanted, judge_by), **told})
    time_in_turns(again)
    show("")
    mark_front(rows)
    return rows


def time_in_turns(runs: list[tuple[dict, Contender, Run]]) -> None:
    """Time the runs in `close_to_prices` again in rounds, one after another; set each to its fastest time.

    Single timings minutes apart would compare other loads of the machine.
    """
    for left in range(ROUNDS, 0, -1):
        show(f"timing in turns: {left}")
        close = {id(row) for row in close_to_prices([row for row, _, _ in runs])}
        for row, contender, wanted in runs:
            if id(row) in close:
                ms, p95 = quantiles(contender.simulate(wanted)[1])
                if ms < row["ms"]:
                    row["ms"], row["ms_p95"] = ms, p95


def quantiles(times: np.ndarray) -> tuple[float, float]:
    """Return the median and the 95th percentile."""
    return float(np.median(times)), float(np.percentile(times, 95))


def own_limit(
    contender: Contender, case: Case, resolution: int, constant: float, arguments: argparse.Namespace
) -> Limit:
    """Return the converged motion of a contender of another model, with the most of its iterations."""
    print(f"computing what it converges to: {contender.label}", file=sys.stderr, flush=True)
    iterations = max(contender.iterations or arguments.iterations)
    return limit(
        contender.simulate,
        Run(case, resolution, constant, arguments.device, 1, iterations, arguments.worlds),
        arguments.sweeps,
    )


def measure(contender: Contender, wanted: Run, exact: Reference) -> dict:
    """Return the row of one run: its error and time."""
    frames, times = contender.simulate(wanted)
    ms, p95 = quantiles(times)
    found = norms.error(exact.system, frames[: exact.trusted], exact.frames[: exact.trusted])
    return {
        "case": wanted.case.name,
        "resolution": wanted.resolution,
        "constant": wanted.constant,
        "device": "numpy" if contender.numpy else wanted.device,
        "method": contender.label,
        "substeps": wanted.substeps,
        "iterations": wanted.iterations,
        "ms": ms,
        "ms_p95": p95,
        **dataclasses.asdict(found),
    }


def mark_front(rows: list[dict]) -> None:
    """Set "front" in every row: True if the run is usable and no other is at least as fast and more exact."""
    for row in rows:
        row["front"] = usable(row) and not any(
            other["ms"] <= row["ms"] and other["position"] < row["position"] for other in rows if other is not row
        )


def table(rows: list[dict]) -> str:
    """Return the rows by time; a star marks the Pareto front."""
    lines = [
        f"  {'method':<31} {'substeps':>8} {'iterations':>10} {'ms':>9} {'p95':>9} {'error [m]':>10}"
        + "".join(f" {heading:>9}" for key, heading in EXACT if key in rows[0])
    ]
    for row in sorted(filter(usable, rows), key=lambda row: row["ms"]):
        lines.append(
            f"{'*' if row['front'] else ' '} {row['method']:<31} {row['substeps']:>8} {row['iterations']:>10}"
            f" {row['ms']:>9.3f} {row['ms_p95']:>9.3f} {row['position']:>10.2e}"
            + "".join(f" {row[key]:>9.2e}" for key, _ in EXACT if key in row)
        )
    for row in {row["method"]: row for row in rows if "limit" in row}.values():
        lines.append(
            f"  {row['method']}: another model than springs, judged by its own run of {row['limit']}, which is"
            f" {row['limit_known']:.1e} m from the next coarser one"
        )
    lost = [row for row in rows if not usable(row)]
    if lost:
        lines.append(f"  {len(lost)} runs blew up, were refused as unstable or miss by more than the motion itself:")
    for method in dict.fromkeys(row["method"] for row in lost):
        which = ", ".join(f"{row['substeps']} x {row['iterations']}" for row in lost if row["method"] == method)
        lines.append(f"    {method}: {which}")
    return "\n".join(lines)


def good_enough(rows: list[dict], kind: str, level: float) -> list[dict]:
    """Return the runs whose error of a kind of LEVELS is at most `level`, the cheapest first."""
    good = [row for row in rows if usable(row) and row[kind] <= level]
    return sorted(good, key=lambda row: row["ms"])


def cheapest(rows: list[dict]) -> dict[str, dict]:
    """Return method -> the first of its rows."""
    best: dict[str, dict] = {}
    for row in rows:
        best.setdefault(row["method"], row)
    return best


def close_to_prices(rows: list[dict]) -> list[dict]:
    """Return the runs that `prices` names, and those of the same method that take no more than CLOSE times as long."""
    found = []
    for kind, levels in LEVELS.items():
        for level in levels:
            good = good_enough(rows, kind, level)
            best = cheapest(good)
            found += [row for row in good if row["ms"] <= CLOSE * best[row["method"]]["ms"]]
    return found


def prices(rows: list[dict]) -> str:
    """Return, for each level of error, the cheapest run that keeps it, and the cheapest of every other method."""
    lines = []
    for kind, levels in LEVELS.items():
        for level in levels:
            best = [
                f"{row['method']} {row['substeps']} x {row['iterations']}: {row['ms']:.3g} ms"
                for row in cheapest(good_enough(rows, kind, level)).values()
            ]
            lines.append(f"  {level:.0e} {UNITS[kind]}  " + ("; ".join(best) or "no run"))
    return "\n".join(lines)


def finite(row: dict) -> dict:
    """Return `row` for JSON, which has no infinity."""
    return {key: None if isinstance(value, float) and not math.isfinite(value) else value for key, value in row.items()}
