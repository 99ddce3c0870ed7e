# SPDX-License-Identifier: Apache-2.0
"""A state that was saved goes on to the bits of a run that never stopped."""

import random

import numpy as np
import pytest
from driven_scenes import BALL, CASES, FRAMES, contents, make, run, saved

from cloth_sim_ros.sim import Cloth, Plane, Scene, Simulation


@pytest.mark.parametrize("case", CASES)
@pytest.mark.long
def test_it_goes_on_to_the_same_bits(case, device, tmp_path):
    seed = random.randrange(1 << 30)
    print(f"seed {seed}")
    moments = sorted(random.Random(seed).sample(range(FRAMES), 5))
    never, touches = make(case, device), []
    run(never, 0, lambda k: touches.append(never.wrench("ball")[0].any()))
    assert sum(touches) > 3, "objects touch the ball"
    end = saved(never, tmp_path / "end.npz")
    goes_on = make(case, device)
    run(goes_on, 0, lambda k: k in moments and goes_on.save(tmp_path / f"{k}.npz", {"k": k}))
    assert saved(goes_on, tmp_path / "again.npz") == end, "saving changes nothing"
    for k in moments:
        fresh = make(case, device)
        for sim in (fresh, goes_on):
            assert sim.load(tmp_path / f"{k}.npz") == {"k": k}
            assert sim.time == pytest.approx(k / 60)
            assert saved(sim, tmp_path / "at.npz").keys() == contents(tmp_path / f"{k}.npz").keys()
            sim.step()
            run(sim, k + 1)
            assert saved(sim, tmp_path / "other.npz") == end, (k, sim is fresh)


def test_what_lies_on_a_plane_lies_there_after_a_load(device, tmp_path):
    floor = {"floor": Plane(position=(0.0, 0.0, 0.1))}
    sims = [
        Simulation(Scene({"it": Cloth((8, 8), (0.3, 0.3), position=(0, 0, 0.1))}, floor), device=device) for _ in "ab"
    ]
    for sim in sims:
        sim.set("it.pins", ())
    sims[0].step(5)
    sims[0].save(tmp_path / "a.npz")
    sims[1].load(tmp_path / "a.npz")
    for sim in sims:
        sim.step(30)
    assert sims[0].positions("it")[:, 2].min() > 0.09
    np.testing.assert_array_equal(sims[1].positions("it"), sims[0].positions("it"))


def test_live_values_are_those_of_the_file(device, tmp_path):
    a, b = make("auto", device), make("auto", device)
    told = {
        "gravity": (0.1, 0.0, -9.7),
        "wind.velocity": (0.3, 0.0, 1.1),
        "wind.drag_coefficient": 0.7,
        "solver.substeps": 9,
        "solver.error": 2e-3,
        "cloth.stretch_compliance": 1.23e-3,
        "cloth.bend_compliance": 333.0,
        "cloth.damping": 0.002,
        "cloth.thickness": 0.007,
        "cloth.pins": (0, 3),
        "ball.static_friction": 0.11,
        "hand.reach": (0.1, 0.2, 0.3),
        "hand.break_force": 1.7,
        "hand.object": "cloth",
    }
    for name, value in told.items():
        a.set(name, value)
    a.save(tmp_path / "a.npz")
    b.load(tmp_path / "a.npz")
    assert {name: a.get(name) for name in told} == told == {name: b.get(name) for name in told}
    assert (b.get("ball.position"), b.get("hand.orientation")) == (BALL.position, (0.0, 0.0, 0.0, 1.0))
    for name in ("cloth.resolution", "solver.method", "rope.pins", "cloth.segments"):
        with pytest.raises(ValueError, match="no live parameter"):
            a.get(name)


def test_what_the_budget_leaves_is_told_once(device, tmp_path):
    a, b = make("auto", device), make("auto", device)
    for sim in (a, b):
        sim.set("solver.budget", 0.1)
    a.set("solver.error", 1e-6)
    run(a, 0)
    a.save(tmp_path / "a.npz")
    b.load(tmp_path / "a.npz")
    assert b.choices["cloth"].reason == a.choices["cloth"].reason
    assert b.choices["cloth"].reason.count("the budget allows no more substeps") == 1
