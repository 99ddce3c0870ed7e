# SPDX-License-Identifier: Apache-2.0
"""`stability`: every hard case on every body by every method, and the promises that each run kept."""

from __future__ import annotations

import argparse
import dataclasses
import json
import sys
import time
from pathlib import Path

import numpy as np

from cloth_sim_ros.status_line import show
from cloth_sim_ros.study import pass_map, throws
from cloth_sim_ros.study.hard import long_rest
from cloth_sim_ros.study.hard.cases import CASES
from cloth_sim_ros.study.hard.judge import METHODS, Combination, Verdict, combinations
from cloth_sim_ros.study.hard.runs import grouped, run_all
from cloth_sim_ros.study.timing import machine

OUTCOMES = ("held", "refused", "failed")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `python -m cloth_sim_ros.study stability`."""
    parser.add_argument("--device", default="auto", help="cpu, cuda:0 or auto")
    parser.add_argument("--seed", type=int, help="of all that is drawn; another one every time if not given")
    parser.add_argument("--case", choices=CASES, nargs="+", help="these alone")
    parser.add_argument("--method", choices=METHODS, nargs="+", help="these alone")
    parser.add_argument("--part", default="1/1", help="2/3: of all combinations the second third, by every third one")
    parser.add_argument("--jobs", type=int, default=1, help="processes that share the work")
    parser.add_argument(
        "--map", action="store_true", help="the map over stiffness and mass ratio in place of the cases"
    )
    parser.add_argument("--peers", action="store_true", help="in the map also Newton and pyPBD, if installed")
    parser.add_argument("--throws", type=int, metavar="N", help="N things thrown at sheets in place of the cases")
    parser.add_argument("--first", type=int, default=0, help="number of the first throw, to repeat one of a seed")
    parser.add_argument("--long", action="store_true", help="ten minutes of rest in place of the cases")
    parser.add_argument("--output", type=Path, default=Path("study"), help="folder of what is written")


def run(arguments: argparse.Namespace) -> int:
    """Run and print; return 1 if anything failed."""
    if arguments.long:
        return long_rest.run(arguments.device)
    if arguments.map:
        return pass_map.run(arguments.device, arguments.peers, arguments.output, arguments.jobs)
    seed = arguments.seed if arguments.seed is not None else int(np.random.SeedSequence().entropy % 2**31)
    if arguments.throws:
        return throws.run(arguments.throws, arguments.first, seed, arguments.device)
    part, parts = map(int, arguments.part.split("/"))
    every = list(combinations(seed, arguments.case, arguments.method))[part - 1 :: parts]
    start = time.perf_counter()
    groups = grouped(every)
    print(
        f"part {part} of {parts}: {len(every)} combinations that need {len(groups)} sets of kernels, seed {seed}",
        flush=True,
    )
    counts = dict.fromkeys(OUTCOMES, 0)

    def done(combination: Combination, verdict: Verdict) -> None:
        if verdict.outcome == "failed":
            show("")  # so that the line after it stands alone
            print(f"FAILED {combination}: {verdict.why}", file=sys.stderr, flush=True)
        counts[verdict.outcome] += 1
        known = sum(counts.values())
        show(f"{known} of {len(every)}, {time.perf_counter() - start:.0f} s: {combination}"[:150])
        if known % 100 == 0:
            numbers = ", ".join(f"{counts[outcome]} {outcome}" for outcome in OUTCOMES)
            print(f"{time.perf_counter() - start:5.0f} s  {known} of {len(every)}: {numbers}", flush=True)

    found = run_all(groups, arguments.device, arguments.jobs, done)
    show("")
    where = machine(arguments.device if arguments.device != "auto" else None)
    rows = [{**dataclasses.asdict(each), **dataclasses.asdict(found[k])} for k, each in enumerate(every)]
    for k, each in enumerate(every):
        if found[k].outcome == "failed":
            print(f"FAILED {each}: {found[k].why}")
    print(f"{where['name']} ({where['device']}), {time.perf_counter() - start:.0f} s")
    print(summary(rows))
    print(table(rows))
    path = arguments.output / f"stability_{where['device'].replace(':', '')}.json"
    path.parent.mkdir(parents=True, exist_ok=True)
    for row in rows:
        row["residual"] = row["residual"] if np.isfinite(row["residual"]) else None
    path.write_text(json.dumps({"machine": where, "seed": seed, "rows": rows}, indent=1))
    print(f"written: {path}")
    return int(any(row["outcome"] == "failed" for row in rows))


def summary(rows: list[dict]) -> str:
    """Return the numbers of combinations that ran, held, were refused and failed, with a remark on them."""
    held, refused, failed = ([row for row in rows if row["outcome"] == outcome] for outcome in OUTCOMES)
    asked = sum(row["substeps"] > row["options"]["substeps"] for row in held)
    folds = sum(row["fold"] > 0.0 for row in held)
    most = max((row["substeps"] for row in held), default=0)
    return (
        f"{len(rows)} combinations: {len(held) + len(failed)} ran, of which {len(held)} held and {len(failed)} failed; "
        f"{len(refused)} refused as is guaranteed, none skipped\n"
        f"of those that held {asked} had first refused too few substeps and then ran with what they asked for (up to "
        f"{most}), {folds} came to lie in folds in which their springs are in equilibrium"
    )


def table(rows: list[dict]) -> str:
    """Return the numbers of combinations that held, were refused as guaranteed, and failed, by case and method."""
    methods = [method for method in METHODS if any(row["method"] == method for row in rows)]
    lines = [f"{'':<20}" + "".join(f"{method:>24}" for method in methods)]
    lines.append(f"{'held / refused / failed':<20}")
    for name in [*CASES, "all"]:
        of_case = [row for row in rows if name in (row["case"], "all")]
        if not of_case:
            continue
        cells = [_cell([row for row in of_case if row["method"] == method]) for method in methods]
        words = CASES[name].text if name in CASES else ""
        lines.append((f"{name:<20}" + "".join(f"{cell:>24}" for cell in cells) + f"   {words}").rstrip())
    return "\n".join(lines)


def _cell(rows: list[dict]) -> str:
    return " / ".join(str(sum(row["outcome"] == outcome for row in rows)) for outcome in OUTCOMES)
