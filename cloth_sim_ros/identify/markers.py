# SPDX-License-Identifier: Apache-2.0
"""Recordings of markers along a cable whose ends are moved, as motion capture writes them."""

from __future__ import annotations

import math
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline, PchipInterpolator

from cloth_sim_ros.identify.cable_bag import CableTopics

_FEWEST = 10  # frames of a run
_UNEVEN = 0.01  # largest share by which the time between two frames may differ from the mean
_DIFFERENCES = 6  # order of the differences in time that show noise
_MEDIAN = 0.6745  # median absolute deviation of normal noise, in standard deviations
_FARTHER = 1.6  # least move of held markers between two frames across a loss, over the moves around it
_UNLIKE = 0.6  # largest share of such a jump that a multiple of the motion around it leaves unexplained
_JUMP = 8.0  # least size of such a jump, in medians over all frames
_GAP = 0.25  # longest gap of lost frames [s] that the motion around it reveals
_POINTS = 9  # points along a spline between two markers, by which its length is measured


@dataclass(frozen=True)
class Markers:
    """Runs with the same cable: positions (F, M, 3) [m] of M markers from its start to its end, `rate` frames a second.

    A marker that was not seen is NaN. forces: (F, 3) [N] of each run, with which the cable pulls at the hand that holds
    its start; None if any run lacks them.
    """

    runs: list[np.ndarray]
    rate: float
    forces: list[np.ndarray] | None = None

    @staticmethod
    def read(
        paths: Sequence[Path],
        topics: CableTopics = CableTopics(),  # noqa: B008 (frozen)
        begin: float = 0.0,
        end: float = math.inf,
    ) -> Markers:
        """Read files of runs, or bags by their `topics`, and keep the part from `begin` to `end` [s] after the start of
        each.

        Raises ValueError in one sentence for files that cannot be read or do not belong together.

        An .npz file has one array (F, M, 3), or (R, F, M, 3) of several runs, in metres or in multiples of `unit` [m].
        Beside it is `rate` or `rate_hz` [1/s], or `times` (F,) [s]. A .csv file has rows of time [s], then x y z [m] of
        each marker, and at most one line of names above them. Forces at the start's hand [N] are an array `forces`, of
        the shape of one marker, or three last columns whose names are fx, fy, fz.
        """
        found = [(path, _cut(path, _read(path, topics), begin, end)) for path in paths]
        if not found:
            raise ValueError("no recording is given; allowed are .npz and .csv files of markers, and bags")
        first, (runs, rate, forces) = found[0]
        for path, (others, its_rate, its_forces) in found[1:]:
            if abs(its_rate / rate - 1.0) > _UNEVEN or others[0].shape[1] != runs[0].shape[1]:
                raise ValueError(
                    f"{path} has {others[0].shape[1]} markers at {its_rate:.4g} Hz, and {first} has "
                    f"{runs[0].shape[1]} at {rate:.4g} Hz; allowed are runs that agree"
                )
            runs = runs + others
            forces = None if forces is None or its_forces is None else forces + its_forces
        return Markers(runs, rate, forces)

    def split(self, share: int) -> tuple[Markers, Markers]:
        """Return the runs to fit, and the runs to judge by: the last 1 / `share` of all, at least one.

        Raises ValueError for one run.
        """
        if len(self.runs) < 2:
            raise ValueError("there is one run and nothing to judge by; allowed are several, or --judge RECORDING")
        kept = max(1, len(self.runs) // share)
        parts = slice(None, -kept), slice(-kept, None)
        return tuple(Markers(self.runs[part], self.rate, self.forces and self.forces[part]) for part in parts)

    def filled(self, held: Sequence[int]) -> Markers:
        """Return all runs with NaN in the frames that a recorder lost, each as long as the longest.

        held: markers that reveal lost frames: they jump several frames' way at once, along the motion before and after.
        Frames beyond the end of the shortest given run are left out.
        """
        numbers = [_frame_numbers(run[:, held], _GAP * self.rate) for run in self.seen]
        count = 1 + max(each[-1] for each in numbers)

        def spread(runs: list[np.ndarray]) -> list[np.ndarray]:
            found = [np.full((count, *run.shape[1:]), np.nan) for run in runs]
            for rows, run, each in zip(found, runs, numbers, strict=True):
                rows[each] = run[: len(each)]
            return found

        return Markers(spread(self.runs), self.rate, self.forces and spread(self.forces))

    @property
    def count(self) -> int:
        """Number of markers."""
        return self.runs[0].shape[1]

    @property
    def seen(self) -> np.ndarray:
        """Positions (R, F, M, 3) [m] of all runs, cut to the shortest."""
        frames = min(map(len, self.runs))
        return np.stack([run[:frames] for run in self.runs])

    def lengths(self) -> np.ndarray:
        """Return the lengths (M - 1,) [m] of cable between markers: means of splines in frames that show all markers.

        Raises ValueError if no frame shows all.
        """
        found = []
        for run in self.runs:
            for frame in run:
                if np.isfinite(frame).all():
                    places = _along(frame)
                    fine = np.linspace(places[:-1], places[1:], _POINTS, axis=1)
                    points = CubicSpline(places, frame)(fine)
                    found.append(np.linalg.norm(np.diff(points, axis=1), axis=2).sum(axis=1))
        if not found:
            raise ValueError("no frame shows all markers; allowed are recordings in which some do")
        return np.mean(found, axis=0)

    def noise(self, markers: Sequence[int]) -> float:
        """Return the standard deviation [m] of the noise of a coordinate of these markers, from a median.

        It is taken from sixth differences in time, in which a smooth motion is small.
        """
        rows = np.concatenate([np.diff(run[:, markers], _DIFFERENCES, axis=0).ravel() for run in self.runs])
        return float(np.nanmedian(np.abs(rows)) / (_MEDIAN * math.sqrt(math.comb(2 * _DIFFERENCES, _DIFFERENCES))))

    def start(self, run: int, frames: int) -> np.ndarray:
        """Return positions and velocities (2, M, 3) [m, m/s] in the first frame of a run, from its first `frames`
        frames.

        They are those of parabolas through these frames, or of lines through two. Raises ValueError if any of these
        frames lacks a marker.
        """
        seen = self.runs[run][:frames]
        if not np.isfinite(seen).all():
            raise ValueError(f"a marker is not seen in the first {frames} frames; allowed are runs in which all are")
        times = np.arange(frames) / self.rate
        powers = np.vander(times, min(3, frames), increasing=True)
        return np.linalg.lstsq(powers, seen.reshape(frames, -1), rcond=None)[0].reshape(-1, self.count, 3)[:2]


def bridged(rows: np.ndarray) -> np.ndarray:
    """Return rows (R, F, ...) with gaps interpolated smoothly; after the last known row they stay as it is."""
    found = np.empty_like(rows)
    for row, given in zip(found, rows, strict=True):
        known = np.flatnonzero(np.isfinite(given).reshape(len(given), -1).all(axis=1))
        row[:] = PchipInterpolator(known, given[known])(np.minimum(np.arange(len(given)), known[-1]))
    return found


def _frame_numbers(held: np.ndarray, longest: float) -> np.ndarray:
    """Return the numbers (F,) of frames with held markers (F, H, 3), counting lost frames in between.

    A jump of `longest` frames or more counts as none lost.
    """
    moves = np.diff(held, axis=0).reshape(len(held) - 1, -1)
    steps = np.ones(len(moves), dtype=int)
    if len(moves) > 2:
        before, now, behind = moves[:-2], moves[1:-1], moves[2:]
        usual, size = 0.5 * (before + behind), lambda rows: np.linalg.norm(rows, axis=1)
        times = (now * usual).sum(axis=1) / np.maximum(size(usual) ** 2, 1e-12)
        jump = size(now - usual)
        lost = (size(now) > _FARTHER * np.maximum(size(before), size(behind))) & (times < longest)
        lost &= (size(now - times[:, None] * usual) < _UNLIKE * jump) & (jump > _JUMP * np.median(jump))
        steps[1:-1][lost] = np.rint(times[lost])
    return np.concatenate([[0], np.cumsum(steps)])


def _along(frame: np.ndarray) -> np.ndarray:
    """Return the lengths (M,) [m] of the chords from the first marker to each."""
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(frame, axis=0), axis=1))])


