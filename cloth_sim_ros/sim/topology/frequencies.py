# SPDX-License-Identifier: Apache-2.0
"""Highest frequency of an object's springs: tabulated once per shape, then interpolated for any stiffness."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from cloth_sim_ros.sim.topology.springs import Elements

_POWERS = 60  # number of power iterations
_LARGEST = 1e100  # [N/m]: no step is short enough for stiffer springs, and squares of their forces would overflow
_APART = 0.125  # spacing of the table in the logarithm of the ratio of two stiffnesses
_FEW = 4  # number of stiffnesses computed one by one before a table pays
_MOST_KNOWN = 64
_SAFETY, _LEAST_MARGIN = 30.0, 1e-5  # factor of the table's error estimate, and minimum relative error


class Frequencies:
    """omega^2 [1/s^2] of the fastest mode of an object's springs, at rest or, where it `crumples`, in any shape."""

    def __init__(
        self, springs: dict[str, Elements], rest: np.ndarray, masses: np.ndarray, pinned: np.ndarray, crumples: bool
    ) -> None:
        self._springs, self._rest, self._crumples = list(springs.values()), rest, crumples
        self._inverse_mass = np.where(pinned, 0.0, 1.0 / masses)
        pairs = np.concatenate([each.particles for each in self._springs])
        self.mean_length = float(np.linalg.norm(rest[pairs[:, 1]] - rest[pairs[:, 0]], axis=1).mean())  # [m] of springs
        self._known: dict[tuple[float, ...], float] = {}
        self._table: dict[int, float] = {}
        self._asked = 0
        self._last: tuple[tuple[float, ...], tuple[float, float]] | None = None  # asked with dashpots and without

    def near(self, constants: tuple[float, ...]) -> tuple[float, float]:
        """omega^2 for a stiffness [N/m] of each kind of springs, and the largest relative error of it.

        omega^2 is proportional to a common factor of all stiffnesses, so for two kinds only their ratio matters. After
        a few calls it is interpolated in a table of ratios. Interpolations with fewer entries bound the error.
        """
        if self._last is None or self._last[0] != constants:
            self._last = constants, self._near(constants)
        return self._last[1]

    def _near(self, constants: tuple[float, ...]) -> tuple[float, float]:
        if max(constants) > _LARGEST:
            return math.inf, 0.0
        if len(constants) == 1:
            return constants[0] * self.exact((1.0,)), _LEAST_MARGIN
        self._asked += 1
        if constants in self._known or len(constants) != 2 or self._asked <= _FEW:
            return self.exact(constants), 0.0
        place = math.log(constants[0] / constants[1]) / _APART
        first = math.floor(place)
        places = range(first - 2, first + 4)
        logs = [self._entry(each) for each in places]
        if not all(map(math.isfinite, logs)):
            return self.exact(constants), 0.0
        found = _interpolated(places, logs, place)
        fewer = (slice(1, -1), slice(1, None), slice(None, -1))
        apart = max(abs(found - _interpolated(places[some], logs[some], place)) for some in fewer)
        margin = _SAFETY * apart + _LEAST_MARGIN
        return math.sqrt(constants[0] * constants[1]) * math.exp(found), margin

    def exact(self, constants: tuple[float, ...]) -> float:
        """The same, by power iteration from a fixed start."""
        if constants not in self._known:
            if len(self._known) >= _MOST_KNOWN:
                self._known.clear()
            self._known[constants] = self._by_powers(constants)
        return self._known[constants]

    def _entry(self, place: int) -> float:
        """The logarithm where the first kind is exp(_APART place) times as stiff as the second, both by root."""
        if place not in self._table:
            half = math.exp(0.5 * _APART * place)
            found = self._by_powers((half, 1.0 / half))
            self._table[place] = math.log(found) if found > 0.0 else -math.inf
        return self._table[place]

    def _by_powers(self, constants: Iterable[float]) -> float:
        pairs = np.concatenate([each.particles for each in self._springs])
        constant = np.concatenate([k / each.scale for k, each in zip(constants, self._springs, strict=True)])
        edge = self._rest[pairs[:, 1]] - self._rest[pairs[:, 0]]
        n = np.ones((len(edge), 1)) if self._crumples else edge / np.linalg.norm(edge, axis=1, keepdims=True)
        count, free = len(self._inverse_mass), self._inverse_mass > 0.0
        x = np.random.default_rng(3).standard_normal((count, n.shape[1])) * free[:, None]
        largest = 0.0
        for _ in range(_POWERS):
            x /= max(np.linalg.norm(x), 1e-300)
            pull = (constant * ((x[pairs[:, 1]] - x[pairs[:, 0]]) * n).sum(1))[:, None] * n
            force = np.zeros_like(x)
            for axis in range(n.shape[1]):
                force[:, axis] -= np.bincount(pairs[:, 0], pull[:, axis], minlength=count)
                force[:, axis] += np.bincount(pairs[:, 1], pull[:, axis], minlength=count)
            x = force * self._inverse_mass[:, None]
            largest = float(np.linalg.norm(x))
        return largest


def _interpolated(places: range, values: list[float], place: float) -> float:
    """Evaluate at a place the polynomial through values at whole places (Lagrange)."""
    total = 0.0
    for i, value in zip(places, values, strict=True):
        for j in places:
            if i != j:
                value *= (place - j) / (i - j)
        total += value
    return total
