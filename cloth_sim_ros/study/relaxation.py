# SPDX-License-Identifier: Apache-2.0
"""Position-based dynamics as in its papers, in NumPy, for figures: the product solves ropes directly instead.

PBD: Mueller, Heidelberger, Hennix, Ratcliff 2007. XPBD: Macklin, Mueller, Chentanez 2016.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cloth_sim_ros.study.colouring import colour
from cloth_sim_ros.study.motion import Step
from cloth_sim_ros.study.springs import SpringSystem


@dataclass
class Springs:
    """Particles x (N, 3) [m] with inverse masses (N,) [1/kg], springs `pairs` (E, 2) of rest lengths (E,) [m].

    compliance (E,) [m/N]: 0 is rigid, which is PBD. groups: indices of the springs of each pass of a sweep.
    """

    x: np.ndarray
    inverse_mass: np.ndarray
    pairs: np.ndarray
    rest: np.ndarray
    compliance: np.ndarray
    groups: Sequence[np.ndarray]

    def violation(self) -> np.ndarray:
        """Return the elongation (E,) [m] of each spring."""
        return np.linalg.norm(self.x[self.pairs[:, 1]] - self.x[self.pairs[:, 0]], axis=1) - self.rest

    def corrections(self, chosen: np.ndarray, multipliers: np.ndarray, step: float) -> tuple[np.ndarray, np.ndarray]:
        """Return the corrections (E', 3) [m] of the first and the second particles of springs `chosen`.

        All use the same x. multipliers (E,) [N s^2] are updated. step [s]: length of the time step, which scales the
        compliance.
        """
        a, b = self.pairs[chosen].T
        edge = self.x[b] - self.x[a]
        length = np.linalg.norm(edge, axis=1)
        weight = self.inverse_mass[a] + self.inverse_mass[b]
        soft = self.compliance[chosen] / step**2
        change = -(length - self.rest[chosen] + soft * multipliers[chosen]) / np.maximum(weight + soft, 1e-12)
        multipliers[chosen] += change
        push = (change / np.maximum(length, 1e-12))[:, None] * edge
        return -self.inverse_mass[a, None] * push, self.inverse_mass[b, None] * push

    def sweep(self, multipliers: np.ndarray, step: float, share: float = 1.0) -> None:
        """Project one group after the other, each by the share `share` of its corrections, the stiffness of PBD."""
        for chosen in self.groups:
            first, second = self.corrections(chosen, multipliers, step)
            self.x[self.pairs[chosen, 0]] += share * first
            self.x[self.pairs[chosen, 1]] += share * second

    def race(self, chosen: np.ndarray, multipliers: np.ndarray, step: float) -> int:
        """Project all `chosen` at once, as unsynchronised threads do; return the number of lost writes.

        Each reads x, then writes, and the last writer wins.
        """
        first, second = self.corrections(chosen, multipliers, step)
        particles = self.pairs[chosen].T.ravel()
        self.x[particles] = self.x[particles] + np.concatenate([first, second])  # NumPy keeps the last writer's
        return lost_writes(self.pairs[chosen])


def lost_writes(pairs: np.ndarray) -> int:
    """Return the number of writes of springs `pairs` (E, 2) that are overwritten if all write at once."""
    return 2 * len(pairs) - len(np.unique(pairs))


class HangingRope:
    """A rope whose first particle is led, by PBD (`compliance` None) or XPBD with iterations of red-black sweeps.

    masses (N,) [kg], rest (N-1,) [m]; it hangs from `top` (3,) [m]. compliance [m/N] of each segment. damping [1/s].
    """

    def __init__(
        self, top: np.ndarray, masses: np.ndarray, rest: np.ndarray, compliance: float | None, damping: float = 2.0
    ):
        count = len(masses)
        depth = np.concatenate([[0.0], np.cumsum(rest)])
        x = np.asarray(top, float) - depth[:, None] * np.array([0.0, 0.0, 1.0])
        pairs = np.stack([np.arange(count - 1), np.arange(1, count)], axis=1)
        inverse = 1.0 / np.asarray(masses, float)
        inverse[0] = 0.0
        segments = np.arange(count - 1)
        groups = [segments[::2], segments[1::2]]  # no two of a group share a particle
        soft = np.full(count - 1, compliance or 0.0)
        self.springs = Springs(x, inverse, pairs, np.asarray(rest, float), soft, groups)
        self.velocities = np.zeros_like(x)
        self.damping = damping

    def step(self, top: np.ndarray, dt: float, substeps: int, iterations: int, gravity: float = 9.81) -> None:
        """Advance by a frame of `dt` [s], at whose end the first particle is at `top` (3,) [m]."""
        h, springs = dt / substeps, self.springs
        begin = springs.x[0].copy()
        for k in range(substeps):
            before = springs.x.copy()
            self.velocities /= 1.0 + h * self.damping
            self.velocities[1:, 2] -= h * gravity
            springs.x[1:] += h * self.velocities[1:]
            springs.x[0] = begin + (k + 1) / substeps * (np.asarray(top) - begin)
            multipliers = np.zeros(len(springs.pairs))
            for _ in range(iterations):
                springs.sweep(multipliers, h)
            self.velocities = (springs.x - before) / h

    @property
    def stretch(self) -> float:
        """Return the elongation of the rope over its rest length [-]."""
        return float(self.springs.violation().sum() / self.springs.rest.sum())


def position_based(system: SpringSystem, iterations: int, stiffness: float = 1.0) -> Step:
    """Return a step of PBD (Mueller et al. 2007), which projects springs by the share `stiffness`, colour after colour.

    The spring constants are not used: the stiffness of the cloth depends on the iterations and on the step.
    """
    inverse_mass, rigid = _inverse_masses(system), np.zeros(len(system.pairs))
    groups = _colours(system)

    def step(system: SpringSystem, x: np.ndarray, v: np.ndarray, h: float) -> tuple[np.ndarray, np.ndarray]:
        start = x + np.where(system.fixed[:, None], 0.0, h * v + h**2 * np.asarray(system.gravity))
        springs = Springs(start, inverse_mass, system.pairs, system.rest_length, rigid, groups)
        for _ in range(iterations):
            springs.sweep(np.zeros_like(rigid), h, stiffness)
        return springs.x, (springs.x - x) / h

    return step


def _inverse_masses(system: SpringSystem) -> np.ndarray:
    """Return inverse masses (N,) [1/kg], 0 for fixed particles."""
    if system.damping or system.global_damping:
        raise ValueError("the system is damped; allowed are systems without damping, as PBD has none")
    return np.where(system.fixed, 0.0, 1.0 / system.masses)


def _colours(system: SpringSystem) -> list[np.ndarray]:
    """Return indices of the springs with a free particle, in groups that share no particle."""
    felt = np.flatnonzero(~system.fixed[system.pairs].all(axis=1))
    colours = colour(system.pairs[felt], len(system.masses))
    return [felt[colours == c] for c in range(colours.max(initial=-1) + 1)]
