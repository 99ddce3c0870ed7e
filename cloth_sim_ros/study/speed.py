# SPDX-License-Identifier: Apache-2.0
"""`speed`: a frame of a hung cloth, by xpbd of second order.

--peers adds the same springs at the same substeps in Newton and pyPBD, and MuJoCo's flex of the same size, in the same
run. --features adds what each feature of a scene costs.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import sys
import time
from pathlib import Path

import numpy as np

from cloth_sim_ros.sim import Cloth, Scene, Settings, Simulation
from cloth_sim_ros.study import feature_costs
from cloth_sim_ros.study.cases import Case
from cloth_sim_ros.study.contenders import Run
from cloth_sim_ros.study.figures import draw_speed
from cloth_sim_ros.study.peers import PEERS, flex_times
from cloth_sim_ros.study.timing import frame_time, machine, quartiles


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command line of `python -m cloth_sim_ros.study speed`."""
    parser.add_argument("--device", default="auto", help="cpu, cuda:0 or auto")
    parser.add_argument("--resolution", type=int, nargs="+", default=[16, 32, 64], help="particles along each side")
    parser.add_argument("--substeps", type=int, default=20)
    parser.add_argument("--iterations", type=int, default=1)
    parser.add_argument("--rounds", type=int, default=9, help="turns that are measured")
    parser.add_argument("--seconds", type=float, default=0.25, help="length of a turn [s]")
    parser.add_argument("--peers", action="store_true", help="also Newton, pyPBD and MuJoCo, if installed")
    parser.add_argument("--worlds", type=int, default=1, help="copies of the cloth in the same launches")
    parser.add_argument("--features", action="store_true", help="also what each feature costs, at the last resolution")
    parser.add_argument("--figure", type=Path, metavar="FILE", help="draw the times against the particles")
    parser.add_argument("--json", metavar="FILE", help="write the numbers to FILE")


def run(arguments: argparse.Namespace) -> int:
    """Measure, print the table, write the JSON."""
    rows = []
    for resolution in arguments.resolution:
        print(f"measuring {resolution} x {resolution} ...", file=sys.stderr, flush=True)
        rows.append(measure(resolution, arguments))
    where = machine(rows[0]["device"])
    worlds = f", {arguments.worlds} worlds" if arguments.worlds > 1 else ""
    steps = f"{arguments.substeps} substeps x {arguments.iterations} iterations"
    print(f"{where['name']} ({where['device']}), {steps}{worlds}")
    print(table(rows))
    compared = compare(rows, arguments) if arguments.peers else []
    if compared:
        print(peer_table(compared))
    features = []
    if arguments.features:
        cloth = hanging_cloth(arguments.resolution[-1])
        frames = max(5, int(1e3 * arguments.seconds / rows[-1]["ms"]["median"]))
        features = feature_costs.measure(cloth, rows[-1]["device"], arguments.substeps, arguments.rounds, frames)
        print(feature_costs.table(features))
    if arguments.figure:
        draw_speed(rows, compared, f"{where['name']}, {steps}{worlds}", arguments.figure)
    if arguments.json:
        with open(arguments.json, "w") as file:
            json.dump({"machine": where, "rows": rows, "peers": compared, "features": features}, file, indent=1)
    return 0


def hanging_cloth(resolution: int, constant: float = 1e3) -> Cloth:
    """A cloth of 1 m with all springs: stretch, shear and bending, hung by two corners."""
    return Cloth(
        resolution=(resolution, resolution),
        orientation=(np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)),
        pins=(resolution * (resolution - 1), resolution * resolution - 1),
        stretch_compliance=1.0 / constant,
        shear_compliance=3.0 / constant,
        bending="springs",
        bend_compliance=10.0 / constant,
    )


HANGING = Case("hanging_cloth", "cloth hung by two corners", hanging_cloth, 12, 1e-3, 32, 1e3)


def compare(rows: list[dict], arguments: argparse.Namespace) -> list[dict]:
    """Peers at the sizes of `rows`: their ms per frame, and how often the product's frame goes into theirs."""
    found = []
    for row in rows:
        ours = row["ms"]["median"]

        def add(label: str, times: np.ndarray, row: dict = row, ours: float = ours) -> None:
            numbers = quartiles(times)
            found.append({"resolution": row["resolution"], "peer": label, **numbers, "ratio": numbers["median"] / ours})

        for peer in PEERS:
            problem = peer.why_not(row["device"])
            if problem:
                print(problem, file=sys.stderr)
                continue
            # Vertex block descent is used with several iterations a substep; with one it does not converge.
            iterations = 5 * arguments.iterations if "VBD" in peer.label else arguments.iterations
            print(f"measuring {peer.label} {row['resolution']} ...", file=sys.stderr, flush=True)
            run = Run(HANGING, row["resolution"], HANGING.constant, row["device"], arguments.substeps, iterations)
            add(f"{peer.label} {arguments.substeps}x{iterations}", peer.simulate(run)[1][2:])
        if row["device"] == "cpu" and importlib.util.find_spec("mujoco") is not None:
            add("MuJoCo flex, edge equality", flex_times(row["resolution"], 10))
    return found


def peer_table(rows: list[dict]) -> str:
    """The peers as text: median and quartiles in ms per frame, and the ratio to the product."""
    lines = [f"{'cloth':>9}  {'peer':<28}  {'ms per frame':>26}  {'times ours':>10}"]
    for row in rows:
        size = f"{row['resolution']} x {row['resolution']}"
        spread = f"{row['median']:.2f} ({row['low']:.2f}-{row['high']:.2f}) ms"
        lines.append(f"{size:>9}  {row['peer']:<28}  {spread:>26}  {row['ratio']:>10.1f}")
    return "\n".join(lines)


def measure(resolution: int, arguments: argparse.Namespace) -> dict:
    """Median and quartiles over the rounds [ms per frame]."""
    numbers = {"substeps": arguments.substeps, "iterations": arguments.iterations}
    settings = Settings(method="xpbd", order=2, **numbers)
    scene = Scene(objects={"cloth": hanging_cloth(resolution)})
    sim = Simulation(scene, settings, arguments.device, arguments.worlds)
    for _ in range(3):  # compiles, captures
        sim.step()
    frames = max(3, int(1e3 * arguments.seconds / frame_time(sim, 5)))
    times = quartiles([frame_time(sim, frames) for _ in range(arguments.rounds)])
    row = {"resolution": resolution, **numbers, "device": sim.device, "ms": times}
    return row | {"chosen": sim.method, "wall": _wall(sim, frames)}


def _wall(sim: Simulation, frames: int) -> float:
    """Milliseconds per frame of the host's clock, from the first call to the last frame read back."""
    start = time.perf_counter()
    for _ in range(frames):
        sim.step()
    sim.positions("cloth")
    return 1e3 * (time.perf_counter() - start) / frames


def table(rows: list[dict]) -> str:
    """The rows as text: median and quartiles in ms per frame."""

    lines = [f"{'cloth':>9}  {'ms per frame':>24}  {'wall':>9}  chosen"]
    for row in rows:
        size, ms = f"{row['resolution']} x {row['resolution']}", row["ms"]
        spread = f"{ms['median']:.3f} ({ms['low']:.3f}-{ms['high']:.3f}) ms"
        lines.append(f"{size:>9}  {spread:>24}  {row['wall']:.3f} ms  {row['chosen']}")
    return "\n".join(lines)
