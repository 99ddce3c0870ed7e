# SPDX-License-Identifier: Apache-2.0
"""What it costs to keep a sheet apart from itself, while it crumples and while it touches nothing."""

from __future__ import annotations

import argparse

import numpy as np

from cloth_sim_ros.sim import Cloth, Plane, Scene, Settings, Simulation
from cloth_sim_ros.study.timing import frame_times

BODY = "sheet"
_COUNT_EVERY = 4  # frames between two counts of crossings


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of the command."""
    parser.add_argument("--resolution", type=int, nargs="+", default=[32, 64], help="particles a side")
    parser.add_argument("--substeps", type=int, default=0, help="a frame; 0 takes the default of each sheet")
    parser.add_argument("--seconds", type=float, default=2.0, help="that are simulated")
    parser.add_argument("--device", default="cpu")


def run(arguments: argparse.Namespace) -> int:
    """Print a row a scene and resolution; returns the exit status."""
    heads = ("substeps", "median", "95 %", "most", "at rest", "without", "crossings")
    print(f"{'ms a frame':<32}" + "".join(f"{head:>11}" for head in heads))
    for resolution in arguments.resolution:
        for name, start in (("falls on its edge", falling), ("hangs by two corners", hanging)):
            sim = start(resolution, True, arguments.substeps, arguments.device)
            substeps = sim.choices[BODY].substeps
            times, crossings = _timed(sim, arguments.seconds)
            without, _ = _timed(start(resolution, False, substeps, arguments.device), arguments.seconds)
            rest = np.median(times[-len(times) // 6 :])
            figures = (np.median(times), np.percentile(times, 95), times.max(), rest, np.median(without))
            row = f"{f'{resolution} x {resolution} {name}':<32}{substeps:>11}"
            print(row + "".join(f"{figure:>11.2f}" for figure in figures) + f"{crossings:>11}", flush=True)
    return 0


def falling(resolution: int, itself: bool, substeps: int, device: str) -> Simulation:
    """A square sheet of 1 m, 2 mm thick, that stands hardly bent on its edge 2 cm above the floor."""
    sheet = Cloth(
        resolution=(resolution, resolution),
        pins="none",
        orientation=(np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)),
        position=(0.0, 0.0, 0.52),
        thickness=0.002,
        self_contact=itself,
    )
    sim = Simulation(Scene({BODY: sheet}, {"floor": Plane()}), _settings(substeps), device)
    x = sim.positions(BODY)
    x[:, 1] += 1e-3 * np.sin(7.0 * x[:, 0]) * np.cos(5.0 * x[:, 2])
    sim.set_positions(BODY, x)
    return sim


def hanging(resolution: int, itself: bool, substeps: int, device: str) -> Simulation:
    """A square sheet of 1 m that is let go flat and swings down on two of its corners."""
    sheet = Cloth(resolution=(resolution, resolution), self_contact=itself)
    return Simulation(Scene({BODY: sheet}), _settings(substeps), device)


def _settings(substeps: int) -> Settings:
    return Settings(method="xpbd", substeps=substeps)


def _timed(sim: Simulation, seconds: float) -> tuple[np.ndarray, int]:
    """Milliseconds of each frame, and the most crossings that were counted."""
    frames, most = 0, 0

    def count() -> None:
        nonlocal frames, most
        frames += 1
        if frames % _COUNT_EVERY == 0:
            most = max(most, sim.report()[BODY].get("crossings", 0))

    sim.step()  # compiles and captures
    times = frame_times(sim, round(60 * seconds), count)
    return times, most
