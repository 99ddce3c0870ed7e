# SPDX-License-Identifier: Apache-2.0
"""A state that was saved goes on to the bits of a run that never stopped."""

import random

import numpy as np
import pytest
from driven_scenes import BALL, CASES, FRAMES, contents, make, run, saved

from cloth_sim_ros.sim.batch import forced_executor


def gap(sim):
    """How far the nearest particle is from touching the ball [m]; all are 5 mm thick."""
    apart = [np.linalg.norm(sim.positions(name) - sim.get("ball.position"), axis=1) for name in sim.scene.objects]
    return min(each.min() for each in apart) - BALL.radius - 0.005


@pytest.mark.parametrize("case", CASES)
def test_it_goes_on_to_the_same_bits(case, device, tmp_path):
    seed = random.randrange(1 << 30)
    print(f"seed {seed}")
    moments, executor = sorted(random.Random(seed).sample(range(FRAMES), 5)), CASES[case][3]
    never, gaps = make(case, device), []
    run(never, 0, executor, lambda k: gaps.append(gap(never)))
    assert sum(each < 1e-3 for each in gaps) > 3, "objects touch the ball"
    end = saved(never, tmp_path / "end.npz")
    goes_on = make(case, device)
    run(goes_on, 0, executor, lambda k: k in moments and goes_on.save(tmp_path / f"{k}.npz", {"k": k}))
    assert saved(goes_on, tmp_path / "again.npz") == end, "saving changes nothing"
    for k in moments:
        fresh = make(case, device)
        for sim in (fresh, goes_on):
            with forced_executor(executor):
                assert sim.load(tmp_path / f"{k}.npz") == {"k": k}
            assert sim.time == pytest.approx(k / 60)
            assert saved(sim, tmp_path / "at.npz").keys() == contents(tmp_path / f"{k}.npz").keys()
            with forced_executor(executor):
                sim.step()
            run(sim, k + 1, executor)
            assert saved(sim, tmp_path / "other.npz") == end, (k, sim is fresh)


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
