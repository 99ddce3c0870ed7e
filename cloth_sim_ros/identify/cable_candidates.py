# SPDX-License-Identifier: Apache-2.0
"""Candidates for the stiffness and damping of a cable, simulated with the recorded motion of its held markers in all
runs."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import warp as wp
from scipy.interpolate import CubicSpline

from cloth_sim_ros.identify.cable import Cable
from cloth_sim_ros.identify.cable_lag import lags as guessed_lags
from cloth_sim_ros.identify.cable_shape import as_numbers, fit_shape, from_numbers, headings, turn_between, turns
from cloth_sim_ros.identify.candidates import Sought, values_of
from cloth_sim_ros.identify.markers import Markers, bridged
from cloth_sim_ros.parameters import number
from cloth_sim_ros.sim import Handle, Scene, Settings, Simulation
from cloth_sim_ros.sim.input.numbers import Numbers
from cloth_sim_ros.sim.scene.forces import FORCES, Force

NAME = "cable"
_LONGEST = 1.0e-3  # length of a substep [s]
_GRAVITY = 9.81  # [m/s^2]
_REACH = 1.0e-3  # reach of the handle at a held marker [m]
_CORRECTIONS = 2  # number of corrections of positions and velocities at the start
_LONGER = 5.0e-3  # relative step of a length for its slopes
_ROBUST = 5.0e-3  # error [m] beyond which the model is wrong, not the camera
_LIGHTER = 5.0  # bound of the ratio of the mass to that of the given density, either way
_LAGS = 4  # number of sine waves along the cable that make up the lag of its material as a run begins
_LAG = 0.2  # usual amplitude of each [rad]
_SHARE = 0.05  # share of the usual force whose error counts as much as a distance of _ROBUST
# Bounds of sought numbers: rigidity over mass per length [m^4/s^2]; time of bending's dashpots [s]; drag relative to
# momentum [1/s]; torsional rigidity over mass per length [m^4/s^2].
_RIGIDITY, _DAMPING, _DRAG, _TORSION = (1e-4, 1.0), (1e-3, 1.0), (1e-2, 20.0), (1e-5, 3.0)
# Bounds of the end's turn [rad], one whole turn: 0 of a straight cable and half a turn of a U lie well within.
_TURNED = (-0.5 * math.pi, 1.5 * math.pi)
_TURNS = 12  # starts of a descent over that range, each with torsional rigidities of _TORSIONS times EI
_TORSIONS = (0.25, 1.0, 4.0)


@wp.func
def viscous_force(x: wp.vec3, v: wp.vec3, mass: float, numbers: Numbers) -> wp.vec4:
    """Return the force and the drag rate of `solver.global_damping`, here with a rate of its own in each world."""
    rate = numbers[0] * mass
    return wp.vec4(-rate * v[0], -rate * v[1], -rate * v[2], rate)


class Viscous(Force):
    """Drag on every particle, relative to its momentum [1/s]."""

    rows = (number("rate", 0.0, "Drag relative to momentum.", "1/s", 0, 1e4),)
    function = viscous_force


FORCES["viscous"] = Viscous


class Turn(Sought):
    """Turn [rad] of the end clamp beyond what the headings tell. The search uses its exponential, which is above 0."""

    def shown(self, value: np.ndarray) -> np.ndarray:
        """Return the angles [rad]."""
        with np.errstate(divide="ignore"):
            return np.log(value)


class CableCandidates:
    """Candidates for the bending, twist and drag of a cable, for fit.py. A world has one candidate in one run.

    together: number of candidates side by side. start: frames by which each run starts, see Markers.start; the frames
    from `first` on are compared. sought: numbers to find. times (F,): of the compared frames [s]. shaped: True to find
    the bends at rest and the offsets of the markers as well. lags (R, _LAGS): amplitudes [rad] of waves by which the
    material of each run lags at the start, beyond the guess of cable_lag.

    until: number of compared frames that are looked at. count: number of compared coordinates. alike: how many of these
    have the same model error, as it persists for about the time in which the cable swings. Raises ValueError for bad
    runs.
    """

    step = 0.1  # see Candidates; any small change moves a soft cable by 0.3 mm after 5 s

    def __init__(
        self, cable: Cable, markers: Markers, together: int, start: int, device: str, shaped: bool = False
    ) -> None:
        frames = markers.seen.shape[1]
        if not 2 <= start < frames:
            raise ValueError(f"--start is {start}; allowed are 2 frames up to those of the shortest run")
        if not 1 <= cable.held or 2 * cable.held >= markers.count:
            raise ValueError(
                f"--held is {cable.held} of {markers.count} markers; allowed is 1, or more that leave some"
            )
        there = np.isfinite(markers.seen)
        if not (there[:, :, cable.held_markers] | ~there.any(axis=(2, 3), keepdims=True)).all():
            raise ValueError("a held marker is not seen in a frame; allowed are recordings in which these always are")
        if not all(np.isfinite(each).all() for each in markers.forces or ()):
            raise ValueError("a force is not a number; allowed are recordings in which all are, or none is given")
        self.markers = markers = markers.filled(cable.held_markers)
        self.cable, self.first, self._device, self._shaped = cable, start, device, shaped
        self._seen, self._forces = markers.seen, None if markers.forces is None else np.stack(markers.forces)
        frames, self._hands = self._seen.shape[1], {m: bridged(self._seen[:, :, m]) for m in cable.held_markers}
        self.times = np.arange(1, frames - start + 1) / markers.rate
        self.until, self.frames, self.told = len(self.times), 0, lambda frames: None
        self.length = frames - start
        self.count = int(np.isfinite(self._seen[:, start:]).sum())
        self.count += 0 if self._forces is None else int(np.isfinite(self._forces[:, start:]).sum())
        self.sought = [
            Sought(f"{NAME}.bend_compliance", *(1.0 / (cable.density * each) for each in reversed(_RIGIDITY))),
            Sought(f"{NAME}.bend_damping", *_DAMPING),
            Sought("drag.rate", *_DRAG),
            Sought(f"{NAME}.twist_compliance", *(1.0 / (cable.density * each) for each in reversed(_TORSION))),
            *self._mass(),
            Turn(f"{NAME}.end_turn", *map(math.exp, _TURNED)),
        ]
        self.free = [m for m in range(markers.count) if m not in cable.held_markers]
        self.alike = 3 * len(self.free) * markers.rate * math.sqrt(cable.lengths.sum() / _GRAVITY)
        self._turned = {m: self._turns(m) for m in cable.held_markers}
        self._headings = headings(self._tangents(0)[:, 0])
        self.near = 0.1 if shaped else 1e-4  # see Candidates; fitting the shape changes all numbers anyway
        self.lags = np.zeros((len(self._seen), _LAGS))
        self._noise: np.ndarray | None = None
        self._kept: list[np.ndarray] | None = None
        self._make(together)

    def _make(self, together: int) -> None:
        middle = [math.sqrt(each.low * each.high) for each in self.sought]
        rope, runs = self.cable.rope(*middle[:2], middle[3]), len(self._seen)
        handles = {
            f"hand_{m}": Handle(position=tuple(rope.points[self.cable.markers[m]]), reach=_REACH, attached=True)
            for m in self.cable.held_markers
        }
        scene = Scene({NAME: rope}, handles=handles, forces={"drag": Viscous(rate=middle[2])})
        dt = 1.0 / self.markers.rate
        settings = Settings(frame_dt=dt, order=2, substeps=math.ceil(dt / _LONGEST), iterations=1)
        self.worlds = together
        self.sim = Simulation(scene, settings, self._device, worlds=runs * together)
        begin = [self.markers.start(run, self.first) for run in range(runs)]
        self._begin = np.tile(np.stack(begin, axis=1), (1, together, 1, 1))
        middles = 0.5 * (self.cable.places[1:] + self.cable.places[:-1])
        share = np.clip((middles - middles[0]) / (middles[-1] - middles[0]), 0.0, 1.0)
        self._waves = np.sin(math.pi * np.arange(1, _LAGS + 1)[:, None] * share)
        self._turns_between = np.array([turn_between(self._along(each[0], axis=0)) for each in begin])

    @property
    def has_forces(self) -> bool:
        """True if forces were recorded, which tell the mass."""
        return self._forces is not None

    def weighed(self, values: np.ndarray) -> Cable:
        """Return the cable, with the density that the forces tell if there are any."""
        if not self.has_forces:
            return self.cable
        return dataclasses.replace(self.cable, density=float(values[4] / self.cable.places[-1]))

    def _mass(self) -> list[Sought]:
        """Return the mass as a sought number if forces tell it, else nothing."""
        mass = self.cable.density * self.cable.places[-1]
        return [] if self._forces is None else [Sought(f"{NAME}.mass", mass / _LIGHTER, mass * _LIGHTER)]

    def _pulls(self, frame: int) -> np.ndarray:
        """Return the errors (worlds, 1, 3) of the force at the start's hand, scaled to a distance [m]."""
        hands = [self.sim.tensor(f"hand_{m}", "wrench").numpy()[:, :3] for m in range(self.cable.held)]
        off = np.sum(hands, axis=0) - np.tile(self._forces[:, frame], (self.worlds, 1))
        return (off * _ROBUST / (_SHARE * np.sqrt(np.nanmean((self._forces**2).sum(axis=2)))))[:, None]

    def _tangents(self, marker: int) -> np.ndarray:
        """Return the cable's unit tangents (R, F, 3) at a held marker; the world's z if one marker alone is held at
        each end."""
        held, hands = self.cable.held, list(self._hands.values())
        if held < 2:
            return np.broadcast_to([0.0, 0.0, 1.0], hands[0].shape)
        near, far = (0, 1) if marker < held else (-2, -1)
        edges = hands[far] - hands[near]
        return edges / np.linalg.norm(edges, axis=-1, keepdims=True)

    def _turns(self, marker: int) -> np.ndarray:
        """Return the orientations (R, F, 4) of the hand at a held marker, which turns with the tangent but not about
        it."""
        return turns(self._tangents(marker))

    @property
    def shape(self) -> np.ndarray:
        """Bends at rest and offsets of markers as numbers (S,), in units of their usual sizes."""
        offsets = np.zeros((len(self.free), 2)) if self.cable.offsets is None else self.cable.offsets
        return as_numbers(self.cable.bends, offsets)

    @shape.setter
    def shape(self, numbers: np.ndarray) -> None:
        bends, offsets = from_numbers(numbers)
        self.cable = dataclasses.replace(self.cable, bends=bends, offsets=offsets)

    def narrow(self, together: int) -> None:
        """Reduce the number of candidates side by side to at most `together`."""
        if together < self.worlds:
            self._make(together)

    def settle(self, units: np.ndarray) -> None:
        """Do nothing, as each marker is known by its number and needs no weighting (see Candidates.settle)."""

    def others(self, units: np.ndarray) -> np.ndarray:
        """Return the best (1, P) of places like candidate (P,), tried with _TURNS even turns of the end and all
        _TORSIONS.

        The misfit has several minima in the turn. In the wrong one the cable seems to resist no twist.
        """
        places = np.tile(units, (len(_TORSIONS), _TURNS, 1))
        compliance, twist = self.values(units[None])[0, 0], self.sought[3]
        soft = np.log(compliance / np.array(_TORSIONS) / twist.low) / np.log(twist.high / twist.low)
        places[..., 3] = np.clip(soft, 0.0, 1.0)[:, None]
        places[..., -1] = (np.arange(_TURNS) + 0.5) / _TURNS
        places = places.reshape(-1, len(units))
        return places[[self.squares(places)[:, -1].argmin()]]

    def refine(self, ends: list[np.ndarray]) -> np.ndarray:
        """Find `lags` and, if `shaped`, the shape near each of good candidates (P,); return the best.

        From then on, residuals weigh down errors that noise of the start, of the lengths and of the lags explains. They
        are whitened by their covariance (generalised least squares, Aitken 1935), which holds the noise of each marker
        and its effect through starts and lengths. The lengths between markers are corrected before: by the difference
        of spline lengths through the recorded markers and through the candidate's.
        """
        units, seen = self._best(ends), self._seen[:, self.first :]
        off = self.off(units[None])[0].swapaxes(0, 1)[:, :, : self.markers.count]
        was, now = (Markers(list(rows), self.markers.rate).lengths() for rows in (seen, seen + off))
        self._lengthen(was - now, self.worlds)
        still, noise, usual = self.off(units[None])[0], self.markers.noise(self.free), np.sqrt(np.nanmean(off**2))
        by_lags = self.off(np.tile(units, (_LAGS, 1)), lags=_LAG * np.eye(_LAGS)) - still
        for run, (rows, left) in enumerate(zip(self._a_run(by_lags), self._a_run(still[None])[..., 0], strict=True)):
            self.lags[run] = -_LAG * np.linalg.solve(rows.T @ rows + usual**2 * np.eye(_LAGS), rows.T @ left)
        still = self.off(units[None])[0]
        slopes = np.concatenate([self._by_starts(units, noise, still), self._by_lengths(units, noise, still), by_lags])
        shapes, sizes, _ = np.linalg.svd(self._a_run(slopes) / usual, full_matrices=False)
        self._noise = shapes * np.sqrt(1.0 - 1.0 / np.sqrt(1.0 + sizes**2))[:, None]
        return units

    def _best(self, ends: list[np.ndarray]) -> np.ndarray:
        """Return the best of candidates (P,), and set the shape fitted to it if `shaped`."""
        if not self._shaped:
            return ends[self.squares(np.stack(ends))[:, -1].argmin()]
        straight, found = self.shape, []
        for each in ends:
            self.shape = straight
            found.append((*fit_shape(self, each, roughly=True), self.shape))
        units, _, self.shape = min(found, key=lambda each: each[1])
        return fit_shape(self, units)[0]

    def _lengthen(self, more: np.ndarray, together: int) -> None:
        self.cable = dataclasses.replace(self.cable, lengths=self.cable.lengths + more)
        self._make(together)

    def _a_run(self, slopes: np.ndarray) -> np.ndarray:
        """Return changes (K, until, R, M, 3) of `off` as one matrix (n, K) for each run, (R, n, K); NaN becomes 0."""
        return np.nan_to_num(slopes).transpose(2, 1, 3, 4, 0).reshape(len(self._seen), -1, len(slopes))

    def _by_starts(self, units: np.ndarray, noise: float, still: np.ndarray) -> np.ndarray:
        """Return the changes (K, until, R, M, 3) of `off` by a usual error of each free marker's first position and
        velocity."""
        free, frames = self.free, self.first
        sizes = noise * np.array([1.0, self.markers.rate * math.sqrt(12.0 / (frames * (frames**2 - 1)))])
        moves = np.zeros((2, len(free), 3, 2, self.markers.count, 3))
        for part, marker, axis in np.ndindex(moves.shape[:3]):
            moves[part, marker, axis, part, free[marker], axis] = sizes[part]
        moves = moves.reshape(-1, *moves.shape[3:])
        return self.off(np.tile(units, (len(moves), 1)), moves) - still

    def _by_lengths(self, units: np.ndarray, noise: float, still: np.ndarray) -> np.ndarray:
        """Return the changes (M - 1, until, R, M, 3) of `off` by a usual error of each length between two markers."""
        cable, together, found = self.cable, self.worlds, []
        for longer in _LONGER * np.diag(cable.lengths):
            self._lengthen(longer, 1)
            found.append(self.off(units[None])[0])
            self.cable = cable
        self._make(together)
        error = noise * math.sqrt(2.0 / self._seen[:, :, 0, 0].size)
        return (np.array(found) - still) * (error / (_LONGER * cable.lengths))[:, None, None, None, None]

    def values(self, units: np.ndarray) -> np.ndarray:
        """Return the sought values (K, P) at places (K, P) between their bounds."""
        return values_of(self.sought, units)

    def off(
        self,
        units: np.ndarray,
        moves: np.ndarray | None = None,
        shapes: np.ndarray | None = None,
        lags: np.ndarray | None = None,
    ) -> np.ndarray:
        """Return the errors (K, until, R, M, 3) [m] of simulated markers, NaN where a marker was not seen.

        If forces were recorded, one more "marker" at the end holds their errors, scaled so that _SHARE of a usual force
        is _ROBUST.

        moves (K, 2, M, 3): additions to the positions [m] and velocities [m/s] of markers in the first frame. shapes
        (K, S): additions to `shape`. lags (K, _LAGS): additions to `lags` of all runs [rad].
        """
        shapes = np.zeros((len(units), 1)) if shapes is None else shapes
        moves = np.zeros((len(units), 1, 1, 1)) if moves is None else moves
        lags = np.zeros((len(units), 1)) if lags is None else lags
        parts = [slice(k, k + self.worlds) for k in range(0, len(units), self.worlds)]
        return np.concatenate([self._run(units[part], moves[part], shapes[part], lags[part]) for part in parts])

    def off_and_beside(self, units: np.ndarray, shapes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return `off` with `shapes`, and its derivatives (until, R, M, 3, 2) by the offsets of each marker.

        The derivatives are those of the first candidate: the two unit vectors along which a marker is offset.
        """
        self._kept, begun = [], (_CORRECTIONS + 1) * self.first
        off = self.off(units, shapes=shapes)
        kept, self._kept = self._kept[begun : begun + self.until], None
        return off, np.array(kept)

    def soft(self, off: np.ndarray) -> np.ndarray:
        """Return `off` as (K, n), with squares that grow only linearly with distances beyond _ROBUST (Huber 1964)."""
        off = np.nan_to_num(off).reshape(len(off), -1)
        return np.sign(off) * _ROBUST * np.sqrt(2.0 * (np.sqrt(1.0 + (off / _ROBUST) ** 2) - 1.0))

    def softness(self, off: np.ndarray) -> np.ndarray:
        """Return the derivatives (n,) of `soft` by `off` of one candidate."""
        root = np.sqrt(1.0 + (np.nan_to_num(off).ravel() / _ROBUST) ** 2)
        return np.isfinite(off).ravel() * np.sqrt(0.5 * (1.0 + root)) / root

    def residuals(self, units: np.ndarray) -> np.ndarray:
        """Return the residuals (K, n) [m]: `soft` of the errors, without what noise of the start and of lengths
        explains."""
        off = np.nan_to_num(self.off(units))
        if self._noise is not None:
            rows = off.swapaxes(1, 2).reshape(len(units), len(self._seen), -1)
            rows -= np.einsum("rnp,rmp,krm->krn", self._noise, self._noise, rows, optimize=True)
            off = rows.reshape(off.swapaxes(1, 2).shape).swapaxes(1, 2)
        return self.soft(off)

    def squares(self, units: np.ndarray) -> np.ndarray:
        """Return the sums of squares (K, until) [m^2] of residuals up to each frame."""
        return (self.residuals(units).reshape(len(units), self.until, -1) ** 2).sum(axis=2).cumsum(axis=1)

    def error(self, units: np.ndarray) -> np.ndarray:
        """Return the changes (1, n) [m] of residuals of candidate (P,) in the limit of many substeps (Richardson)."""
        coarse, substeps = self.residuals(units[None])[0], self.sim.settings.substeps
        self.sim.set("solver.substeps", 2 * substeps)
        fine = self.residuals(units[None])[0]
        self.sim.set("solver.substeps", substeps)
        return ((fine - coarse) / 0.75)[None]

    def _run(self, units: np.ndarray, moves: np.ndarray, shapes: np.ndarray, lags: np.ndarray) -> np.ndarray:
        """Return `off` of at most `worlds` candidates; worlds without one repeat the last."""
        runs, sim, filled = len(self._seen), self.sim, np.minimum(np.arange(self.worlds), len(units) - 1)
        values, moves = self.values(units)[filled], np.repeat(moves[filled], runs, axis=0).swapaxes(0, 1)
        sim.reset()
        for each, column in zip(self.sought[:-1], values.T[:-1], strict=True):
            sim.set(each.name, np.repeat(column, runs))
        turned = self._turns_between + self.sought[-1].shown(values[:, -1])[:, None]
        sim.set(self.sought[-1].name, np.remainder(turned + math.pi, 2.0 * math.pi).ravel() - math.pi)
        bends, offsets = from_numbers(self.shape + shapes[filled])
        self._offsets = np.repeat(offsets, runs, axis=0)
        rest = self.cable.rest_turns(bends)
        rest = np.einsum("kja,rba->krjb", rest, self._headings)
        sim.write(NAME, "rest_turns", rest.reshape(-1, *rest.shape[2:]))
        numbers = np.repeat([1.0 / values[:, 0], 1.0 / values[:, 3], values[:, 1]], runs, axis=1)
        self._begin_well(moves, numbers, (self.lags + lags[filled][:, None]).reshape(-1, _LAGS) @ self._waves)
        found = []
        for frame in range(self.first, self.first + self.until):
            off = [self._step(frame)] + ([] if self._forces is None else [self._pulls(frame)])
            found.append(np.concatenate(off, axis=1).reshape(self.worlds, runs, -1, 3))
        found = np.stack(found, axis=1)
        return found[: len(units)]

    def _begin_well(self, moves: np.ndarray, numbers: np.ndarray, lags: np.ndarray) -> None:
        """Simulate the first frames from positions and velocities with which the markers pass where they were seen.

        moves (2, worlds, M, 3): additions to these. numbers (3, worlds): those of cable_lag.lags, to whose result
        `lags` (worlds, S) are added. A line fitted to the errors in these frames corrects positions and velocities as
        if markers moved freely, so the correction is repeated.
        """
        begin, times = self._begin, np.arange(self.first) / self.markers.rate
        for correction in range(_CORRECTIONS + 1):
            if correction == _CORRECTIONS:
                begin = begin + moves
            self._hold(0, sweep=False)
            x, v = (self._along(part, axis=1) for part in begin)
            self.sim.write(NAME, "positions", x.astype(np.float32))
            self.sim.write(NAME, "velocities", v.astype(np.float32))
            self.sim.write(NAME, "lags", guessed_lags(x, v, numbers) + lags)
            off = [self._step(frame) for frame in range(1, self.first)]
            off = [begin[0] + self._beside() - np.tile(self._seen[:, 0], (self.worlds, 1, 1)), *off]
            if correction < _CORRECTIONS:
                line = np.polynomial.polynomial.polyfit(times, np.reshape(off, (self.first, -1)), 1)
                begin = begin - line.reshape(begin.shape)

    def _along(self, markers: np.ndarray, axis: int) -> np.ndarray:
        """Interpolate marker rows to all particles by splines along the cable."""
        return CubicSpline(self.cable.places[self.cable.markers], markers, axis=axis)(self.cable.places)

    def _step(self, frame: int) -> np.ndarray:
        """Simulate a frame; return the errors (worlds, M, 3) [m] of the markers at its end."""
        self._hold(frame, sweep=True)
        self.sim.step()
        self.frames += 1
        self.told(self.frames)
        seen = np.tile(self._seen[:, frame], (self.worlds, 1, 1))
        return self.sim.positions(NAME, None)[:, self.cable.markers] + self._beside() - seen

    def _beside(self) -> np.ndarray | float:
        """Return the offsets (worlds, M, 3) [m] of the markers from the cable's centreline; 0 if there are none."""
        if not self._offsets.any() and self._kept is None:
            return 0.0
        u = self.sim.directors(NAME, None)
        edges = np.diff(self.sim.positions(NAME, None).astype(np.float64), axis=1)
        at = self.cable.markers[self.free]
        t, u = edges[:, at - 1] + edges[:, at], u[:, at - 1] + u[:, at]
        t, u = (rows / np.linalg.norm(rows, axis=-1, keepdims=True) for rows in (t, u))
        both = np.stack([u, np.cross(t, u)], axis=-1) @ np.tile(self._headings, (self.worlds, 1, 1))[:, None]
        every = np.zeros((len(both), self.markers.count, 3, 2))
        every[:, self.free] = both
        if self._kept is not None:
            self._kept.append(every[: len(self._seen)])
        beside = np.zeros(every.shape[:3])
        beside[:, self.free] = np.einsum("wmca,wma->wmc", both, self._offsets)
        return beside

    def _hold(self, frame: int, sweep: bool) -> None:
        """Move the hands to the held markers of a frame, by the end of the next step or, without `sweep`, at once."""
        for m in self.cable.held_markers:
            places, turned = (
                np.tile(each, (self.worlds, 1)) for each in (self._hands[m][:, frame], self._turned[m][:, frame])
            )
            self.sim.set_handle_pose(f"hand_{m}", places, turned, sweep=sweep)
