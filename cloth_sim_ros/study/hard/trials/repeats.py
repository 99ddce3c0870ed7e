# SPDX-License-Identifier: Apache-2.0
"""Trials that compare runs to the bit: the same again, and beside a body that went bad."""

from __future__ import annotations

import numpy as np

from cloth_sim_ros.sim import Scene, Simulation, Sphere
from cloth_sim_ros.study.hard.bodies import BODY, inverse_mass, make_body
from cloth_sim_ros.study.hard.trial import Options, Trial


def same_bits(kind: str, options: Options, random: np.random.Generator) -> Trial:
    """A drop over a ball must repeat to the bit: after a reset, and in another simulation."""
    middle = (0.05, 0.02, -0.2)
    scene = Scene({BODY: make_body(kind, pins="none", damping=2e-3)}, {"it": Sphere(radius=0.15, position=middle)})

    def again(sim: Simulation) -> str:
        found = []
        for each in (sim, sim, Simulation(sim.scene, sim.settings, sim.device)):
            each.reset()
            each.step(40)
            found.append(np.concatenate([each.positions(BODY), each.velocities(BODY)]))
        same = all(np.array_equal(found[0], other) for other in found[1:])
        return "" if same else "the same again gave other bits"

    return Trial(scene, frames=40, finally_=again)


def gone_bad(kind: str, options: Options, random: np.random.Generator) -> Trial:
    """One of three bodies gets a value that is not finite: only it is put back, and the others keep their bits."""
    body = make_body(kind, pins="hung", damping=2e-3)
    names = ("first", BODY, "last")
    scene = Scene({name: body for name in names})
    bad, victim = options["value"], int(random.integers(2, 10))

    def alone(sim: Simulation) -> str:
        runs = [Simulation(scene, sim.settings, sim.device) for _ in range(2)]
        for run in runs:
            run.step(10)
        good = runs[0].positions(BODY)
        arrays, span, _ = runs[0].device_arrays(BODY)
        rows = arrays.state.velocities[span].numpy()
        rows[np.flatnonzero(inverse_mass(runs[0]))[victim], 1] = bad
        arrays.state.velocities[span].assign(rows)
        for run in runs:
            run.step()
        report = runs[0].report()
        if not np.array_equal(runs[0].positions(BODY), good) or report[BODY]["recoveries"] != 1:
            return f"not put back: {report[BODY]['recoveries']} recoveries"
        runs[0].step(5), runs[1].step(5)
        same = all(np.array_equal(runs[0].positions(name), runs[1].positions(name)) for name in ("first", "last"))
        return "" if same and np.isfinite(runs[0].positions(BODY)).all() else "its neighbours changed"

    return Trial(Scene({BODY: body}), frames=1, finally_=alone)
