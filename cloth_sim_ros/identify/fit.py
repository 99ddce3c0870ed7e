# SPDX-License-Identifier: Apache-2.0
"""The values that fit a recording best, and how well they are known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares
from scipy.stats import qmc

from cloth_sim_ros.identify.candidates import Candidates

_MOST_POINTS = 20  # of a descent
_BEGINNINGS = (0.125, 0.25, 0.5)  # of a recording, that are followed before all of it
_ROUGHLY = 1e-2  # of the range: how near the best place a beginning leads
MOST_STEPS = 3 * _MOST_POINTS + 5  # batches of worlds, where one holds a point and its neighbours
_SPREAD = 1.96  # standard deviations of an interval that holds 95 %


@dataclass(frozen=True)
class Estimate:
    """units (P,): the best place between bounds. values (P,); low, high (P,): where the value is, with 95 %.

    noise [m]: RMS of what is left. rise: how many times more that is in the last quarter than in the first. felt (P,)
    [m]: RMS of how the motion changes where a value doubles. alike (P, P): correlations of the errors.
    """

    units: np.ndarray
    values: np.ndarray
    low: np.ndarray
    high: np.ndarray
    noise: float
    rise: float
    felt: np.ndarray
    alike: np.ndarray


def identify(candidates: Candidates, seed: int = 0) -> tuple[np.ndarray, Estimate]:
    """The first good place (P,) between bounds, and the estimate. Raises ValueError where no candidate can be seen
    through."""
    count = len(candidates.sought)
    places = evenly(count, max(candidates.worlds, 16 * count), seed)
    squares = candidates.squares(places)
    if not np.isfinite(squares[:, -1]).any():
        raise ValueError("every candidate ran away; allowed are ranges in which the scene can be simulated")
    start = places[np.argmin(squares[:, -1])]
    candidates.narrow(1 + 2 * count)  # of which `slopes` asks at a time
    candidates.settle(start)
    begun = by_beginnings(candidates, places, squares)
    ends = [by_least_squares(candidates, each, candidates.near) for each in (begun, *candidates.others(begun))]
    refined = candidates.refine(ends)
    return start, estimate(candidates, ends[0] if refined is None else by_least_squares(candidates, refined))


def evenly(numbers: int, count: int, seed: int = 0) -> np.ndarray:
    """At least `count` places (K, P) that lie evenly between the bounds of so many numbers."""
    return qmc.Sobol(numbers, seed=seed).random_base2(max(1, int(np.ceil(np.log2(count)))))


def by_beginnings(candidates: Candidates, places: np.ndarray, squares: np.ndarray) -> np.ndarray:
    """A place (P,) from which the way down ends well, from places (K, P) and their squares (K, F) up to each time.

    A sheet that buckles in another way leaves a misfit with many minima. Its beginning has one, so that is followed
    first, and then ever more of the recording. What the whole of it likes better wins.
    """
    frames = len(candidates.times)
    found = places[np.argmin(squares[:, -1])]
    for share in _BEGINNINGS:
        candidates.until = max(1, round(share * frames))
        found = _better(candidates, found, places[np.argmin(squares[:, candidates.until - 1])])
        found = by_least_squares(candidates, found, _ROUGHLY)
    candidates.until = frames
    return _better(candidates, found, places[np.argmin(squares[:, -1])])


def _better(candidates: Candidates, one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """That of two places (P,) whose squares are less."""
    return (one, other)[np.argmin(candidates.squares(np.stack([one, other]))[:, -1])]


def by_least_squares(candidates: Candidates, start: np.ndarray, tolerance: float = 1e-4) -> np.ndarray:
    """From a start (P,) downhill by scipy's trust region (Branch, Coleman and Li 1999); slopes are by differences, each
    point with all its neighbours in one batch of worlds."""
    known: dict[bytes, tuple[np.ndarray, np.ndarray]] = {}

    def both(units: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        if units.tobytes() not in known:
            known.clear()
            known[units.tobytes()] = slopes(candidates, units)
        return known[units.tobytes()]

    if not both(start)[1].any():  # nothing feels it, and scipy divides by its slopes
        return start
    found = least_squares(
        lambda units: both(units)[0],
        start,
        lambda units: both(units)[1],
        bounds=(0.0, 1.0),
        x_scale="jac",
        xtol=tolerance,
        ftol=1e-8,
        gtol=None,
        max_nfev=_MOST_POINTS,
    )
    return found.x


def slopes(candidates: Candidates, units: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Residuals (n,) [m] of one candidate (P,), and their slopes (n, P) by its place between the bounds."""
    count = len(units)
    step = candidates.step / np.log([each.high / each.low for each in candidates.sought])
    steps = np.concatenate([np.zeros((1, count)), np.diag(step), -np.diag(step)])
    rows = candidates.residuals(units + steps)
    return rows[0], ((rows[1 : 1 + count] - rows[1 + count :]) / (2.0 * step)[:, None]).T


def estimate(candidates: Candidates, units: np.ndarray) -> Estimate:
    """What is known of the values at the best place.

    The slopes of the misfit tell it, as by Gauss and Newton, where what is left is noise on its own at every number. It
    may be shared within a frame, which the sum of each frame's slopes tells (Liang and Zeger 1986). The larger counts.
    To that comes by how much other values would fit with ever more substeps, or with those of the scene.
    """
    width = np.log([each.high / each.low for each in candidates.sought])
    left, jacobian = slopes(candidates, units)
    jacobian = jacobian / width  # by the logarithm of a value
    noise2 = (left**2).sum() / max(candidates.count - len(units), 1)
    information = jacobian.T @ jacobian
    inverse = np.linalg.pinv(information, rcond=1e-12, hermitian=True)
    pulls = (jacobian * left[:, None]).reshape(len(candidates.times), -1, len(units)).sum(axis=1)
    by_frames = inverse @ (pulls.T @ pulls) @ inverse
    covariance = np.maximum(noise2 * np.diag(inverse), np.diag(by_frames))
    deviation = np.where(np.diag(information) > 0.0, np.sqrt(covariance), np.inf)
    scale = np.sqrt(np.maximum(np.diag(inverse), 1e-300))
    values = candidates.values(units)
    shifts = np.abs(inverse @ jacobian.T @ candidates.error(units).T).max(axis=1)
    with np.errstate(over="ignore"):
        factor = np.exp(_SPREAD * deviation + shifts)
    felt = np.log(2.0) * np.sqrt(np.diag(information) / candidates.count)
    alike = inverse / np.outer(scale, scale)
    rows = left.reshape(candidates.until, -1)
    quarter = -(-len(rows) // 4)
    rise = float(_rms(rows[-quarter:]) / max(_rms(rows[:quarter]), 1e-30))
    return Estimate(units, values, values / factor, values * factor, float(np.sqrt(noise2)), rise, felt, alike)


def _rms(rows: np.ndarray) -> float:
    """Of what was seen, which is not 0."""
    return np.sqrt((rows**2).sum() / max(np.count_nonzero(rows), 1))
