# SPDX-License-Identifier: Apache-2.0
"""The live error estimate: changes nothing, and tells the size and the order of a frame's error."""

import numpy as np
import pytest
from fixed_settings import fixed

from cloth_sim_ros.sim import Cloth, Scene, Simulation, Sphere

SHEET = Cloth(resolution=(9, 9), pins="top", thickness=0.045, stretch_compliance=1e-3, shear_compliance=1e-3)
METHODS = {
    "order 1": {"order": 1, "iterations": 4},
    "order 2": {"order": 2, "iterations": 4},
    "verlet": {"method": "verlet"},
    "graph": {"order": 2, "executor": "graph"},
}


BALL = {"ball": Sphere(radius=0.22, position=(0, 0.2, -0.24))}


def simulation(device, substeps=40, colliders=None, executor=None, **settings):
    return Simulation(
        Scene({"it": SHEET}, colliders or {}), fixed(substeps=substeps, **settings), device=device, executor=executor
    )


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.long
def test_it_changes_no_bit(device, method):
    plain, watched = (simulation(device, colliders=BALL, **METHODS[method]) for _ in range(2))
    for frame in range(12):
        for sim in (plain, watched):
            sim.set_collider_pose("ball", (0, 0.2, -0.22 + 0.01 * frame))
        plain.step()
        watched.step_and_estimate() if frame % 3 == 1 else watched.step()
    for name in ("positions", "velocities"):
        assert np.array_equal(getattr(plain, name)("it"), getattr(watched, name)("it"))
    assert plain.time == watched.time and watched.report()["it"] == plain.report()["it"]


@pytest.mark.parametrize(("method", "stretch", "order"), [("order 1", 1.0, 1.0), ("verlet", 1.05, 2.0)])
def test_it_falls_with_the_order_of_the_method(device, method, stretch, order):
    """Of verlet in a motion whose errors are above what float32 forces scatter."""
    found = []
    for substeps in (20, 40, 80, 160):
        sim = simulation(device, substeps, **METHODS[method])
        sim.set_positions("it", stretch * sim.rest_positions("it"))
        sim.step(2)
        found.append(sim.step_and_estimate()["it"])
    assert np.log2(found[0] / found[3]) / 3.0 == pytest.approx(order, abs=0.35)


@pytest.mark.parametrize("method", ["order 1", "order 2", "verlet"])
def test_it_is_of_the_size_of_the_error(device, method):
    """The error of ten frames, against a run of 16 times the substeps, is within a factor of 4 of their estimates."""
    frames = 10
    sims = [simulation(device, n, **METHODS[method]) for n in (40, 640)]
    estimates = [sims[0].step_and_estimate()["it"] for _ in range(frames)]
    sims[1].step(frames)
    true = np.sqrt(((sims[0].positions("it") - sims[1].positions("it")) ** 2).sum(1).mean())
    assert true / 4.0 < sum(estimates) < 4.0 * true
