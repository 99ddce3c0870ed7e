# SPDX-License-Identifier: Apache-2.0
"""Trials of one body let go from a hard start, or of a hard material, load or step."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from cloth_sim_ros.sim import Scene, Simulation
from cloth_sim_ros.study.hard.bodies import BODY, SEGMENTS, inverse_mass, make_body
from cloth_sim_ros.study.hard.trial import Options, Trial

SETTLED = 4.0  # [1/s] of drag, of the 6.3 that a pendulum of 1 m takes to be critically damped


def _place(sim: Simulation, move: Callable[[np.ndarray], np.ndarray]) -> None:
    """Move free particles as `move` says; pinned ones stay."""
    rest = sim.rest_positions(BODY).astype(np.float64)
    x = move(rest.copy())
    held = inverse_mass(sim) == 0.0
    x[held] = rest[held]
    sim.set_positions(BODY, x)


STARTS: dict[str, Callable[[np.ndarray, np.random.Generator], np.ndarray]] = {
    "random": lambda x, random: random.uniform(-0.5, 0.5, x.shape),
    "stretched": lambda x, random: 10.0 * x,
    "collapsed": lambda x, random: 1e-6 * random.standard_normal(x.shape),
    "point": lambda x, random: np.zeros_like(x),
    "mirrored": lambda x, random: x * [-1.0, 1.0, 1.0],
}


def bad_start(kind: str, options: Options, random: np.random.Generator) -> Trial:
    """A body let go from a hard start, damped as a rope or cloth is, so that it can be at rest two seconds later.

    With a load it is damped near critically as a pendulum, since a flung load jerks its rope.
    """
    ratio = options.get("ratio", 0.0)
    compliance = _by_load(ratio, 2e-3) if ratio else float(random.choice([0.0, 1e-6, 1e-5, 1e-4]))
    body = make_body(kind, compliance, ratio, damping=float(random.choice([2e-3, 1e-2])))
    start = STARTS[options["start"]]
    scene = Scene({BODY: body})

    def begin(sim: Simulation) -> None:
        sim.set("solver.global_damping", SETTLED if ratio else 2.0)
        _place(sim, lambda x: start(x, random))

    return Trial(scene, begin=begin, conserves=True, rest=0.02)


def _by_load(ratio: float, strain: float) -> float:
    """Return the compliance [m/N] at which a hanging load of `ratio` times the rope strains its springs by `strain`."""
    return strain / SEGMENTS / (0.2 * (1.0 + ratio) * 9.81)


def end_load(kind: str, options: Options, random: np.random.Generator) -> Trial:
    """A body with a load let go from the side: the pull is up to three weights, and twice that in a wave."""
    scene = Scene({BODY: make_body(kind, _by_load(options["ratio"], 0.01), options["ratio"])})

    def strained(sim: Simulation) -> str:
        strain = sim.report()[BODY]["max_strain"]
        return f"strain {strain:.3g} under a load that strains by 0.01" if strain > 0.07 else ""

    return Trial(scene, conserves=True, finally_=strained)


def degenerate(kind: str, options: Options, random: np.random.Generator) -> Trial:
    """A third of the particles lie exactly on their neighbours: springs of no length, triangles of no area."""

    def begin(sim: Simulation) -> None:
        def onto(x: np.ndarray) -> np.ndarray:
            some = random.choice(len(x) - 1, len(x) // 3, replace=False)
            x[some] = x[some + 1]
            return x

        sim.set("solver.global_damping", 2.0)
        _place(sim, onto)

    return Trial(Scene({BODY: make_body(kind, 1e-5, damping=5e-3)}), begin=begin, conserves=True, rest=0.02)


def compliance(kind: str, options: Options, random: np.random.Generator) -> Trial:
    """A body of any compliance, from rigid to 1000 m/N, falls into its pins; it must report its residual."""

    def residual(sim: Simulation) -> str:
        found = sim.report()[BODY]["residual"]
        return "" if math.isfinite(found) else "no residual is reported"

    scene = Scene({BODY: make_body(kind, options["compliance"])})
    return Trial(scene, frames=60, conserves=True, finally_=residual)


def long_step(kind: str, options: Options, random: np.random.Generator) -> Trial:
    """A frame of a tenth of a second in few substeps, undamped, let go a hundredth of a millimetre from rest."""
    body = make_body(kind, float(random.choice([0.0, 1e-6, 1e-3, 1e-2])))

    def begin(sim: Simulation) -> None:
        _place(sim, lambda x: x + 1e-5 * random.standard_normal(x.shape))

    return Trial(Scene({BODY: body}), frames=60, frame_dt=0.1, begin=begin, conserves=True)
