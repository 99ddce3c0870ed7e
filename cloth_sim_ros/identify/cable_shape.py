# SPDX-License-Identifier: Apache-2.0
"""Shape of a cable at rest: its bends, and the offsets of markers from its centreline, both fixed in its material."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from cloth_sim_ros.sim.topology.rope import across, directors

PLACES = 4  # points along the cable between which the curvature at rest is linear
BENDS = PLACES + 2  # with turns at the two clamps
_STEPS, _FEW = 4, 3  # most Gauss-Newton steps with slopes of one width: in full, roughly
_LEAST = 0.01  # least relative decrease of the misfit by a step, below which it was the last
_DAMPED = np.geomspace(1e-4, 30.0, 11)  # shares of the diagonal to add (Marquardt 1963), tried in one batch of worlds
_UNIT = 0.04  # step of a number between its bounds, over that width
_BENT = np.array([[1.0]] * PLACES + [[0.1]] * 2)  # usual curvature at rest [1/m], and turn of a clamp [rad]
_BESIDE = 0.01  # usual distance of a marker from the middle [m]
_ALONG = 0.99  # cosine beyond which a tangent is along an axis
# Steps of a usual bend for slopes, one after another. Narrow ones drown in the chance motion of a soft cable.
_WIDTHS = (0.5, 0.2)


class Shaped(Protocol):
    """Interface of candidates whose shape is fitted: see cable_candidates.CableCandidates."""

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
    """Return quaternions (..., F, 4) that turn the first of unit tangents (..., F, 3) to each, without turning about
    them."""
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
    """Return matrices (R, 2, 2) from components along a run's `heading` to those along the rope's own directors.

    tangents (R, 3): those at the start of the rope as each run begins. The two axes of either kind are a unit vector
    across the tangent, and one across both. Grippers that turn little about their tangents hold a cable so that its
    material points the same way in all runs.
    """
    found = []
    for t in tangents:
        x, its = heading(t), np.stack([across(t), np.cross(t, across(t))])
        found.append(its @ np.stack([x, np.cross(t, x)]).T)
    return np.array(found)


def heading(t: np.ndarray) -> np.ndarray:
    """Return the unit vector (3,) across unit tangent t that is nearest to the world's x, or to y if t is along x."""
    x = np.array([1.0, 0.0, 0.0]) if abs(t[0]) < _ALONG else np.array([0.0, 1.0, 0.0])
    x = x - (x @ t) * t
    return x / np.linalg.norm(x)


def turn_between(points: np.ndarray) -> float:
    """Return the angle [rad] between the heading of the end and that of the start carried there without twist.

    points (N, 3) are those of the cable. Clamps that keep their headings twist a cable by this angle, as one of them
    goes around the other.
    """
    tangents = np.diff(points, axis=0)
    tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
    t, u = tangents[-1], directors(tangents, heading(tangents[0]))[-1]
    return float(np.arctan2(np.cross(u, heading(t)) @ t, u @ heading(t)))


def fit_shape(candidates: Shaped, units: np.ndarray, roughly: bool = False) -> tuple[np.ndarray, float]:
    """Fit bends at rest, offsets of markers and all numbers together, from those at `units` (P,).

    Set `candidates.shape`; return the units and the misfit with its prior [m^2]. The method is Gauss-Newton with a
    prior of the usual sizes. The prior weighs as much as the `alike` numbers that share one model error. Slopes are
    taken over wide steps first and over narrow ones at last. roughly: True for a few wide steps only, to compare
    candidates.
    """
    cost = np.inf
    for width in _WIDTHS[:1] if roughly else _WIDTHS:
        for _ in range(_FEW if roughly else _STEPS):
            units, was, cost = _step(candidates, units, width)
            if cost > (1.0 - _LEAST) * was:
                break
    return units, cost


def _step(candidates: Shaped, units: np.ndarray, width: float) -> tuple[np.ndarray, float, float]:
    """Take a step from candidate (P,) and its shape; return its end, and the cost before and after.

    It tries several dampings side by side and takes the best, if it lowers the cost.
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
    """Return residuals (n,) and their slopes (n, P + S) by all numbers and by those of the shape.

    width: step of each bend in its usual size, over which slopes are taken.
    """
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
    """Return bends (BENDS, 2) and offsets of free markers (F, 2) [m] as (S,) in units of their usual sizes, see
    cable.Cable."""
    return np.concatenate([(bends / _BENT).ravel(), offsets.ravel() / _BESIDE])


def from_numbers(numbers: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return bends and offsets from numbers (..., S): the inverse of `as_numbers`."""
    bends, offsets = (part.reshape(*part.shape[:-1], -1, 2) for part in np.split(numbers, [2 * BENDS], axis=-1))
    return _BENT * bends, _BESIDE * offsets
