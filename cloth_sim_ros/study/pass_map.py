# SPDX-License-Identifier: Apache-2.0
"""Map of the runs that hold: a loaded chain over stiffness, mass ratio, substeps and iterations, method by method.

Every method gets the same springs (cases.loaded_chain) and is judged by its positions alone, as peers give no more. To
add a method, add its contender; see `rows`.
"""

from __future__ import annotations

import dataclasses
import json
import multiprocessing
import sys
import time
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path

import numpy as np
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from cloth_sim_ros.study.cases import FRAME_DT, Case, loaded_chain
from cloth_sim_ros.study.contenders import CONTENDERS, Contender, Run
from cloth_sim_ros.study.error import peers_on
from cloth_sim_ros.study.figures import save_png
from cloth_sim_ros.study.hard.runs import quietly
from cloth_sim_ros.study.springs import SpringSystem
from cloth_sim_ros.study.timing import machine

STIFFNESS = (1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, np.inf)  # [N/m] of every spring
NEARLY_RIGID = 1e9  # [N/m] for methods that know no rigid springs
RATIOS = (1.0, 1e1, 1e2, 1e3, 1e4, 1e5)
SUBSTEPS, ITERATIONS = (1, 5, 20, 80), (1, 10)
SEGMENTS, FRAMES = 24, 60
CLASSIC = ("forward Euler (NumPy)", "PBD (NumPy)")
OUTCOMES = {  # outcome -> its colour
    "holds": "#3a9d5d",
    "stretched": "#f0b13c",
    "refused": "#c9ced6",
    "flies apart": "#c8372d",
    "not run": "#ffffff",
}
PEER_SWEEPS = 20  # substeps x iterations a frame that a cell of a peer is worth: Newton would take an hour
SLACK = 0.05  # of the energy: between frames nobody knows it


def rows(peers: bool, device: str) -> list[tuple[Contender, int]]:
    """Return (method, iterations) in the order of the figure: the product's, the classic ones, the peers."""
    own = [each for each in CONTENDERS if not each.numpy]
    classic = [each for each in CONTENDERS if each.label in CLASSIC]
    others = peers_on(device) if peers else []
    every = own + classic + [each for each in others if each.takes(chain(RATIOS[0]))]
    return [(each, iterations) for each in every for iterations in each.iterations or ITERATIONS]


def chain(ratio: float) -> Case:
    """A chain of 1 m and 0.2 kg, let go at 45 degrees with `ratio` times its mass at its end."""
    return Case(f"chain_{ratio:g}", "loaded chain", loaded_chain(ratio), FRAMES, 1e-3, SEGMENTS, 1e3)


def outcome(frames: np.ndarray, system: SpringSystem, seen: float) -> str:
    """Return "refused", "flies apart", "stretched" or "holds" for a run with frames (F + 1, N, 3) [m].

    A run flies apart if it is not finite or gains energy over its start. The energy is the potential one at every
    frame, or the kinetic one of the mean motion between two frames above the lowest potential. Springs stiffer than
    `seen` [N/m] are left out, as they hold little energy. A run is stretched if any strain ever exceeds 0.05 plus four
    times the strain of the load at rest. A swing with a wave in it reaches three times.
    """
    if not np.isfinite(frames).any():
        return "refused"
    if not np.isfinite(frames).all():
        return "flies apart"
    soft = dataclasses.replace(system, constant=np.where(system.constant < seen, system.constant, 0.0))
    still = np.zeros_like(frames[0])
    place = np.array([sum(soft.energy(x, still)[1:]) for x in frames])
    motion = np.array([soft.energy(still, v)[0] for v in np.diff(frames, axis=0) / FRAME_DT])
    limit = SLACK * (np.ptp(place) + 1e-3)
    if place.max() > place[0] + limit or motion.max() > place[0] - place.min() + limit:
        return "flies apart"
    weight = system.masses[1:].sum() * np.linalg.norm(system.gravity)
    allowed = 0.05 + 4.0 * weight / (system.constant * system.rest_length)
    return "stretched" if (system.strains(frames) > allowed).any() else "holds"


def judge(contender: Contender, iterations: int, ratio: float, constant: float, substeps: int, device: str) -> str:
    """Return the outcome of one cell."""
    own = not contender.numpy and contender in CONTENDERS
    if contender not in CONTENDERS and substeps * iterations > PEER_SWEEPS:
        return "not run"
    stiffness = constant if own else min(constant, NEARLY_RIGID)
    if contender.label.startswith("PBD"):
        stiffness = NEARLY_RIGID  # it knows no stiffness: one run tells of all
    frames = _frames(contender, iterations, ratio, stiffness, substeps, device)
    system, _ = chain(ratio).system(SEGMENTS, min(constant, NEARLY_RIGID))
    seen = 0.0 if contender.label.startswith("PBD") else (0.1 / SEGMENTS) * (substeps / FRAME_DT) ** 2
    return outcome(frames, system, seen)


@lru_cache(maxsize=1)
def _frames(
    contender: Contender, iterations: int, ratio: float, constant: float, substeps: int, device: str
) -> np.ndarray:
    found, _ = contender.simulate(Run(chain(ratio), SEGMENTS, constant, device, substeps, iterations))
    return np.asarray(found, dtype=np.float64)


