# SPDX-License-Identifier: Apache-2.0
"""`scenes --halves`: what the scenes that people have cost at the defaults, in both half seconds of their first second.

The first half second holds the fall or the swing. Substeps and error are what the simulation chose and measured by the
end of each half. The error has the units of `solver.error`.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Mapping

import numpy as np
import warp as wp

from cloth_sim_ros.sim import Scene, Settings, Simulation
from cloth_sim_ros.study.case import BODY
from cloth_sim_ros.study.timing import machine, milliseconds, spread

FRAMES = 30  # of 1/60 s, in each half
ROWS = (  # name in SCENES, resolution, worlds on a GPU
    ("towel", 20, 1), ("towel", 32, 1), ("towel", 64, 1), ("denim", 32, 1), ("silk", 32, 1), ("terry", 32, 1),
    ("apart", 32, 1), ("hands", 32, 1), ("hands", 64, 1), ("table", 32, 1), ("tube", 48, 1), ("cable", 32, 1),
    ("cable", 32, 1024), ("cotton", 64, 1), ("cotton", 128, 1), ("hands", 32, 1024),
)  # fmt: skip
HEAD = "| scene | first half second [ms] | substeps, error | second [ms] | substeps, error |\n|---|---|---|---|---|"


def table(
    scenes: Mapping[str, Callable[[int], Scene]], device: str, rounds: int, rows: Iterable[tuple[str, int, int]] = ROWS
) -> str:
    """Return a table in Markdown. Many worlds have rows on a GPU alone."""
    chosen = wp.get_device(device)
    lines = []
    for name, resolution, worlds in rows:
        if worlds > 1 and not chosen.is_cuda:
            continue
        print(f"measuring {name}, {resolution} x {resolution}, {worlds} worlds ...", file=sys.stderr, flush=True)
        sim = Simulation(scenes[name](resolution), Settings(), device, worlds)
        cells = [f"{spread(ms)} | {substeps}, {error:.1e}" for ms, substeps, error in _halves(sim, rounds)]
        label = f"{name} {resolution} x {resolution}" + f", {worlds} worlds" * (worlds > 1)
        lines.append(f"| {label} | {' | '.join(cells)} |")
    where = machine(device)
    head = f"{where['name']} ({where['device']}); milliseconds a frame, medians of {rounds} rounds, and quartiles\n"
    return "\n".join([head, HEAD, *lines])


def _halves(sim: Simulation, rounds: int) -> list[tuple[np.ndarray, int, float]]:
    """Return milliseconds a frame in each round, substeps and measured error of both half seconds.

    Ten frames first load all kernels and record the graph of ten. Each round begins anew.
    """
    sim.step(10)
    times, told = np.zeros((2, rounds)), [(0, 0.0), (0, 0.0)]
    for number in range(rounds):
        sim.reset()
        wp.synchronize_device(sim.device)
        for half in range(2):
            ms = milliseconds(lambda: [sim.step(10) for _ in range(FRAMES // 10)], wp.get_device(sim.device))
            choice = sim.choices[BODY]
            times[half, number], told[half] = ms / FRAMES, (choice.substeps, choice.error)
    return [(ms, *chosen) for ms, chosen in zip(times, told, strict=True)]
