# SPDX-License-Identifier: Apache-2.0
"""Guess how far the material of a cable lags behind its balance of twist at the start, from its motion then."""

from __future__ import annotations

import numpy as np

from cloth_sim_ros.sim.topology.rope import across, directors

_LASTED = 0.15  # time constant [s] for which the motion is taken to have lasted
_LATER = 1.0e-4  # time over which rates are found [s]


def lags(points: np.ndarray, velocities: np.ndarray, numbers: np.ndarray) -> np.ndarray:
    """Return the angles (W, S) [rad] of a cable's segments beyond their balance, see Simulation.write.

    points, velocities (W, N, 3) [m, m/s]. numbers (3, W): EI, GJ [N m^2], and the time of the dashpots [s]. Clamps hold
    the first segment and the last, which turn without lag.

    In balance a cable that is straight at rest is twisted evenly. Angles beyond it obey K lag + tau (K + M) lag' = -f.
    K is the stiffness of twist. M is that of bends against cross-sections that turn about the cable. f is the torque of
    the dashpots on a material that turns in balance. With lag' = lag / _LASTED this is one linear system.
    """
    edges = np.diff(points, axis=1)
    lengths = np.linalg.norm(edges, axis=2)
    bent, spun, twisting = _rates(edges, np.diff(velocities, axis=1))
    rigidity, torsion, time = np.reshape(numbers, (3, -1, 1))
    twisted = lengths.copy()
    twisted[:, [0, -1]] = 0.0  # in clamps
    stiff = 2.0 * torsion / (twisted[:, 1:] + twisted[:, :-1])
    weight = 2.0 * rigidity / (lengths[:, 1:] + lengths[:, :-1])
    apart = np.diff(np.eye(lengths.shape[1]), axis=0)
    mean = 0.5 * np.abs(apart)
    stiffness = np.einsum("ji,wj,jk->wik", apart, stiff, apart)
    damped = time[..., None] * (stiffness + np.einsum("ji,wj,jk->wik", mean, weight * bent, mean))
    middles = np.cumsum(twisted, axis=1) - 0.5 * twisted
    turning = twisting[:, None] * middles / middles[:, -1:]
    pulls = np.einsum("wik,wk->wi", damped, turning) - time * ((weight * spun) @ mean)
    found = np.zeros_like(lengths)
    matrix = (stiffness + damped / _LASTED)[:, 1:-1, 1:-1]
    found[:, 1:-1] = -np.linalg.solve(matrix, pulls[:, 1:-1, None])[..., 0]
    return found


def _rates(edges: np.ndarray, rates: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return squared turns (W, J) [-] of all joints, these times rates [1/s], and the rate (W,) [1/s] of the total
    twist.

    The rates in the second are those at which turns go about the cable, against directors carried along from the start.
    """
    tangents = np.stack([edges, edges + _LATER * rates])
    tangents /= np.linalg.norm(tangents, axis=-1, keepdims=True)
    first = np.array([across(t) for t in tangents[0, :, 0]])
    now = directors(tangents[0], first)
    later = directors(tangents[1], _across(tangents[1, :, 0], first))
    carried, turns = np.stack([now, later]), np.diff(tangents, axis=2)
    one, along = (_unit(rows[:, :, 1:] + rows[:, :, :-1]) for rows in (carried, tangents))
    x, y = ((turns * each).sum(axis=-1) for each in (one, np.cross(along, one)))
    end = _across(tangents[1, :, -1], now[:, -1])
    twisted = (np.cross(later[:, -1], end) * tangents[1, :, -1]).sum(axis=-1)
    return x[0] ** 2 + y[0] ** 2, (x[0] * y[1] - y[0] * x[1]) / _LATER, twisted / _LATER


def _across(tangents: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Return the unit vectors (W, 3) across tangents (W, 3) that are nearest to vectors (W, 3)."""
    return _unit(vectors - (vectors * tangents).sum(axis=-1, keepdims=True) * tangents)


def _unit(rows: np.ndarray) -> np.ndarray:
    return rows / np.linalg.norm(rows, axis=-1, keepdims=True)
