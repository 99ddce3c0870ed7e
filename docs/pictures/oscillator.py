# SPDX-License-Identifier: Apache-2.0
"""One mass on one spring under each method: what a step does to the amplitude, measured against its closed form."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from cloth_sim_ros.sim import Rope, Scene, Settings, Simulation
from cloth_sim_ros.study import motion
from cloth_sim_ros.study.closed_forms import oscillator
from cloth_sim_ros.study.springs import SpringSystem

MASS, FREQUENCY, LENGTH, STRETCH = 0.3, 12.0, 1.0, 0.1  # [kg], [rad/s], [m], [m]
STEP = 1.0 / 60.0  # [s]
STEPS = 90
METHODS = {  # label -> (growth z of theta, colour)
    "forward Euler": (oscillator.forward_euler, "#e4572e"),
    "leapfrog Verlet": (oscillator.verlet, "#3b8f5a"),
    "XPBD, first order": (oscillator.implicit_euler, "#2e86ab"),
    "XPBD, second order": (oscillator.bdf2, "#8e5aa8"),
}


def motions(device: str) -> dict[str, np.ndarray]:
    """Label -> stretch (STEPS + 1,) [m] after each step of STEP, released at STRETCH."""
    explicit = {"forward Euler": motion.forward_euler, "leapfrog Verlet": motion.leapfrog}
    found = {label: _reference(step) for label, step in explicit.items()}
    for order, label in ((1, "XPBD, first order"), (2, "XPBD, second order")):
        found[label] = _product(order, device)
    return found


def growth(q: np.ndarray) -> float:
    """|z| of the recurrence q_n+2 = 2 Re z q_n+1 - |z|^2 q_n that fits the second half of a sequence (Prony 1795)."""
    q = q[len(q) // 2 :]
    return float(np.sqrt(np.linalg.lstsq(np.stack([q[1:-1], -q[:-2]], axis=1), q[2:], rcond=None)[0][1]))


def _reference(step: motion.Step) -> np.ndarray:
    constant = np.array([MASS * FREQUENCY**2])
    ends = np.array([[0.0, 0.0, 0.0], [LENGTH + STRETCH, 0.0, 0.0]])
    system = SpringSystem(
        masses=np.array([MASS, MASS]),
        fixed=np.array([True, False]),
        pairs=np.array([[0, 1]]),
        rest_length=np.array([LENGTH]),
        constant=constant,
        gravity=(0.0, 0.0, 0.0),
    )
    return motion.frames_by(step, system, ends, 0.0 * ends, STEP, STEPS, 1)[0][:, 1, 0] - LENGTH


def _product(order: int, device: str) -> np.ndarray:
    rope = Rope(
        start=(0.0, 0.0, 0.0),
        end=(LENGTH, 0.0, 0.0),
        segments=1,
        stretch_compliance=1.0 / (MASS * FREQUENCY**2 * LENGTH),
        particle_masses=[MASS, MASS],
    )
    scene = Scene(objects={"it": rope}, gravity=(0.0, 0.0, 0.0))
    sim = Simulation(
        scene, Settings(method="xpbd", order=order, substeps=1, iterations=2, frame_dt=STEP), device=device
    )
    sim.set_positions("it", [[0.0, 0.0, 0.0], [LENGTH + STRETCH, 0.0, 0.0]])
    stretch = [STRETCH]
    for _ in range(STEPS):
        sim.step()
        stretch.append(float(sim.positions("it")[1, 0]) - LENGTH)
    return np.array(stretch)


def draw(device: str) -> Figure:
    """The motion of every method, and its growth a step beside the formula."""
    theta = FREQUENCY * STEP
    figure = Figure(figsize=(11.0, 5.6), layout="constrained")
    found = motions(device)
    time = STEP * np.arange(STEPS + 1)
    for axes, (label, q) in zip(figure.subplots(2, 2, sharex=True).ravel(), found.items(), strict=True):
        z, colour = METHODS[label]
        factor = abs(z(theta))
        axes.plot(time, STRETCH * np.cos(FREQUENCY * time), color="#c9ccd1", lw=1.5, label="exact")
        axes.plot(time, q, color=colour, marker="o", ms=2.2, lw=1.2, label=label)
        for sign in (1.0, -1.0):
            envelope = sign * STRETCH * factor ** np.arange(STEPS + 1)
            axes.plot(time, envelope, color=colour, lw=0.8, ls="--", alpha=0.7)
        root = r"$\sqrt{1 + \theta^2}$ = " if label == "forward Euler" else ""
        axes.set_title(f"{label}: x {growth(q):.5f} a step, formula {root}{factor:.5f}", fontsize=10)
        _tidy(axes)
    figure.suptitle(
        rf"One mass on one spring, $\theta = \omega h$ = {theta:g}. Grey: exact; dashed: the formula", fontsize=11
    )
    figure.supxlabel("time [s]", fontsize=10)
    figure.supylabel("stretch [m]", fontsize=10)
    return figure


def _tidy(axes: Axes) -> None:
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(alpha=0.2)
