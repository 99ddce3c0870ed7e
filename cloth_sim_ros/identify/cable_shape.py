# SPDX-License-Identifier: Apache-2.0
"""What a cable is like beside its stiffness: bent at rest, and with markers beside its middle, both in its material."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from cloth_sim_ros.sim.topology.rope import across, directors

PLACES = 4  # along the cable, between which the curvature at rest is linear
BENDS = PLACES + 2  # with turns at the two clamps
_STEPS, _FEW = 4, 3  # of Gauss and Newton at most, with slopes of one width
_LEAST = 0.01  # share by which a step lessens the misfit, or it was the last
_DAMPED = np.geomspace(1e-4, 30.0, 11)  # shares of the diagonal that are added (Marquardt 1963); a batch of worlds
_UNIT = 0.04  # times that width is the one by which slopes by a number between its bounds are found
_BENT = np.array([[1.0]] * PLACES + [[0.1]] * 2)  # usual curvature at rest [1/m], and turn of a clamp [rad]
_BESIDE = 0.01  # usual distance of a marker from the middle [m]
_ALONG = 0.99  # cosine beyond which a tangent is along an axis
# Of a usual bend, by which slopes are found, one after another. Narrow ones drown in what a soft cable does by chance.
_WIDTHS = (0.5, 0.2)


class Shaped(Protocol):
    """What fits a shape: see cable_candidates.CableCandidates."""

    shape: np.ndarray
    free: list[int]
    count: int
    alike: float

    def off(
        self, units: np.ndarray, moves: np.ndarray | None = None, shapes: np.ndarray | None = None
    ) -> np.ndarray: ...
    def off_and_beside(self, units: np.ndarray, shapes: np.ndarray) -> tuple[np.ndarray, np.ndarray]: ...
    def soft(self, off: np.ndarray) -> np.ndarray: ...
    def softness(self, off: np.ndarray) -> np.ndarray: ...


def turns(tangents: np.ndarray) -> np.ndarray:
    """Quaternions (..., F, 4) that turn the first of unit tangents (..., F, 3) to each, without turning about them."""
    found = np.zeros((*tangents.shape[:-1], 4))
    found[..., 0, 3] = 1.0
    for frame in range(1, tangents.shape[-2]):
        before, after = tangents[..., frame - 1, :], tangents[..., frame, :]
        v, w = np.cross(before, after), 1.0 + (before * after).sum(axis=-1, keepdims=True)
        u, c = found[..., frame - 1, :3], found[..., frame - 1, 3:]
        turned = np.concatenate([w * u + c * v + np.cross(v, u), w * c - (v * u).sum(axis=-1, keepdims=True)], axis=-1)
        found[..., frame, :] = turned / np.linalg.norm(turned, axis=-1, keepdims=True)
    return found


def headings(tangents: np.ndarray) -> np.ndarray:
    """(R, 2, 2): components along the rope's own two directors at its start, from those along the world's x and beside.

    tangents (R, 3): of the start, as the run begins. Grippers that turn little about their tangents hold a cable so
    that its material points the same way in all runs.
    """
    found = []
    for t in tangents:
        x, its = heading(t), np.stack([across(t), np.cross(t, across(t))])
        found.append(its @ np.stack([x, np.cross(t, x)]).T)
    return np.array(found)


def heading(t: np.ndarray) -> np.ndarray:
    """The unit vector (3,) across a unit tangent that is nearest to the world's x, or to y where that is along it."""
    x = np.array([1.0, 0.0, 0.0]) if abs(t[0]) < _ALONG else np.array([0.0, 1.0, 0.0])
    x = x - (x @ t) * t
    return x / np.linalg.norm(x)


def turn_between(points: np.ndarray) -> float:
    """Angle [rad] from the heading of the start of points (N, 3), carried to the end without twist, to that of the end.

    Clamps that keep their headings twist a cable by it, as one of them goes around the other.
    """
    tangents = np.diff(points, axis=0)
    tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
    t, u = tangents[-1], directors(tangents, heading(tangents[0]))[-1]
    return float(np.arctan2(np.cross(u, heading(t)) @ t, u @ heading(t)))


