# SPDX-License-Identifier: Apache-2.0
"""Colours that keep apart elements which share a particle."""

from __future__ import annotations

import numpy as np


def colour(particles: np.ndarray, count: int) -> np.ndarray:
    """Return colours (E,) such that no two elements of one colour share one of `count` particles.

    Greedy by maximal independent sets: within a colour, the element of the highest random priority among its neighbours
    enters (Luby 1986), until none is left that could. The priorities are seeded: same input, same colours.
    """
    total = len(particles)
    priority = np.random.default_rng(1).permutation(total) + 1
    result = np.full(total, -1)
    current = 0
    while (result < 0).any():
        candidates = np.flatnonzero(result < 0)
        while len(candidates):
            best = np.zeros(count, dtype=np.int64)
            mine = priority[candidates]
            np.maximum.at(best, particles[candidates].ravel(), np.repeat(mine, particles.shape[1]))
            winners = candidates[(best[particles[candidates]] == mine[:, None]).all(axis=1)]
            result[winners] = current
            used = np.zeros(count, dtype=bool)
            used[particles[winners].ravel()] = True
            candidates = candidates[(result[candidates] < 0) & ~used[particles[candidates]].any(axis=1)]
        current += 1
    return result