_Read = tuple[list[np.ndarray], float, list[np.ndarray] | None]  # runs, frames a second, and forces


def _cut(path: Path, read: _Read, begin: float, end: float) -> _Read:
    """Keep the frames between two times [s]. Raises ValueError if fewer than _FEWEST remain."""
    runs, rate, forces = read
    span = (len(runs[0]) - 1) / rate
    if not 0.0 <= begin or not (min(end, span) - begin) * rate >= _FEWEST - 1 - _UNEVEN:
        raise ValueError(
            f"--begin is {begin:g} and --end {end:g} of {path}, which lasts {span:.3g} s; "
            f"allowed are times with {_FEWEST} frames between them"
        )
    kept = slice(math.ceil(begin * rate - _UNEVEN), math.floor(min(end, span) * rate + _UNEVEN) + 1)
    return [run[kept] for run in runs], rate, forces and [each[kept] for each in forces]


def _read(path: Path, topics: CableTopics) -> _Read:
    if path.is_dir():
        run, rate, forces = topics.read(path)
        return _checked([run], rate, path, None if forces is None else [forces])
    if topics.markers or topics.wrenches:
        raise ValueError(f"--markers and --wrench name topics, and {path} is no bag; allowed is the folder of one")
    return _read_npz(path) if path.suffix == ".npz" else _read_csv(path)


