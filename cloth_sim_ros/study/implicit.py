# SPDX-License-Identifier: Apache-2.0
"""Converged implicit Euler and static equilibrium of a SpringSystem, by sparse Newton with a line search.

First-order XPBD converges to the step of implicit Euler with its iterations. The difference of the two is thus the
error of the iterations (Macklin, Mueller, Chentanez 2016).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import spsolve

from cloth_sim_ros.study.springs import SpringSystem

_ROUNDING = 1e-6  # of the weight of a particle, a force that is as good as none


def implicit_step(
    system: SpringSystem, x: np.ndarray, v: np.ndarray, h: float, tolerance: float = 1e-12
) -> tuple[np.ndarray, np.ndarray]:
    """Return positions and velocities after a step h [s]: M (x' - x - h v) / h^2 = f(x'), v' = (x' - x) / h.

    A dashpot resists tau k (l' - l) / h, the rate at which its spring's length l really changed, so that a rotation is
    never damped at any step. The step has converged if Newton moves no particle by more than `tolerance` [m].
    """
    before = system.lengths(x)[0]
    weight = np.asarray(system.gravity)
    drag = 1.0 + h * system.global_damping
    inertia = system.masses[:, None] / h**2
    mass = sparse.diags_array(np.repeat(system.masses * drag / h**2, 3)).tocsc()
    slope = system.constant * (1.0 + system.damping / h)

    def tension(length: np.ndarray) -> np.ndarray:
        return system.constant * (length - system.rest_length + system.damping / h * (length - before))

    def residual(new: np.ndarray) -> np.ndarray:
        length, n = system.lengths(new)
        return inertia * (drag * (new - x) - h * v - h**2 * weight) - system.pull(n, tension(length))

    def potential(new: np.ndarray) -> float:
        length = system.lengths(new)[0]
        dashpots = 0.5 * system.damping / h * (system.constant * (length - before) ** 2).sum()
        moved = new - x
        inert = (inertia * moved * (0.5 * drag * moved - h * v - h**2 * weight)).sum()
        return inert + dashpots + 0.5 * (system.constant * (length - system.rest_length) ** 2).sum()

    def matrix(new: np.ndarray, clamped: bool) -> sparse.csc_array:
        return mass + system.stiffness(new, tension(system.lengths(new)[0]), slope, clamped)

    start = np.where(system.fixed[:, None], x, x + h * v)
    new = _newton(system, residual, potential, matrix, start, tolerance)
    return new, (new - x) / h


def equilibrium(system: SpringSystem, x: np.ndarray, tolerance: float = 1e-12) -> np.ndarray:
    """Return positions (N, 3) at rest near x, where all forces on free particles vanish.

    Implicit steps of growing length from rest settle the system, as each of them dissipates; the last is so long that
    inertia is lost in rounding. Raises ArithmeticError if there is no rest to be found.
    """
    x = np.array(x, dtype=np.float64)
    for h in np.geomspace(1e-2, 1e6, 40):
        x = implicit_step(system, x, 0.0 * x, h, max(tolerance, 1e-12))[0]
    return x


def _newton(
    system: SpringSystem,
    residual: Callable[[np.ndarray], np.ndarray],
    potential: Callable[[np.ndarray], float],
    matrix: Callable[[np.ndarray, bool], sparse.csc_array],
    x: np.ndarray,
    tolerance: float,
) -> np.ndarray:
    """Return the root of `residual` over the free particles, by Newton's method from x.

    A Newton step that halves the residual is taken. Otherwise the direction comes from the clamped matrix, which is
    always downhill, halved until the potential falls. The method ends if a step would move no particle by more than
    `tolerance` [m], or if rounding hides a fall of the potential. Raises ArithmeticError if it stalls or does not
    converge.
    """
    free = np.flatnonzero(np.repeat(~system.fixed, 3))

    def norm(at: np.ndarray) -> float:
        return float(np.linalg.norm(residual(at).ravel()[free]))

    def direction(clamped: bool) -> np.ndarray:
        step = np.zeros(x.size)
        step[free] = spsolve(matrix(x, clamped)[free][:, free], -residual(x).ravel()[free])
        return step.reshape(x.shape)

    for _ in range(300):
        step = direction(clamped=False)
        if np.abs(step).max() < tolerance:
            return x + step
        if norm(x + step) < 0.5 * norm(x):
            x = x + step
            continue
        step = direction(clamped=True)
        shares = (share for share in 0.5 ** np.arange(30) if potential(x + share * step) < potential(x))
        share = next(shares, None)
        if share is None and norm(x) < _ROUNDING * np.linalg.norm(system.masses) * np.linalg.norm(system.gravity):
            return x
        if share is None:
            raise ArithmeticError(f"Newton's method stalls at a residual of {norm(x):g} N")
        x = x + share * step
    raise ArithmeticError(f"Newton's method did not converge: residual {norm(x):g} N")
