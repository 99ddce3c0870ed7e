# SPDX-License-Identifier: Apache-2.0
"""Ways of a hand as actions, and episodes in which every world does the same."""

import numpy as np


def run(env, plan, seed=99):
    """The last step of an episode in which every world does as planned."""
    env.reset(seed=seed)
    for actions in plan:
        last = env.step(np.tile(np.float32(actions), (env.num_envs, 1)))
    return last


def along(corners, steps, step):
    """Actions (steps, 3) that carry a hand evenly along a line of corners, in units of `step`."""
    corners = np.asarray(corners, dtype=float)
    at = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1))])
    places = np.column_stack([np.interp(np.linspace(0, at[-1], steps + 1), at, column) for column in corners.T])
    moves = np.diff(places, axis=0) / step
    assert np.abs(moves).max() < 1.0
    return moves
