# SPDX-License-Identifier: Apache-2.0
"""The towel to be hung over a peg: it falls where it is let go beside, and a plan hangs it."""

import numpy as np
import pytest
from paths import along, run

from cloth_sim_ros.learn import HangTowel, mppi
from cloth_sim_ros.learn.hang import FLOOR, FRAMES, HAND, HANGS, HORIZON, LENGTH, STAYS, STEP

CARRIED = 24  # steps


def over_the_peg():
    """Over the peg and down, not far enough for most towels; then the hand opens."""
    plan = np.ones((HORIZON - 1, 4))
    plan[:, :3] = 0.0
    plan[:CARRIED, :3] = along([HAND, (-0.1, 0, 0.65), (0.12, 0, 0.65), (0.14, 0, 0.36)], CARRIED, STEP)
    plan[CARRIED + 2 :, 3] = -1.0
    return plan


@pytest.mark.long
def test_what_is_let_go_beside_the_peg_falls_freely(device):
    env = HangTowel(3, device, vary={})
    env.reset(seed=1)
    begin = env.sim.tensor("towel", "positions").numpy().copy()
    let_go = np.array([[0, 0, 0, -1.0], [0, 0, 0, 1.0], [0, 0, 0, 0]])
    for step in range(1, 6):
        observation, _, _, _, info = env.step(let_go if step == 1 else 0 * let_go)
        assert list(env.sim.held("hand") > 0) == [False, True, True]
    assert list(observation[:, 3]) == [0, 1, 1]
    fallen = begin[0] - env.sim.tensor("towel", "positions").numpy()[0]
    assert fallen[:, 2].mean() == pytest.approx(0.5 * 9.81 * (5 * FRAMES / 60) ** 2, rel=0.02)
    assert not info["success"].any()


def test_a_towel_that_fell_lies_on_the_floor(device):
    """So that no reward falls without bound."""
    env = HangTowel(2, device)
    env.reset(seed=1)
    rewards = np.array([env.step(np.tile([0.0, 0.0, 0.0, -1.0], (2, 1)))[1] for _ in range(HORIZON - 1)])
    towel = env.sim.positions("towel", None)
    assert towel[..., 2].min() > FLOOR - 0.01 and towel[..., 2].max() < FLOOR + 0.1
    assert rewards.min() > -(HANGS[2] - FLOOR + 0.5 * LENGTH) / LENGTH


def test_a_towel_that_is_held_is_not_hung(device):
    plan = over_the_peg()
    plan[:, 3] = 1.0
    assert not run(HangTowel(4, device), plan)[4]["success"].any()


@pytest.mark.long
def test_a_plan_over_worlds_hangs_at_least_95_of_100(device):
    """Its guess hangs a third of them. Those that hang stay longer than the episode asks for."""
    guess = over_the_peg()
    plan, _ = mppi(HangTowel(48, device), HORIZON - 1, rounds=6, knots=12, spread=0.2, guess=guess)
    env = HangTowel(100, device)
    before, after = (run(env, each)[4]["success"] for each in (guess, plan))
    assert before.sum() < 60 and after.sum() >= 95
    env.sim.step(3 * STAYS * FRAMES)
    places = env.sim.tensor("towel", "positions").numpy().mean(axis=1)
    assert (np.abs(places[after] - [0, 0, 0.43]) < 0.12).all()