@dataclasses.dataclass(frozen=True)
class Panel:
    """The cells of one method with these substeps and iterations, which a process computes."""

    label: str
    iterations: int
    substeps: int
    peers: bool
    device: str

    @property
    def row(self) -> str:
        """Title of its row of panels."""
        return self.label if self.iterations == 0 else f"{self.label}, {self.iterations} iterations"

    def cells(self) -> list[list[str]]:
        """Return the outcomes by mass ratio and stiffness."""
        contender = next(each for each, _ in rows(self.peers, self.device) if each.label == self.label)
        numbers = max(self.iterations, 1), self.substeps
        return [
            [judge(contender, numbers[0], ratio, k, numbers[1], self.device) for k in STIFFNESS] for ratio in RATIOS
        ]


def run(device: str, peers: bool, folder: Path, jobs: int) -> int:
    """Compute all cells, a panel to a process of `jobs`, print how many hold, write JSON, PNG and SVG."""
    panels = [
        Panel(each.label, iterations if each.iterations != (1,) else 0, substeps, peers, device)
        for each, iterations in rows(peers, device)
        for substeps in SUBSTEPS
    ]
    found: dict[str, list] = {}
    start = time.perf_counter()
    for panel, cells in zip(panels, _computed(panels, jobs), strict=True):
        found.setdefault(panel.row, []).append(cells)
        counts = [f"{np.sum(np.array(cells) == name)} {name}" for name in OUTCOMES if name in np.array(cells)]
        line = f"{time.perf_counter() - start:5.0f} s  {panel.row}, {panel.substeps} substeps: {', '.join(counts)}"
        print(line, file=sys.stderr, flush=True)
    where = machine(device if device != "auto" else None)
    print(f"{where['name']} ({where['device']}); chain of {SEGMENTS} segments, {FRAMES * FRAME_DT:g} s")
    print(table(found))
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"map_{where['device'].replace(':', '')}"
    path.with_suffix(".json").write_text(json.dumps({"machine": where, "cells": found}))
    draw(found, path)
    print(f"written: {path}.json, .png, .svg")
    own = [np.array(cells) for label, cells in found.items() if label.startswith(("XPBD", "auto"))]
    return int(any((cells != "holds").any() for cells in own))


def _computed(panels: list[Panel], jobs: int) -> Iterator[list[list[str]]]:
    """Yield the cells of every panel in order, each as soon as it is done."""
    if jobs == 1:
        yield from map(Panel.cells, panels)
        return
    with multiprocessing.get_context("spawn").Pool(jobs, quietly) as pool:
        yield from pool.imap(Panel.cells, panels)


def table(found: dict[str, list]) -> str:
    """Return the numbers of cells by method and outcome."""
    lines = [f"{'':<36}" + "".join(f"{name:>13}" for name in OUTCOMES)]
    for label, cells in found.items():
        flat = np.array(cells).ravel()
        lines.append(f"{label:<36}" + "".join(f"{int((flat == name).sum()):>13}" for name in OUTCOMES))
    return "\n".join(lines)


def draw(found: dict[str, list], path: Path) -> None:
    """Draw a panel for each method and number of substeps: stiffness across, mass ratio up."""
    figure = Figure(figsize=(11, 1.5 * len(found) + 1.2), layout="constrained")
    panels = figure.subplots(len(found), len(SUBSTEPS), squeeze=False, sharex=True, sharey=True)
    names, colours = list(OUTCOMES), ListedColormap(list(OUTCOMES.values()))
    for row, (label, cells) in zip(panels, found.items(), strict=True):
        for axes, substeps, block in zip(row, SUBSTEPS, cells, strict=True):
            numbers = [[names.index(cell) for cell in line] for line in block]
            axes.pcolormesh(np.array(numbers), cmap=colours, vmin=-0.5, vmax=len(names) - 0.5, edgecolors="w", lw=0.5)
            axes.set_xticks(np.arange(len(STIFFNESS)) + 0.5, [_power(k) for k in STIFFNESS], fontsize=7)
            axes.set_yticks(np.arange(len(RATIOS)) + 0.5, [_power(ratio) for ratio in RATIOS], fontsize=7)
            if axes in panels[0]:
                axes.set_title(f"{substeps} substeps", fontsize=9)
        row[0].set_ylabel(label.replace(", ", ",\n"), fontsize=8)
    figure.supxlabel("spring constant [N/m]", fontsize=9)
    figure.supylabel("load at the end / mass of the chain", fontsize=9)
    entries = [
        Patch(facecolor=colour, edgecolor="#c9ced6", label=name)
        for name, colour in OUTCOMES.items()
        if any(name in line for cells in found.values() for block in cells for line in block)
    ]
    figure.legend(handles=entries, ncols=len(entries), fontsize=8, loc="outside upper right")
    save_png(figure, path.with_suffix(".png"))
    figure.savefig(path.with_suffix(".svg"))


def _power(value: float) -> str:
    return "rigid" if np.isinf(value) else f"1e{round(np.log10(value))}"
