# SPDX-License-Identifier: Apache-2.0
"""A dragged rope of 12 particles: what the iterations do to its stretch under PBD and XPBD.

Seen from the hand that drags it, which stays put: there gravity is g minus the hand's acceleration.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from cloth_sim_ros.sim import Rope, Scene, Settings, Simulation
from cloth_sim_ros.study.implicit import implicit_step
from cloth_sim_ros.study.motion import Step
from cloth_sim_ros.study.relaxation import position_based
from cloth_sim_ros.study.springs import SpringSystem

FRAME_DT, FRAMES, SUBSTEPS = 1.0 / 60.0, 60, 1
SWING, PERIOD = 0.5, 1.0  # the hand moves by SWING (1 - cos(2 pi t / PERIOD)) / 2 [m], [s] along x
SHOWN = 39  # the frame that the shapes are drawn at
ITERATIONS = (1, 2, 4, 8, 16, 32, 64)
ROPE = Rope(start=(0.0, 0.0, 0.0), end=(0.0, 0.0, -1.0), segments=11, mass=0.2, stretch_compliance=1.0 / 200.0)

Frames = Callable[[int, str], np.ndarray]  # (iterations, device) -> positions (FRAMES + 1, 12, 3) [m]


def gravity(frame: int) -> tuple[float, float, float]:
    """Gravity [m/s^2] in the frame of the hand, in the middle of a frame."""
    rate = 2.0 * np.pi / PERIOD
    return (-0.5 * SWING * rate**2 * float(np.cos(rate * (frame + 0.5) * FRAME_DT)), 0.0, -9.81)


def product(iterations: int, device: str) -> np.ndarray:
    """The product itself, which solves the rope as a whole."""
    settings = Settings(method="xpbd", order=1, frame_dt=FRAME_DT, substeps=SUBSTEPS, iterations=iterations)
    sim = Simulation(Scene(objects={"rope": ROPE}), settings, device=device)
    found = [sim.positions("rope")]
    for frame in range(FRAMES):
        sim.set("gravity", gravity(frame))
        sim.step()
        found.append(sim.positions("rope"))
    return np.array(found, dtype=np.float64)


def reference(make: Callable[[SpringSystem, int], Step]) -> Frames:
    """A method in NumPy on the same springs."""

    def frames(iterations: int, device: str) -> np.ndarray:
        system, x = _system()
        v = np.zeros_like(x)
        step, found = make(system, iterations), [x]
        for frame in range(FRAMES):
            moved = replace(system, gravity=gravity(frame))
            for _ in range(SUBSTEPS):
                x, v = step(moved, x, v, FRAME_DT / SUBSTEPS)
            found.append(x)
        return np.array(found)

    return frames


METHODS: dict[str, tuple[Frames, str]] = {  # label -> (frames, colour)
    "PBD, stiffness 1": (reference(position_based), "#e4572e"),
    "PBD, stiffness 0.1": (reference(lambda system, n: position_based(system, n, 0.1)), "#f2b134"),
    "XPBD": (product, "#3b8f5a"),
}
CONVERGED = reference(lambda system, n: implicit_step)


def stretch(frames: np.ndarray) -> float:
    """The rope's length over its rest length, less 1, averaged over the second half of the frames."""
    lengths = np.linalg.norm(np.diff(frames[len(frames) // 2 :], axis=1), axis=2).sum(axis=1)
    rest = np.linalg.norm(np.diff(ROPE.points, axis=0), axis=1).sum()
    return float((lengths / rest).mean() - 1.0)


def draw(device: str) -> Figure:
    """Shapes at one moment, and the mean stretch against iterations."""
    figure = Figure(figsize=(13.0, 4.2), layout="constrained")
    *shapes, chart = figure.subplots(1, len(METHODS) + 1, width_ratios=[1.0] * len(METHODS) + [2.6])
    exact = CONVERGED(0, device)
    for axes, (label, (frames, colour)) in zip(shapes, METHODS.items(), strict=True):
        runs = {n: frames(n, device) for n in ITERATIONS}
        for n, alpha in zip((1, 4, 16, 64), (0.25, 0.45, 0.7, 1.0), strict=True):
            points = runs[n][SHOWN]
            axes.plot(points[:, 0], points[:, 2], color=colour, alpha=alpha, marker="o", ms=2.5, lw=1.3, label=f"x{n}")
        axes.plot(exact[SHOWN, :, 0], exact[SHOWN, :, 2], color="black", lw=0.8, ls=":")
        axes.set_title(label, fontsize=9)
        _bare(axes)
        values = [stretch(run) for run in runs.values()]
        chart.plot(ITERATIONS, values, color=colour, marker="o", ms=4, lw=1.4, label=label)
    chart.axhline(stretch(exact), color="black", lw=0.9, ls=":", label="converged implicit Euler")
    chart.set(xscale="log", yscale="log", xlabel="iterations a substep", ylabel="mean stretch of the rope [-]")
    chart.set_xticks(ITERATIONS, [str(n) for n in ITERATIONS])
    chart.grid(alpha=0.2, which="both")
    chart.spines[["top", "right"]].set_visible(False)
    chart.legend(fontsize=8, frameon=False)
    return figure


def _bare(axes: Axes) -> None:
    axes.set(xlim=(-0.25, 0.75), ylim=(-1.75, 0.05))
    axes.set_aspect("equal")
    axes.axis("off")
    axes.legend(fontsize=7, frameon=False, loc="lower right")


def _system() -> tuple[SpringSystem, np.ndarray]:
    """The rope's masses and springs, and where they start (12, 3) [m]."""
    sim = Simulation(Scene(objects={"rope": ROPE}), device="cpu")
    system = SpringSystem.from_springs(sim.masses("rope"), [0], sim.springs("rope"))
    return system, sim.rest_positions("rope").astype(np.float64)
