# SPDX-License-Identifier: Apache-2.0
"""Trials of a body that is pulled at: by its pins, by the wind."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from cloth_sim_ros.sim import Scene, Simulation, Wind
from cloth_sim_ros.study.hard.bodies import BODY, inverse_mass, make_body
from cloth_sim_ros.study.hard.trial import Options, Trial


def _carry_pins(sim: Simulation, goal: Callable[[np.ndarray], np.ndarray]) -> None:
    """Move pinned particles to `goal` of their rest positions; the others keep positions and velocities."""
    held, x, v = inverse_mass(sim) == 0.0, sim.positions(BODY).astype(np.float64), sim.velocities(BODY)
    x[held] = goal(sim.rest_positions(BODY)[held].astype(np.float64))
    sim.set_positions(BODY, x)
    sim.set_velocities(BODY, v)


def _damp(sim: Simulation) -> None:
    """Add drag, so that the body can be at rest at the end."""
    sim.set("solver.global_damping", 2.0)


def pulled_pins(kind: str, options: Options, random: np.random.Generator) -> Trial:
    """Pins on both sides are pulled apart to twice their distance within half a second, held, and brought back."""
    body = make_body(kind, float(random.choice([0.0, 1e-6, 1e-4])), pins="both", damping=2e-3)
    jump = 0.5 / 30.0

    def drive(sim: Simulation, frame: int) -> None:
        share = float(np.clip(min(frame, 90 - frame) / 30.0, 0.0, 1.0))
        _carry_pins(sim, lambda x: x * [1.0 + share, 1.0, 1.0])

    return Trial(Scene({BODY: body}), frames=210, drive=drive, begin=_damp, jump=jump, rest=0.02)


def pins_in_conflict(kind: str, options: Options, random: np.random.Generator) -> Trial:
    """The pins of a rigid or stiff body jump every frame to places that its springs cannot meet."""
    body = make_body(kind, options["compliance"], pins="both", damping=2e-3)

    def drive(sim: Simulation, frame: int) -> None:
        jump = 0.05 if frame < 60 else 0.0
        _carry_pins(sim, lambda x: x + jump * random.uniform(-1.0, 1.0, x.shape))

    return Trial(Scene({BODY: body}), frames=180, drive=drive, begin=_damp, jump=0.1 * math.sqrt(3.0), rest=0.02)


def gusts(kind: str, options: Options, random: np.random.Generator) -> Trial:
    """Wind of 100 m/s that reverses every frame; lift across it and springs that snap back may add their share."""
    direction = random.standard_normal(3)
    direction /= np.linalg.norm(direction)
    scene = Scene({BODY: make_body(kind, pins=options["pins"], damping=1e-3)}, wind=Wind((0, 0, 0)))

    def drive(sim: Simulation, frame: int) -> None:
        sim.set_wind(tuple((-1.0) ** frame * 100.0 * direction))

    return Trial(scene, frames=60, drive=drive, fastest=200.0)
