# SPDX-License-Identifier: Apache-2.0
"""Least-squares fit of values to a recording, with confidence intervals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares
from scipy.stats import qmc

from cloth_sim_ros.identify.candidates import Candidates

_MOST_POINTS = 20  # most points of a descent
_BEGINNINGS = (0.125, 0.25, 0.5)  # shares of a recording that are fitted before all of it
_ROUGHLY = 1e-2  # tolerance of these descents, as a share of the range
MOST_STEPS = 3 * _MOST_POINTS + 5  # most batches of worlds, each a point and its neighbours
_SPREAD = 1.96  # standard deviations to either end of a 95 % interval


@dataclass(frozen=True)
class Estimate:
    """The best fit. units (P,): its place between bounds. values (P,), with their 95 % intervals from low to high (P,).

    noise [m]: RMS of the residuals. rise: ratio of this RMS in the last quarter to that in the first. felt (P,) [m]:
    RMS change of the motion if a value doubles. alike (P, P): correlations of the errors.
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
    """Return the first good place (P,) between bounds, and the estimate. Raises ValueError if every candidate runs
    away."""
    count = len(candidates.sought)
    places = evenly(count, max(candidates.worlds, 16 * count), seed)
    squares = candidates.squares(places)
    if not np.isfinite(squares[:, -1]).any():
        raise ValueError("every candidate ran away; allowed are ranges in which the scene can be simulated")
    start = places[np.argmin(squares[:, -1])]
    candidates.narrow(1 + 2 * count)  # the candidates of one call of `slopes`
    candidates.settle(start)
    begun = by_beginnings(candidates, places, squares)
    ends = [by_least_squares(candidates, each, candidates.near) for each in (begun, *candidates.others(begun))]
    refined = candidates.refine(ends)
    return start, estimate(candidates, ends[0] if refined is None else by_least_squares(candidates, refined))


def evenly(numbers: int, count: int, seed: int = 0) -> np.ndarray:
    """Return at least `count` places (K, P) that fill the unit cube of so many numbers evenly (Sobol)."""
    return qmc.Sobol(numbers, seed=seed).random_base2(max(1, int(np.ceil(np.log2(count)))))


def by_beginnings(candidates: Candidates, places: np.ndarray, squares: np.ndarray) -> np.ndarray:
    """Return a place (P,) from which a descent ends well, from places (K, P) and their squares (K, F) up to each time.

    A sheet that buckles in another way leaves a misfit with many minima. The misfit of its beginning has one. So the
    fit follows the beginning first, and then ever more of the recording. The place with the least misfit over all of it
    wins.
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
    """Return that of two places (P,) with the smaller sum of squares."""
    return (one, other)[np.argmin(candidates.squares(np.stack([one, other]))[:, -1])]


def by_least_squares(candidates: Candidates, start: np.ndarray, tolerance: float = 1e-4) -> np.ndarray:
    """Descend from a start (P,) by scipy's trust region (Branch, Coleman and Li 1999); return the end (P,).

    Slopes are differences: each point and all its neighbours are one batch of worlds.
    """
    known: dict[bytes, tuple[np.ndarray, np.ndarray]] = {}

    def both(units: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        if units.tobytes() not in known:
            known.clear()
            known[units.tobytes()] = slopes(candidates, units)
        return known[units.tobytes()]

    if not both(start)[1].any():  # nothing depends on it, and scipy divides by its slopes
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
    """Return the residuals (n,) [m] of candidate (P,), and their slopes (n, P) by its place between the bounds."""
    count = len(units)
    step = candidates.step / np.log([each.high / each.low for each in candidates.sought])
    steps = np.concatenate([np.zeros((1, count)), np.diag(step), -np.diag(step)])
    rows = candidates.residuals(units + steps)
    return rows[0], ((rows[1 : 1 + count] - rows[1 + count :]) / (2.0 * step)[:, None]).T


def estimate(candidates: Candidates, units: np.ndarray) -> Estimate:
    """Return the values at the best place, with their intervals.

    The Gauss-Newton information matrix gives the covariance if the noise of all numbers is independent. If noise is
    shared within a frame, the sums of each frame's slopes give it (Liang and Zeger 1986). The larger of both variances
    counts. The interval is widened by the shift of the values with ever more substeps, or with those of the scene.
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
    """Return the RMS of the entries that are not 0, which are those that were seen."""
    return np.sqrt((rows**2).sum() / max(np.count_nonzero(rows), 1))
