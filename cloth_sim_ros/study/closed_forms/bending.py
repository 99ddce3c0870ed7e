# SPDX-License-Identifier: Apache-2.0
"""Bending and twist: cantilevers, the heavy elastica, buckling, Michell's ring, Greenhill's rod.

The discrete counterpart is a chain of n rigid segments of length a. It has a rotational spring EI / a at each joint and
2 EI / a at a clamp, which holds half a segment (Hencky 1920).
"""

from __future__ import annotations

import numpy as np
from scipy.integrate import solve_bvp
from scipy.optimize import root


def cantilever_tip(length, flexural_rigidity, load=0.0, weight=0.0):
    """Small deflection [m] of the tip: P L^3 / 3 EI + w L^4 / 8 EI, P [N], w [N/m] (Timoshenko and Gere, chapter 9)."""
    return load * length**3 / (3.0 * flexural_rigidity) + weight * length**4 / (8.0 * flexural_rigidity)


def cantilever_chain_tip(lengths_below, loads, segment, flexural_rigidity):
    """Small deflection [m] of the last particle of a clamped chain of n segments [m], loads (n,) [N] on its particles.

    Each joint turns by M_j / kappa_j, M_j the moment of all loads beyond it. `lengths_below` (n,) [m] are the
    particles' distances from the clamp.
    """
    x, loads = np.asarray(lengths_below, dtype=np.float64), np.asarray(loads, dtype=np.float64)
    joints = np.concatenate([[0.0], x[:-1]])
    moments = (loads[None, :] * np.clip(x[None, :] - joints[:, None], 0.0, None)).sum(axis=1)
    turns = moments * segment / flexural_rigidity
    turns[0] *= 0.5
    return segment * np.cumsum(turns).sum()


def heavy_elastica(length, flexural_rigidity, weight, count=101):
    """(count, 2) points [m] (out, down) of a clamped, horizontal, inextensible rod under its own weight w [N/m].

    EI theta'' = -w (L - s) cos(theta), theta(0) = 0, theta'(L) = 0, theta the angle below the horizontal [rad].
    Source: Bickley, The heavy elastica, Philosophical Magazine 17 (1934).
    """

    def slope(s, y):
        return np.stack([y[1], -weight * (length - s) * np.cos(y[0]) / flexural_rigidity, np.cos(y[0]), np.sin(y[0])])

    def ends(clamp, tip):
        return np.array([clamp[0], tip[1], clamp[2], clamp[3]])

    s = np.linspace(0.0, length, 101)
    guess = np.zeros((4, len(s)))
    guess[0] = np.clip(weight * length**2 * s / (6.0 * flexural_rigidity), 0.0, 1.5)
    guess[2] = s
    found = solve_bvp(slope, ends, s, guess, tol=1e-9, max_nodes=100_000)
    if not found.success:
        raise ArithmeticError(f"the elastica was not found: {found.message}")
    return found.sol(np.linspace(0.0, length, count))[2:].T


def heavy_chain(segment, flexural_rigidity, loads):
    """(n+1, 2) points [m] (out, down) of a clamped, horizontal chain under `loads` (n,) [N] on its particles.

    Joint j: kappa_j (theta_j+1 - theta_j) = sum of the moments of the loads beyond it, at any deflection.
    """
    loads = np.asarray(loads, dtype=np.float64)
    count = len(loads)
    kappa = np.full(count, flexural_rigidity / segment)
    kappa[0] *= 2.0
    carried = np.cumsum(loads[::-1])[::-1]

    def imbalance(angles):
        # The moment about the foot of segment j of the loads beyond is sum over segments i >= j of a cos(theta_i)
        # carried_i.
        moments = np.cumsum((segment * np.cos(angles) * carried)[::-1])[::-1]
        return kappa * np.diff(angles, prepend=0.0) - moments

    found = root(imbalance, np.zeros(count), tol=1e-13)
    if np.abs(found.fun).max() > 1e-8 * segment * carried[0] * count:
        raise ArithmeticError(f"the bent chain was not found: {found.message}")
    steps = segment * np.stack([np.cos(found.x), np.sin(found.x)], axis=1)
    return np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])


def euler_buckling(length, flexural_rigidity, effective=1.0):
    """Critical load [N] pi^2 EI / (K L)^2; K = `effective`: 1 pinned, 2 clamped and free, 0.5 clamped (Euler 1744)."""
    return np.pi**2 * flexural_rigidity / (effective * length) ** 2


def euler_buckling_chain(segment, flexural_rigidity, segments):
    """Critical load [N] of a pinned chain: (4 EI / a^2) sin^2(pi / 2n) (Hencky 1920)."""
    return 4.0 * flexural_rigidity / segment**2 * np.sin(np.pi / (2 * segments)) ** 2


def michell_twist(flexural_rigidity, torsional_rigidity):
    """Total twist [rad] 2 pi sqrt(3) EI / GJ at which a straight rod closed to a ring leaves its plane (Michell
    1889)."""
    return 2.0 * np.pi * np.sqrt(3.0) * flexural_rigidity / torsional_rigidity


def greenhill_moment(flexural_rigidity, tension):
    """Twisting moment [N m] 2 sqrt(EI T) at which a long straight rod under `tension` [N] buckles (Greenhill 1883)."""
    return 2.0 * np.sqrt(flexural_rigidity * tension)
