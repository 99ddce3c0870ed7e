# SPDX-License-Identifier: Apache-2.0
"""A cable in the motion that markers on it recorded: candidates for its stiffness and damping, in all runs at once."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.interpolate import CubicSpline

from cloth_sim_ros.identify.candidates import Sought, values_of
from cloth_sim_ros.identify.markers import Markers
from cloth_sim_ros.sim import Handle, Rope, Scene, Settings, Simulation, Wind

NAME = "cable"
_LONGEST = 1.0e-3  # length of a substep [s]
_PULL = 1.0e4  # stiffness EA [N]: cables hardly stretch in such motions
_AXIAL = 2.0e-3  # damping of stretch [s]
_REACH = 1.0e-3  # of the handle at a held marker [m]
_CORRECTIONS = 2  # of positions and velocities at the start
_LONGER = 5.0e-3  # share of a length, by which slopes are found
_ROBUST = 5.0e-3  # distance beyond which the cable is wrong, and not the camera [m]
# Bounds of what is found. Rigidity over mass per length [m^4/s^2]; time of bending's dashpots [s]; drag coefficient.
_RIGIDITY, _DAMPING, _DRAG = (1e-4, 1.0), (1e-3, 1.0), (0.05, 50.0)


@dataclass(frozen=True)
class Cable:
    """What is known of a cable before its recording is fitted.

    lengths: (M - 1,) [m] between its markers. held: markers at each end that follow the recording. between: segments
    between two markers that are not both held. density [kg/m], radius [m]. Only the ratio of rigidity and density is
    found from motion, and only that of drag and density.
    """

    lengths: np.ndarray
    held: int = 2
    between: int = 3
    density: float = 0.1
    radius: float = 0.004

    @cached_property
    def markers(self) -> np.ndarray:
        """(M,) particles at the markers."""
        count, ends = len(self.lengths), self.held - 1
        segments = [1 if k < ends or k >= count - ends else self.between for k in range(count)]
        return np.concatenate([[0], np.cumsum(segments)])

    @cached_property
    def places(self) -> np.ndarray:
        """(N,) distances of particles along the cable from its first marker [m]."""
        marks = np.concatenate([[0.0], np.cumsum(self.lengths)])
        return np.interp(np.arange(self.markers[-1] + 1), self.markers, marks)

    @cached_property
    def held_markers(self) -> list[int]:
        """Markers that follow the recording."""
        count = len(self.lengths) + 1
        return [*range(self.held), *range(count - self.held, count)]

    def rope(self, bend_compliance: float, bend_damping: float) -> Rope:
        """The cable, straight at rest."""
        points = np.zeros((len(self.places), 3))
        points[:, 0] = self.places
        return Rope(
            points=points,
            mass=self.density * self.places[-1],
            radius=self.radius,
            pins=None,
            stretch_compliance=1.0 / _PULL,
            damping=_AXIAL,
            bend_compliance=bend_compliance,
            bend_damping=bend_damping,
        )


class CableCandidates:
    """Candidates for the bending and drag of a cable, for fit.py. A world has one candidate in one run.

    together: candidates that move side by side. start: frames by which each run starts, see Markers.start. Those from
    `first` on are compared. sought: numbers that are found. times (F,): of the frames that are compared [s].
    until: how many of them are looked at. count: of numbers that are compared. Raises ValueError for bad runs.
    """

    def __init__(self, cable: Cable, markers: Markers, together: int, start: int, device: str) -> None:
        self._seen = markers.seen
        frames = self._seen.shape[1]
        if not 2 <= start < frames:
            raise ValueError(f"--start is {start}; allowed are 2 frames up to those of the shortest run")
        if not 1 <= cable.held or 2 * cable.held >= markers.count:
            raise ValueError(
                f"--held is {cable.held} of {markers.count} markers; allowed is 1, or more that leave some"
            )
        self.cable, self.first, self._markers, self._device = cable, start, markers, device
        if not np.isfinite(self._seen[:, :, cable.held_markers]).all():
            raise ValueError("a held marker is not seen in a frame; allowed are recordings in which these always are")
        self.times = np.arange(1, frames - start + 1) / markers.rate
        self.until, self.frames, self.told = len(self.times), 0, lambda frames: None
        self.length = frames - start
        self.count = int(np.isfinite(self._seen[:, start:]).sum())
        self.sought = [
            Sought(f"{NAME}.bend_compliance", *(1.0 / (cable.density * each) for each in reversed(_RIGIDITY))),
            Sought(f"{NAME}.bend_damping", *_DAMPING),
            Sought("wind.drag_coefficient", *_DRAG),
        ]
        self._free = [m for m in range(markers.count) if m not in cable.held_markers]
        self._noise: np.ndarray | None = None
        self._make(together)

    def _make(self, together: int) -> None:
        middle = [math.sqrt(each.low * each.high) for each in self.sought]
        rope, runs = self.cable.rope(*middle[:2]), len(self._seen)
        handles = {
            f"hand_{m}": Handle(position=tuple(rope.points[self.cable.markers[m]]), reach=_REACH, attached=True)
            for m in self.cable.held_markers
        }
        scene = Scene({NAME: rope}, handles=handles, wind=Wind(velocity=(0.0, 0.0, 0.0)))
        dt = 1.0 / self._markers.rate
        settings = Settings(frame_dt=dt, order=2, substeps=math.ceil(dt / _LONGEST), iterations=1)
        self.worlds = together
        self.sim = Simulation(scene, settings, self._device, worlds=runs * together)
        begin = [self._markers.start(run, self.first) for run in range(runs)]
        self._begin = np.tile(np.stack(begin, axis=1), (1, together, 1, 1))

    def narrow(self, together: int) -> None:
        """Go on with at most so many candidates side by side."""
        if together < self.worlds:
            self._make(together)

    def settle(self, units: np.ndarray) -> None:
        """Do nothing: markers are known by number, so that nothing is to be judged."""

    def refine(self, units: np.ndarray) -> bool:
        """Count less in residuals, from now on, what noise at the start and in lengths does near a good candidate (P,).

        Residuals are whitened by their covariance (generalised least squares, Aitken 1935). It has noise at each
        marker, and what this noise does to starts and lengths. Lengths between markers are corrected before by what
        splines through the candidate's markers miss of its own.
        """
        seen = self._seen[:, self.first :]
        off = self.off(units[None])[0].swapaxes(0, 1)
        was, now = (Markers(list(rows), self._markers.rate).lengths() for rows in (seen, seen + off))
        self._lengthen(was - now, self.worlds)
        still, noise = self.off(units[None])[0], self._markers.noise(self._free)
        slopes = [self._by_starts(units, noise, still), self._by_lengths(units, noise, still)]
        slopes = np.nan_to_num(np.concatenate(slopes))
        slopes = slopes.transpose(2, 1, 3, 4, 0).reshape(len(self._seen), -1, len(slopes))
        shapes, sizes, _ = np.linalg.svd(slopes / np.sqrt(np.nanmean(off**2)), full_matrices=False)
        self._noise = shapes * np.sqrt(1.0 - 1.0 / np.sqrt(1.0 + sizes**2))[:, None]
        return True

    def _lengthen(self, more: np.ndarray, together: int) -> None:
        self.cable = dataclasses.replace(self.cable, lengths=self.cable.lengths + more)
        self._make(together)

    def _by_starts(self, units: np.ndarray, noise: float, still: np.ndarray) -> np.ndarray:
        """(K, until, R, M, 3) changes of `off` by a usual error of the position and velocity of each free marker."""
        free, frames = self._free, self.first
        sizes = noise * np.array([1.0, self._markers.rate * math.sqrt(12.0 / (frames * (frames**2 - 1)))])
        moves = np.zeros((2, len(free), 3, 2, self._markers.count, 3))
        for part, marker, axis in np.ndindex(moves.shape[:3]):
            moves[part, marker, axis, part, free[marker], axis] = sizes[part]
        moves = moves.reshape(-1, *moves.shape[3:])
        return self.off(np.tile(units, (len(moves), 1)), moves) - still

    def _by_lengths(self, units: np.ndarray, noise: float, still: np.ndarray) -> np.ndarray:
        """(M - 1, until, R, M, 3) changes of `off` by a usual error of each length between two markers."""
        cable, together, found = self.cable, self.worlds, []
        for longer in _LONGER * np.diag(cable.lengths):
            self._lengthen(longer, 1)
            found.append(self.off(units[None])[0])
            self.cable = cable
        self._make(together)
        error = noise * math.sqrt(2.0 / self._seen[:, :, 0, 0].size)
        return (np.array(found) - still) * (error / (_LONGER * cable.lengths))[:, None, None, None, None]

    def values(self, units: np.ndarray) -> np.ndarray:
        """Values of what is sought, from places (K, P) between its bounds."""
        return values_of(self.sought, units)

    def off(self, units: np.ndarray, moves: np.ndarray | None = None) -> np.ndarray:
        """(K, until, R, M, 3) by how much markers are off the recording [m], not a number where one was not seen.

        moves (K, 2, M, 3): what is added to the positions [m] and velocities [m/s] of markers in the first frame.
        """
        moves = np.zeros((len(units), 1, 1, 1)) if moves is None else moves
        parts = [slice(k, k + self.worlds) for k in range(0, len(units), self.worlds)]
        return np.concatenate([self._run(units[part], moves[part]) for part in parts])

    def residuals(self, units: np.ndarray) -> np.ndarray:
        """(K, n) of `off`, frame after frame, whose squares grow like distances beyond _ROBUST (Huber 1964)."""
        off = np.nan_to_num(self.off(units))
        if self._noise is not None:
            rows = off.swapaxes(1, 2).reshape(len(units), len(self._seen), -1)
            rows -= np.einsum("rnp,rmp,krm->krn", self._noise, self._noise, rows, optimize=True)
            off = rows.reshape(off.swapaxes(1, 2).shape).swapaxes(1, 2)
        off = off.reshape(len(units), -1)
        return np.sign(off) * _ROBUST * np.sqrt(2.0 * (np.sqrt(1.0 + (off / _ROBUST) ** 2) - 1.0))

    def squares(self, units: np.ndarray) -> np.ndarray:
        """(K, until) sums of squares of residuals [m^2] up to each frame."""
        return (self.residuals(units).reshape(len(units), self.until, -1) ** 2).sum(axis=2).cumsum(axis=1)

    def error(self, units: np.ndarray) -> np.ndarray:
        """(1, n) by how much residuals of one candidate (P,) change towards ever more substeps, by Richardson."""
        coarse, substeps = self.residuals(units[None])[0], self.sim.settings.substeps
        self.sim.set("solver.substeps", 2 * substeps)
        fine = self.residuals(units[None])[0]
        self.sim.set("solver.substeps", substeps)
        return ((fine - coarse) / 0.75)[None]

    def _run(self, units: np.ndarray, moves: np.ndarray) -> np.ndarray:
        """As `off`, of at most `worlds` candidates; those that are fewer are filled up by the last."""
        runs, sim, filled = len(self._seen), self.sim, np.minimum(np.arange(self.worlds), len(units) - 1)
        values, moves = self.values(units)[filled], np.repeat(moves[filled], runs, axis=0).swapaxes(0, 1)
        sim.reset()
        for each, column in zip(self.sought, values.T, strict=True):
            sim.set(each.name, np.repeat(column, runs))
        self._begin_well(moves)
        found = np.empty((self.worlds, self.until, runs, self._markers.count, 3))
        for frame in range(self.until):
            found[:, frame] = self._step(self.first + frame).reshape(self.worlds, runs, -1, 3)
        return found[: len(units)]

    def _begin_well(self, moves: np.ndarray) -> None:
        """Simulate the first frames from the positions and velocities with which markers pass where they were seen.

        moves (2, worlds, M, 3) are added to these. A line through the distances in these frames corrects both, as if
        markers moved freely; so it is done again.
        """
        begin, times = self._begin, np.arange(self.first) / self._markers.rate
        for correction in range(_CORRECTIONS + 1):
            if correction == _CORRECTIONS:
                begin = begin + moves
            self._hold(0, sweep=False)
            for part, what in zip(begin, ("positions", "velocities"), strict=True):
                places = CubicSpline(self.cable.places[self.cable.markers], part, axis=1)(self.cable.places)
                self.sim.write(NAME, what, places.astype(np.float32))
            off = [begin[0] - np.tile(self._seen[:, 0], (self.worlds, 1, 1))]
            off += [self._step(frame) for frame in range(1, self.first)]
            if correction < _CORRECTIONS:
                line = np.polynomial.polynomial.polyfit(times, np.reshape(off, (self.first, -1)), 1)
                begin = begin - line.reshape(begin.shape)

    def _step(self, frame: int) -> np.ndarray:
        """(worlds, M, 3) [m] by how much markers are off at the end of a frame."""
        self._hold(frame, sweep=True)
        self.sim.step()
        self.frames += 1
        self.told(self.frames)
        seen = np.tile(self._seen[:, frame], (self.worlds, 1, 1))
        return self.sim.positions(NAME, None)[:, self.cable.markers] - seen

    def _hold(self, frame: int, sweep: bool) -> None:
        """Hands are at the held markers at the end of the next frame, or at once."""
        for m in self.cable.held_markers:
            places = np.tile(self._seen[:, frame, m], (self.worlds, 1))
            self.sim.set_handle_pose(f"hand_{m}", places, sweep=sweep)


def mean_error(off: np.ndarray) -> float:
    """Mean of |x - x_ref| [m] over frames, runs, markers that were seen (held ones too) and coordinates."""
    return float(np.nanmean(np.abs(off)))


def guesses(markers: Markers, start: int) -> dict[str, np.ndarray]:
    """Motions without a model, as `CableCandidates.off` (F, R, M, 3).

    "hold" keeps the shape of the start. "blend" moves each marker with both ends, by its share of the way between them.
    """
    seen = markers.seen.swapaxes(0, 1)
    first, later = seen[start - 1], seen[start:]
    share = np.linspace(0.0, 1.0, markers.count)[:, None]
    moved = (later - first)[:, :, :1] * (1.0 - share) + (later - first)[:, :, -1:] * share
    return {"hold": first - later, "blend": first + moved - later}
