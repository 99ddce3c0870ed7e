# SPDX-License-Identifier: Apache-2.0
"""The classic methods of cloth in NumPy, each a `Step` of motion.py made for a system and a number of iterations.

They are what a textbook says, in float64 and as fast as NumPy makes them. The product is not meant to be timed against
NumPy, so figures name them as such. To add one, add a function from (system, iterations) to a Step.
"""

from __future__ import annotations

import numpy as np

from cloth_sim_ros.study.colouring import colour
from cloth_sim_ros.study.motion import Step
from cloth_sim_ros.study.relaxation import Springs
from cloth_sim_ros.study.springs import SpringSystem


def position_based(system: SpringSystem, iterations: int, stiffness: float = 1.0) -> Step:
    """PBD (Mueller et al. 2007): springs are moved to rest length by the share `stiffness`, colour after colour.

    The spring constants are not used: what the cloth feels like depends on the iterations and on the step.
    """
    inverse_mass, rigid = _inverse_mass(system), np.zeros(len(system.pairs))
    groups = _colours(system)

    def step(system: SpringSystem, x: np.ndarray, v: np.ndarray, h: float) -> tuple[np.ndarray, np.ndarray]:
        start = _predicted(system, x, v, h)
        springs = Springs(start, inverse_mass, system.pairs, system.rest_length, rigid, groups)
        for _ in range(iterations):
            springs.sweep(np.zeros_like(rigid), h, stiffness)
        return springs.x, (springs.x - x) / h

    return step


def jacobi_xpbd(system: SpringSystem, iterations: int) -> Step:
    """First-order XPBD (Macklin, Mueller, Chentanez 2016), all springs at once from the same positions.

    Each change of a multiplier is divided by the number of springs at its fuller end, or the iteration would diverge.
    """
    inverse_mass = _inverse_mass(system)
    total = inverse_mass[system.pairs].sum(axis=1)
    valence = np.maximum(np.bincount(system.pairs.ravel(), minlength=len(system.masses)), 1)
    share = 1.0 / valence[system.pairs].max(axis=1)

    def step(system: SpringSystem, x: np.ndarray, v: np.ndarray, h: float) -> tuple[np.ndarray, np.ndarray]:
        alpha = 1.0 / (system.constant * h**2)
        new = _predicted(system, x, v, h)
        multiplier = np.zeros(len(system.pairs))
        for _ in range(iterations):
            violation, n = _violation(system, new, slice(None))
            change = share * (-violation - alpha * multiplier) / (np.maximum(total, 1e-300) + alpha)
            multiplier += change
            new += inverse_mass[:, None] * (system.incidence @ (change[:, None] * n))
        return new, (new - x) / h

    return step


def implicit_conjugate_gradients(system: SpringSystem, iterations: int) -> Step:
    """One linearised implicit Euler step (Baraff and Witkin 1998), `iterations` of conjugate gradients from d = h v.

    (M / h^2 + K) d = M v / h + f(x), with the transverse stiffness of compressed springs left out.
    """
    _inverse_mass(system)
    free = ~system.fixed[:, None]

    def step(system: SpringSystem, x: np.ndarray, v: np.ndarray, h: float) -> tuple[np.ndarray, np.ndarray]:
        length, n = system.lengths(x)
        tension = system.constant * (length - system.rest_length)
        transverse = np.clip(tension, 0.0, None) / length
        inertia = system.masses[:, None] / h**2

        def matrix(d: np.ndarray) -> np.ndarray:
            change = system.incidence.T @ d
            along = np.einsum("ij,ij->i", n, change)
            force = transverse[:, None] * change + ((system.constant - transverse) * along)[:, None] * n
            return free * (inertia * d + system.incidence @ force)

        right = free * (inertia * h * v + system.forces(x, v))
        d = _conjugate_gradients(matrix, right, h * v, iterations)
        return x + d, d / h

    return step


def _conjugate_gradients(matrix, right: np.ndarray, d: np.ndarray, iterations: int) -> np.ndarray:
    """Hestenes and Stiefel (1952), stopped early at a residual of 1e-12 of the right side."""
    residual = right - matrix(d)
    direction, square = residual, float((residual**2).sum())
    enough = 1e-24 * float((right**2).sum())
    for _ in range(iterations):
        if square <= enough:
            break
        image = matrix(direction)
        length = square / float((direction * image).sum())
        d = d + length * direction
        residual = residual - length * image
        square, before = float((residual**2).sum()), square
        direction = residual + square / before * direction
    return d


def _inverse_mass(system: SpringSystem) -> np.ndarray:
    """Inverse masses (N,) [1/kg], 0 where fixed."""
    if system.damping or system.global_damping:
        raise ValueError("the system is damped; allowed are systems without damping, as these methods have none")
    return np.where(system.fixed, 0.0, 1.0 / system.masses)


def _colours(system: SpringSystem) -> list[np.ndarray]:
    """Indices of the springs that a free particle feels, in groups that share no particle."""
    felt = np.flatnonzero(~system.fixed[system.pairs].all(axis=1))
    colours = colour(system.pairs[felt], len(system.masses))
    return [felt[colours == c] for c in range(colours.max(initial=-1) + 1)]


def _predicted(system: SpringSystem, x: np.ndarray, v: np.ndarray, h: float) -> np.ndarray:
    return x + np.where(system.fixed[:, None], 0.0, h * v + h**2 * np.asarray(system.gravity))


def _violation(system: SpringSystem, x: np.ndarray, which: np.ndarray | slice) -> tuple[np.ndarray, np.ndarray]:
    """Length beyond rest [m] and direction of some springs."""
    edge = x[system.pairs[which, 1]] - x[system.pairs[which, 0]]
    length = np.linalg.norm(edge, axis=1)
    return length - system.rest_length[which], edge / np.maximum(length, 1e-12)[:, None]
