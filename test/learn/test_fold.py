# SPDX-License-Identifier: Apache-2.0
"""The towel to be folded: the API of gymnasium's vector environments, what is rewarded, and a plan that folds it."""

import gymnasium
import numpy as np
import pytest

from cloth_sim_ros.learn import FoldTowel, mppi
from cloth_sim_ros.learn.fold import FRAMES, HANDS, HORIZON, SIDE, STEP


def run(env, plan):
    """The last step of an episode in which every world does as planned."""
    env.reset(seed=99)
    for actions in plan:
        last = env.step(np.tile(np.float32(actions), (env.num_envs, 1)))
    return last


def half_circles():
    """Both hands over the middle of the towel onto the other edge."""
    angle = np.linspace(0.0, np.pi, HORIZON)
    moves = np.diff(0.5 * SIDE * np.column_stack([0.0 * angle, np.cos(angle), np.sin(angle)]), axis=0)
    assert np.abs(moves).max() < STEP
    return np.tile(moves / STEP, (1, 2))


def test_it_is_a_vector_environment(device):
    env = gymnasium.make_vec("cloth_sim_ros/FoldTowel-v0", num_envs=4, device=device)
    env.action_space.seed(1)
    assert env.observation_space.shape == (4, 54) and env.action_space.shape == (4, 6)
    observation, info = env.reset(seed=3)
    assert observation in env.observation_space and info["distance"].shape == (4,)
    for step in range(1, HORIZON + 2):
        observation, rewards, terminated, truncated, info = env.step(env.action_space.sample())
        assert observation in env.observation_space and np.isfinite(observation).all()
        assert rewards.shape == terminated.shape == truncated.shape == info["success"].shape == (4,)
        assert rewards.dtype == np.float64 and terminated.dtype == truncated.dtype == bool
        assert not terminated.any() and (truncated == (step == HORIZON)).all()
    hands = np.array([[*place, 0.006] for place in HANDS.values()]).ravel()
    assert np.allclose(observation[:, :6], hands, atol=1e-6), "the step after an episode begins the next one"
    assert (rewards == 0).all() and env.unwrapped.sim.time == pytest.approx((HORIZON + 1) * FRAMES / 60)
    env.close()


def test_a_seed_says_all_and_worlds_do_not_touch_each_other(device):
    few, many = (FoldTowel(count, device) for count in (2, 5))
    actions = np.random.default_rng(1).uniform(-1, 1, (6, 5, 6)).astype(np.float32)
    seen = []
    for env in (few, many, many):
        rows = [env.reset(seed=7)[0]]
        rows += [env.step(action[: env.num_envs])[0] for action in actions]
        seen.append(np.array(rows))
    assert np.array_equal(seen[1], seen[2]) and np.array_equal(seen[0], seen[1][:, :2])
    assert not np.array_equal(many.reset(seed=8)[0], many.step(0 * actions[0])[0])
    many.reset(seed=7)
    first = many.sim.get("towel.bend_compliance")
    many.reset()
    assert many.sim.get("towel.bend_compliance") != first, "every episode draws anew"


def test_a_world_that_is_put_back_ends_alone(device):
    env = FoldTowel(3, device)
    env.reset(seed=1)
    env.step(np.zeros((3, 6)))
    arrays, span, _ = env.sim.device_arrays("towel", 1)
    rows = arrays.state.positions[span].numpy()
    rows[50, 2] = np.nan
    arrays.state.positions[span].assign(rows)
    _, _, terminated, truncated, _ = env.step(np.zeros((3, 6)))
    assert list(terminated) == [False, True, False] and not truncated.any()
    observation, rewards, terminated, _, _ = env.step(np.zeros((3, 6)))
    assert not terminated.any() and rewards[1] == 0 and np.isfinite(observation).all()


def test_hands_that_go_in_half_circles_fold_it(device):
    """And hands that stay leave it as it lies: half of it is away from the fold by its distance from the mirror."""
    env = FoldTowel(16, device)
    assert run(env, half_circles())[4]["success"].all()
    lines = SIDE / 9 * np.arange(1, 10, 2)  # [m] from each line of particles to its mirror
    still = run(env, np.zeros((3, 6)))
    assert still[4]["distance"] == pytest.approx(lines.sum() / 10, rel=0.02)
    assert still[1] == pytest.approx(-still[4]["distance"] / SIDE)


@pytest.mark.long
def test_a_plan_over_worlds_folds_at_least_95_of_100(device):
    plan, best = mppi(FoldTowel(256, device), HORIZON - 1)
    assert best[-1] > best[0]
    assert run(FoldTowel(100, device), plan)[4]["success"].sum() >= 95
