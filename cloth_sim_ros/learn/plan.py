# SPDX-License-Identifier: Apache-2.0
"""A planner over worlds by path integrals, MPPI (Williams, Aldrich and Theodorou 2017), for a whole episode."""

from __future__ import annotations

import numpy as np
from gymnasium.vector import VectorEnv

_SHRINKS = 0.95  # factor of the noise from round to round
_GREED = 3.0


def mppi(
    env: VectorEnv,
    horizon: int,
    rounds: int = 25,
    knots: int = 5,
    spread: float = 0.5,
    guess: np.ndarray | None = None,
    seed: int = 0,
) -> tuple[np.ndarray, list[float]]:
    """Plan a whole episode: return actions (horizon, A) with a high return, and the best return of each round.

    In a round every world tries the plan with its own noise, which is linear between knots and shrinks from round to
    round. The plan then becomes the mean of all tried ones, weighted by the exponential of their returns, in units of a
    third of the standard deviation of all returns. The varied numbers are drawn anew in every round.

    Args:
        env: Worlds, all with the same task.
        horizon: Steps of the plan.
        rounds: Number of rounds.
        knots: Points of time between which actions are linear.
        spread: Standard deviation of the first noise, over half the range of an action.
        guess: The first plan (horizon, A); None starts from no action.
        seed: Seed of the noise and of the varied numbers.
    """
    random, low, high = np.random.default_rng(seed), env.single_action_space.low, env.single_action_space.high
    basis, best = _hats(horizon, knots), []
    plan = np.zeros((knots, len(low))) if guess is None else np.linalg.pinv(basis) @ guess
    for each in range(rounds):
        width = spread * (high - low) / 2.0 * _SHRINKS**each
        tried = plan + width * random.standard_normal((env.num_envs, *plan.shape))
        tried[0] = plan
        tried = np.clip(tried, low, high)
        env.reset(seed=seed + each)
        returns = np.zeros(env.num_envs)
        for actions in np.einsum("tk,nka->tna", basis, tried):
            returns += env.step(actions.astype(np.float32))[1]
        weights = np.exp(_GREED * (returns - returns.max()) / max(returns.std(), 1e-12))
        plan = np.einsum("n,nka->ka", weights / weights.sum(), tried)
        best.append(float(returns.max()))
    return basis @ plan, best


def _hats(horizon: int, knots: int) -> np.ndarray:
    """Return weights (horizon, knots) of linear interpolation between knots that lie evenly over the horizon."""
    place = np.linspace(0.0, knots - 1.0, horizon)[:, None]
    return np.maximum(0.0, 1.0 - np.abs(place - np.arange(knots)))