def fit_shape(candidates: Shaped, units: np.ndarray, roughly: bool = False) -> tuple[np.ndarray, float]:
    """Find bends at rest and distances of markers together with all numbers, from those at `units` (P,).

    They go into `candidates.shape`; returns the units and the misfit with its prior [m^2]. Steps are Gauss and
    Newton's, with a usual size as the prior. This counts as much as the `alike` numbers of which an error of the model
    makes the same. Where wide slopes lead no further, narrow ones do. roughly: a few steps only, to compare candidates
    by.
    """
    cost = np.inf
    for width in _WIDTHS[:1] if roughly else _WIDTHS:
        for _ in range(_FEW if roughly else _STEPS):
            units, was, cost = _step(candidates, units, width)
            if cost > (1.0 - _LEAST) * was:
                break
    return units, cost


def _step(candidates: Shaped, units: np.ndarray, width: float) -> tuple[np.ndarray, float, float]:
    """A step from candidate (P,) and its shape: where it ends, and its cost before and after.

    It is damped in several ways side by side. The best is taken, if it lessens the cost.
    """
    count, share, theta = len(units), candidates.alike / candidates.count, candidates.shape
    before, jacobian = _slopes(candidates, units, width)
    worth = share * (before @ before)
    cost = before @ before + worth * theta @ theta
    right = jacobian.T @ before
    right[count:] += worth * theta
    matrix = jacobian.T @ jacobian + np.diag([0.0] * count + [worth] * len(theta))
    moves = np.stack([-np.linalg.solve(matrix + damped * np.diag(np.diag(matrix)), right) for damped in _DAMPED])
    trials, shapes = units + moves[:, :count], moves[:, count:]
    trials[:, -1] %= 1.0  # a whole turn
    trials = np.clip(trials, 1e-3, 1.0 - 1e-3)
    costs = (candidates.soft(candidates.off(trials, shapes=shapes)) ** 2).sum(axis=1)
    costs += worth * ((theta + shapes) ** 2).sum(axis=1)
    best = costs.argmin()
    if costs[best] >= cost:
        return units, cost, cost
    candidates.shape = theta + shapes[best]
    return trials[best], cost, costs[best]


def _slopes(candidates: Shaped, units: np.ndarray, width: float) -> tuple[np.ndarray, np.ndarray]:
    """Residuals (n,) and their slopes (n, P + S) by all numbers and by those of the shape, bends of the width."""
    count, bent, free = len(units), 2 * BENDS, candidates.free
    rows = np.tile(units, (1 + count + bent, 1))
    rows[1 : 1 + count] += _UNIT * width * np.eye(count)
    shapes = np.zeros((len(rows), bent + 2 * len(free)))
    shapes[1 + count :, :bent] = width * np.eye(bent)
    off, by_offsets = candidates.off_and_beside(rows, shapes)
    soft = candidates.soft(off)
    steps = np.array([_UNIT * width] * count + [width] * bent)
    jacobian = (soft[1:] - soft[0]).T / steps[:, None].T
    beside = np.zeros((*off[0].shape, len(free), 2))
    for k, marker in enumerate(free):
        beside[:, :, marker, :, k] = by_offsets[:, :, marker]
    beside = _BESIDE * beside.reshape(off[0].size, -1) * candidates.softness(off[0])[:, None]
    return soft[0], np.concatenate([jacobian, beside], axis=1)


def as_numbers(bends: np.ndarray, offsets: np.ndarray) -> np.ndarray:
    """(S,) in usual sizes: bends (BENDS, 2), then offsets of free markers (F, 2) [m], see cable.Cable."""
    return np.concatenate([(bends / _BENT).ravel(), offsets.ravel() / _BESIDE])


def from_numbers(numbers: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The inverse of `as_numbers`."""
    bends, offsets = (part.reshape(*part.shape[:-1], -1, 2) for part in np.split(numbers, [2 * BENDS], axis=-1))
    return _BENT * bends, _BESIDE * offsets
