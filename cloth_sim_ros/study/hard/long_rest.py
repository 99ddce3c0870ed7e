# SPDX-License-Identifier: Apache-2.0
"""Ten minutes of simulated time after a fall, in which a body must come to rest."""

from __future__ import annotations

import numpy as np

from cloth_sim_ros.sim import Cloth, Plane, Rope, Scene, Settings, Simulation, Sphere
from cloth_sim_ros.study.hard.bodies import BODY

MINUTES, FRAMES_A_MINUTE = 10, 3600
MOST_ENERGY, MOST_DRIFT = 1e-6, 1e-5  # [J] at the end, [m] over the last minute


def sheet_over_a_ball() -> Scene:
    """A sheet that falls off-centre on a ball, so that no symmetry holds it; half of it hangs down."""
    return Scene(
        {BODY: Cloth(resolution=(20, 20), pins=None, position=(0.013, 0.007, 0.35))}, {"ball": Sphere(radius=0.25)}
    )


def rope_in_a_heap() -> Scene:
    """A coiled rope that falls on a floor."""
    t = np.linspace(0.0, 1.0, 65)
    turn = 8.0 * np.pi * t
    points = np.stack([0.08 * np.cos(turn), 0.08 * np.sin(turn), 0.05 + 0.4 * t], axis=1)
    return Scene({BODY: Rope(points=points, pins=None)}, {"floor": Plane()})


SCENES = {"sheet over a ball": sheet_over_a_ball, "rope in a heap": rope_in_a_heap}
AIR = 1.0  # [1/s] of drag: without it what a method does not damp by itself would swing on for ever, and rightly
SETTINGS = {
    "xpbd 1, 20 x 1": Settings(method="xpbd", order=1, substeps=20, global_damping=AIR),
    "xpbd 2, 20 x 1": Settings(method="xpbd", substeps=20, global_damping=AIR, order=2),
    "xpbd 2, 20 x 2": Settings(method="xpbd", substeps=20, global_damping=AIR, order=2, iterations=2),
    "verlet, 400": Settings(global_damping=AIR, method="verlet", substeps=400),
}


def run(device: str) -> int:
    """Print energy and drift of each scene by each method, minute by minute; return 1 if one did not come to rest."""
    failed = 0
    for scene, make in SCENES.items():
        for label, settings in SETTINGS.items():
            energy, drift, recoveries = rest(Simulation(make(), settings, device), MINUTES)
            still = energy < MOST_ENERGY and drift < MOST_DRIFT and recoveries == 0
            failed += not still
            print(f"{scene}; {label}: {'at rest' if still else 'FAILED'}: {energy:.1e} J, {drift:.1e} m in a minute")
    return int(failed > 0)


def rest(sim: Simulation, minutes: int) -> tuple[float, float, int]:
    """Return the final kinetic energy [J], the largest drift [m] over the last minute, and the recoveries."""
    sim.step((minutes - 1) * FRAMES_A_MINUTE)
    before = sim.positions(BODY).astype(np.float64)
    sim.step(FRAMES_A_MINUTE)
    drift = float(np.linalg.norm(sim.positions(BODY) - before, axis=1).max())
    report = sim.report()[BODY]
    return report["kinetic_energy"], drift, report["recoveries"]
