# SPDX-License-Identifier: Apache-2.0
"""What all tasks share: the API of gymnasium's vector environments, seeds, worlds that end alone, and pictures."""

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from cloth_sim_ros.learn import FoldTowel, HangTowel, RouteCable

TASKS = {"FoldTowel": FoldTowel, "HangTowel": HangTowel, "RouteCable": RouteCable}
OTHERS = ["HangTowel", "RouteCable"]


@pytest.mark.long
@pytest.mark.parametrize("name", TASKS)
def test_it_is_a_vector_environment(device, name):
    env = gymnasium.make_vec(f"cloth_sim_ros/{name}-v0", num_envs=4, device=device)
    env.action_space.seed(1)
    setup = env.unwrapped.setup
    hands, each = len(setup.hands), 3 + setup.lets_go
    assert env.action_space.shape == (4, hands * each)
    assert env.observation_space.shape == (4, hands * each + 3 * len(setup.seen))
    observation, info = env.reset(seed=3)
    first = observation[:, : hands * each]
    assert observation in env.observation_space and info["distance"].shape == (4,)
    for step in range(1, setup.horizon + 2):
        observation, rewards, terminated, truncated, info = env.step(env.action_space.sample())
        assert observation in env.observation_space and np.isfinite(observation).all()
        assert rewards.shape == terminated.shape == truncated.shape == info["success"].shape == (4,)
        assert rewards.dtype == np.float64 and terminated.dtype == truncated.dtype == bool
        assert not terminated.any() and (truncated == (step == setup.horizon)).all()
    assert np.allclose(observation[:, : hands * each], first, atol=1e-6), (
        "the step after an episode begins the next one"
    )
    assert (rewards == 0).all()
    assert env.unwrapped.sim.time == pytest.approx((setup.horizon + 1) * setup.frames / 60)
    assert (env.unwrapped.sim.held(next(iter(setup.hands))) > 0).all(), "and hands hold again"
    env.close()


@pytest.mark.long
@pytest.mark.parametrize("name", TASKS)
@pytest.mark.filterwarnings("ignore:.*A Box observation space:UserWarning")  # particles may be anywhere
@pytest.mark.filterwarnings("error::UserWarning")
def test_one_alone_is_an_environment_that_steps_as_the_first_of_many(device, name):
    one = gymnasium.make(f"cloth_sim_ros/{name}-v0", device=device, render_mode="rgb_array")
    check_env(one.unwrapped)
    many = gymnasium.make_vec(f"cloth_sim_ros/{name}-v0", num_envs=3, device=device)
    many.action_space.seed(1)
    (ours, told), (theirs, _) = one.reset(seed=5), many.reset(seed=5)
    assert np.array_equal(ours, theirs[0]) and set(told) == {"distance", "success"}
    for _ in range(4):
        actions = many.action_space.sample()
        ours, reward, terminated, truncated, told = one.step(actions[0])
        theirs, rewards, _, _, infos = many.step(actions)
        assert np.array_equal(ours, theirs[0]) and reward == rewards[0] and not terminated and not truncated
        assert told["distance"] == infos["distance"][0] and told["success"] is False


@pytest.mark.parametrize("name", ["FoldTowel", *(pytest.param(name, marks=pytest.mark.long) for name in OTHERS)])
def test_rewards_are_bounded_and_random_policies_end(device, name):
    """What moves at random is never further from its aim than hands, object and floor let it be, and 1 is the most."""
    env = gymnasium.make_vec(f"cloth_sim_ros/{name}-v0", num_envs=2, device=device)
    env.action_space.seed(2)
    env.reset(seed=2)
    horizon, ended, least = env.unwrapped.setup.horizon, np.zeros(2, bool), 0.0
    for _ in range(horizon):
        _, rewards, terminated, truncated, _ = env.step(env.action_space.sample())
        ended |= terminated | truncated
        least = min(least, rewards.min())
        assert rewards.max() <= 1.0
    assert ended.all() and least > -6.0
    env.close()


@pytest.mark.long
@pytest.mark.parametrize("name", TASKS)
def test_pictures_show_each_world_and_the_hands(device, name):
    pytest.importorskip("matplotlib"), pytest.importorskip("trimesh")
    env = TASKS[name](2, device, render_mode="rgb_array")
    env.reset(seed=1)
    before = env.render()
    moves = np.zeros(env.action_space.shape, dtype=np.float32)
    moves[1, 2] = 1.0
    env.step(moves), env.step(moves)
    after = env.render()
    assert len(after) == 2 and after[0].shape == (480, 640, 3) and after[0].dtype == np.uint8
    assert (before[0] < 250).mean() > 0.01, "something is painted"
    changed = [(a != b).any(axis=2).mean() for a, b in zip(after, before, strict=True)]
    assert changed[1] > 0.0 and not np.array_equal(after[0], after[1])
    assert TASKS[name](1, device).render() is None
    with pytest.raises(ValueError, match="render_mode is 'human'; allowed is None or 'rgb_array'"):
        TASKS[name](1, device, render_mode="human")


@pytest.mark.long
def test_masses_sizes_and_starts_may_vary_too(device):
    start = HangTowel(1, device).setup.scene.objects["towel"].position
    vary = {
        "towel.mass": {"log_uniform": [0.02, 0.2]},
        "towel.position": {"normal": [start, 0.003]},
        "peg.radius": {"uniform": [0.02, 0.04]},
    }
    env = HangTowel(3, device, vary)
    first, _ = env.reset(seed=2)
    masses = [env.sim.masses("towel", w).sum() for w in range(3)]
    assert len(set(masses)) == 3 and all(0.02 <= mass <= 0.2 for mass in masses)
    assert len({env.sim.get("peg.radius", w) for w in range(3)}) == 3
    assert np.ptp(first[:, -3:], axis=0).min() > 0.0 and (env.sim.held("hand") > 0).all()
    again, _ = env.reset(seed=2)
    assert np.array_equal(first, again)


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