def _read_npz(path: Path) -> _Read:
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
    except (OSError, ValueError, zipfile.BadZipFile) as error:
        raise ValueError(f"{path} cannot be read: {error}") from None
    forces = arrays.pop("forces", None)
    markers = [a for a in arrays.values() if a.ndim in (3, 4) and a.shape[-1] == 3 and a.dtype.kind in "iuf"]
    if len(markers) != 1:
        raise ValueError(f"{path} has {len(markers)} arrays of markers; allowed is one, (F, M, 3) or (R, F, M, 3)")
    rate = next((float(arrays[name]) for name in ("rate", "rate_hz") if name in arrays), None)
    if rate is None:
        rate = _rate_of(arrays.get("times", np.zeros(0)), path)
    scaled = markers[0].astype(np.float64) * float(arrays.get("unit", 1.0))
    runs = list(scaled if scaled.ndim == 4 else scaled[None])
    if forces is not None:
        if forces.shape != scaled[..., 0, :].shape or forces.dtype.kind not in "iuf":
            raise ValueError(f"{path} has forces of shape {forces.shape}; allowed is {scaled[..., 0, :].shape}")
        forces = list(forces.astype(np.float64).reshape(len(runs), -1, 3))
    return _checked(runs, rate, path, forces)


def _read_csv(path: Path) -> _Read:
    try:
        with path.open() as file:
            names = [name.strip() for name in file.readline().split(",")]
        rows = np.genfromtxt(path, delimiter=",", dtype=np.float64)
    except (OSError, ValueError) as error:
        raise ValueError(f"{path} cannot be read: {str(error).splitlines()[0]}") from None
    rows = np.atleast_2d(rows)
    rows = rows[1:] if np.isnan(rows[0]).all() else rows  # the line of names
    rows, forces = (rows[:, :-3], [rows[:, -3:]]) if names[-3:] == ["fx", "fy", "fz"] else (rows, None)
    if rows.shape[1] < 7 or rows.shape[1] % 3 != 1:
        raise ValueError(f"{path} has {rows.shape[1]} columns; allowed are time, then x y z of each marker")
    return _checked([rows[:, 1:].reshape(len(rows), -1, 3)], _rate_of(rows[:, 0], path), path, forces)


def _rate_of(times: np.ndarray, path: Path) -> float:
    """Return the frames a second of times (F,) [s]. Raises ValueError if they do not rise evenly."""
    steps = np.diff(times)
    if len(steps) < 1 or not (np.abs(steps - steps.mean()) <= _UNEVEN * steps.mean()).all():
        raise ValueError(f"{path} has no even times; allowed are rate [Hz], or times [s] that rise evenly")
    return 1.0 / float(steps.mean())


def _checked(runs: list[np.ndarray], rate: float, path: Path, forces: list[np.ndarray] | None) -> _Read:
    if not 1.0 <= rate <= 1e4:
        raise ValueError(f"{path} has {rate:g} frames a second; allowed are 1 to 10000")
    frames, count = runs[0].shape[:2]
    if frames < _FEWEST or count < 4:
        raise ValueError(f"{path} has {frames} frames of {count} markers; allowed are at least {_FEWEST} of 4")
    return runs, rate, forces
