# SPDX-License-Identifier: Apache-2.0
"""A planner over worlds by path integrals, MPPI (Williams, Aldrich and Theodorou 2017), for a whole episode."""

from __future__ import annotations

import numpy as np
from gymnasium.vector import VectorEnv

_SHRINKS = 0.95  # the noise, in a round
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
    """Actions (horizon, A) that earn much in worlds as those of `env`, and the best return of each of `rounds`.

    It starts from a `guess` (horizon, A), or from no action, with noise whose deviation is `spread`, of half the range.

    In a round every world tries the plan so far with noise of its own, which is linear between `knots`; the noise
    shrinks. The plan then becomes the mean of all that were tried, each weighed by the exponential of its return, in
    units of a third of the deviation of all returns. What varies is drawn anew in every round.
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
    """(horizon, knots): linear interpolation between knots that lie evenly over the horizon."""
    place = np.linspace(0.0, knots - 1.0, horizon)[:, None]
    return np.maximum(0.0, 1.0 - np.abs(place - np.arange(knots)))
