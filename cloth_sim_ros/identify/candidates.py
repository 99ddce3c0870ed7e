# SPDX-License-Identifier: Apache-2.0
"""Candidates: residuals of a scene against a recording for values of its parameters, a batch of worlds at a time."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np

from cloth_sim_ros.identify.observe import Observer
from cloth_sim_ros.identify.recording import Recording
from cloth_sim_ros.parameters import shown
from cloth_sim_ros.sim import Scene, Settings, Simulation

_DELAY = 0.1  # [s] of delay for 1 of its logarithmic scale: slopes are differences over 2 ms to either side
_ASIDE = 0.1  # factor of residuals along a surface at last, as they mislead near the best place, see identify.md
_RANGES = (30.0, 10.0, 3.0, 1.0)  # a parameter is sought within the first of these factors of its value that is allowed


@dataclasses.dataclass(frozen=True)
class Sought:
    """A live number of a scene to find between `low` and `high`, both above 0, on a logarithmic scale."""

    name: str
    low: float
    high: float

    @staticmethod
    def of(text: str, sim: Simulation) -> Sought:
        """Return the number that NAME or NAME=LOW:HIGH names. Raises ValueError in one sentence."""
        name, _, bounds = text.partition("=")
        value = sim.get(name)
        if np.ndim(value) or isinstance(value, (str, bool)) or name.startswith("solver."):
            raise ValueError(f"--fit names {name}, which is {shown(value)}; allowed is a live number of the scene")
        if not bounds:
            factor = next(factor for factor in _RANGES if _allows(sim, name, value * factor))
            low, high = value / factor, value * factor
        else:
            low, high = bounds_of(f"--fit {name}", bounds)
        if not 0.0 < low < high < np.inf:
            raise ValueError(f"--fit {text} is looked for from {low:g} to {high:g}; allowed is NAME=LOW:HIGH above 0")
        for bound in (low, high, value):
            sim.set(name, bound)
        return Sought(name, low, high)

    def shown(self, value: np.ndarray) -> np.ndarray:
        """Return found values as users read them."""
        return value


class Delay(Sought):
    """Delay of the observations, sought as the exponential of delay / 0.1 s, which makes its scale even."""

    @staticmethod
    def between(low: float, high: float) -> Delay:
        """Return a delay between two bounds [s]."""
        return Delay("delay", *np.exp(np.array([low, high]) / _DELAY))

    def shown(self, value: np.ndarray) -> np.ndarray:
        """Return the delays [s]."""
        with np.errstate(divide="ignore"):
            return _DELAY * np.log(value)


def bounds_of(what: str, bounds: str) -> tuple[float, float]:
    """Return two numbers from LOW:HIGH. The error names them as `what`. Raises ValueError in one sentence."""
    try:
        low, high = map(float, bounds.split(":"))
    except ValueError:
        raise ValueError(f"{what} is looked for within {bounds!r}; allowed are two numbers, LOW:HIGH") from None
    return low, high


def _allows(sim: Simulation, name: str, value: float) -> bool:
    try:
        sim.set(name, value)
    except ValueError:
        return False
    return True


def values_of(sought: Sequence[Sought], units: np.ndarray) -> np.ndarray:
    """Return sought values (K, P) from places (K, P) between their bounds in 0 to 1, on a logarithmic scale."""
    low, high = (np.log([getattr(each, end) for each in sought]) for end in ("low", "high"))
    return np.exp(low + np.asarray(units) * (high - low))


class Candidates:
    """A scene in `worlds` worlds, each with its own values of what is `sought`: live numbers, and last the delay if
    any.

    live: the sought numbers without the delay. All values are computed in the same substeps, those that the stiffest
    need. until: number of times of the recording that are looked at. frames: simulated so far. told: function that is
    called with them after each.
    """

    step = 0.02  # step of a logarithm to either side for slopes: far above float32 errors, far below curvature
    near = 1e-4  # tolerance of the descent before `refine`, as a share of the range

    def __init__(
        self, scene: Scene, settings: Settings, recording: Recording, fit: Sequence[str], worlds: int, device: str
    ) -> None:
        pair = Simulation(scene, settings, device, worlds=2)
        recording.check(pair)
        self.sought = [Sought.of(text, pair) for text in fit]
        names = [each.name for each in self.sought]
        if len(set(names)) < len(names):
            raise ValueError(f"--fit names {', '.join(names)}; allowed is each number once")
        self.live, self._asked, self.settings = list(self.sought), settings, _pinned(pair, self.sought)
        if recording.late:
            self.sought.append(Delay.between(*recording.late))
        self.recording, self.until, self.frames = recording, len(recording.times), 0
        self.told: Callable[[int], None] = lambda frames: None
        self._seen = [(name, rows, True) for name, rows in recording.positions.items()]
        self._seen += [(name, rows, False) for name, rows in recording.points.items()]
        self._scene, self._device = scene, device
        self._make(worlds, self.settings)
        longest = recording.times[-1] - min(recording.late or (0.0,))
        self.length = int(np.ceil(longest / self.settings.frame_dt - 1e-6))
        self.count = sum(
            int(np.isfinite(rows).all(axis=2).sum()) * (3 if ordered else 1) for _, rows, ordered in self._seen
        )

    def _make(self, worlds: int, settings: Settings) -> None:
        self.sim = Simulation(self._scene, settings, self._device, worlds=worlds)
        self._observers = [Observer(self.sim, *each) for each in self._seen]

    @property
    def worlds(self) -> int:
        """Number of candidates side by side."""
        return self.sim.worlds

    @property
    def times(self) -> np.ndarray:
        """Times (F,) [s] of the recording."""
        return self.recording.times

    def narrow(self, worlds: int) -> None:
        """Reduce the number of worlds to at most `worlds`: a batch takes the time of all, however few candidates it
        has."""
        if worlds < self.sim.worlds:
            how = self.how
            self._make(worlds, self.settings)
            self.how = how

    def values(self, units: np.ndarray) -> np.ndarray:
        """Return the sought values (K, P) from places (K, P) between their bounds in 0 to 1, on a logarithmic scale."""
        return values_of(self.sought, units)

    def squares(self, units: np.ndarray) -> np.ndarray:
        """Return the sums of squares (K, until) [m^2] of candidates (K, P) up to each time.

        They are infinite from the time on at which a world was put back.
        """
        return np.concatenate(self._all(self._parts(units), False)).cumsum(axis=1)

    def residuals(self, units: np.ndarray) -> np.ndarray:
        """Return the residuals (K, n) [m] of candidates (K, P) over the first `until` times."""
        return np.concatenate(self._all(self._parts(units), True))

    def error(self, units: np.ndarray) -> np.ndarray:
        """Return two changes (2, n) [m] of the residuals of candidate (P,).

        The first is that in the limit of many substeps (Richardson). The second is that by computing as the scene's
        settings say.
        """
        order = 1 if self.settings.method == "xpbd" and self.settings.order == 1 else 2
        coarse = self.residuals(units[None])[0]
        self.sim.set("solver.substeps", 2 * self.settings.substeps)
        fine = self.residuals(units[None])[0]
        self.sim.set("solver.substeps", self.settings.substeps)
        return np.stack([(fine - coarse) / (1.0 - 0.5**order), self._as_asked(units) - coarse])

    def _as_asked(self, units: np.ndarray) -> np.ndarray:
        """Return the residuals (n,) of candidate (P,), computed as the scene's settings say."""
        pinned, (_, worths, _) = (self.sim, self._observers), self.how
        self._make(self.sim.worlds, self._asked)
        for observer, worth in zip(self._observers, worths, strict=True):
            observer.worth = worth
        found = self.run(units[None], True)[0]
        self.sim, self._observers = pinned
        return found

    def by_frame(self, rows: np.ndarray) -> list[np.ndarray]:
        """Split the residuals (n,) of a candidate by observer, each (F, size)."""
        rows = rows.reshape(self.until, -1)
        return np.split(rows, np.cumsum([each.size for each in self._observers])[:-1], axis=1)

    def others(self, units: np.ndarray) -> np.ndarray:
        """Return further places (K, P) to descend from, near a good one (P,) but in other minima; here none."""
        return np.zeros((0, len(units)))

    def refine(self, ends: list[np.ndarray]) -> np.ndarray | None:
        """Judge more closely from now on near the first of good places (P,); return it, or None if nothing changes.

        Residuals along a surface lead near the best place. There they mislead if points are sparse or noisy, so they
        are scaled down.
        """
        if self.recording.points:
            self.settle(ends[0], _ASIDE)
        return ends[0] if self.recording.points else None

    def settle(self, units: np.ndarray, aside: float = 1.0) -> None:
        """Weigh the distances of unordered points by the residuals of a good candidate (P,), see Observer.settle."""
        for observer, rows in zip(self._observers, self.by_frame(self.residuals(units[None])[0]), strict=True):
            observer.settle(rows, aside)

    @property
    def how(self) -> tuple[int, list[tuple[float, float, float]], int]:
        """Criteria for candidates: number of substeps, `worth` of each observer, and `until`."""
        return self.sim.settings.substeps, [each.worth for each in self._observers], self.until

    @how.setter
    def how(self, value: tuple[int, list[tuple[float, float, float]], int]) -> None:
        if value[0] != self.sim.settings.substeps:
            self.sim.set("solver.substeps", value[0])
        for observer, worth in zip(self._observers, value[1], strict=True):
            observer.worth = worth
        self.until = value[2]

    def _parts(self, units: np.ndarray) -> list[np.ndarray]:
        return [units[k : k + self.sim.worlds] for k in range(0, len(units), self.sim.worlds)]

    def _all(self, parts: list[np.ndarray], keep: bool) -> list[np.ndarray]:
        """Return the result of `run` for each part."""
        return [self.run(part, keep) for part in parts]

    def run(self, units: np.ndarray, keep: bool) -> np.ndarray:
        """Simulate at most `worlds` candidates (K, P) side by side; worlds without one repeat the last.

        Return their residuals (K, n) [m] or, if not `keep`, sums of squares (K, until) [m^2] at each time.
        """
        values = self.values(units)
        rows = np.minimum(np.arange(self.sim.worlds), len(values) - 1)
        self.sim.reset()
        for k, each in enumerate(self.live):
            self.sim.set(each.name, values[rows, k])
        self._place()
        squares, bad = np.zeros((self.sim.worlds, self.until)), np.zeros(self.sim.worlds, dtype=bool)
        times = np.tile(self.recording.times[: self.until, None], self.sim.worlds)
        if self.recording.late:
            times -= self.sought[-1].shown(values[rows, -1])
        wanted = times / self.settings.frame_dt  # (F, worlds)
        ends = np.maximum(np.ceil(wanted - 1e-6), 1.0).astype(int)  # the frame that contains each time
        size = sum(observer.size for observer in self._observers)
        found = np.zeros((len(values), len(times), size) if keep else 0, dtype=np.float64)
        for frame in range(1, ends.max() + 1):
            self._step(frame - 1)
            bad |= self.sim.recovered()
            for f in np.flatnonzero((ends == frame).any(axis=1)).tolist():
                now = ends[f] == frame
                parts = [observer.residuals(f, wanted[f] - (frame - 1)) for observer in self._observers]
                for residuals in parts:
                    squares[now, f] += (residuals[now].astype(np.float64) ** 2).sum(axis=1)
                squares[now & bad, f] = np.inf
                if keep:
                    found[now[: len(values)], f] = np.concatenate(parts, axis=1)[: len(values)][now[: len(values)]]
        return found.reshape(len(values), -1) if keep else squares[: len(values)]

    def _place(self) -> None:
        """Put colliders and handles where they were at time 0, if the recording has poses then."""
        for name, rows in self.recording.pose.items():
            if self.recording.pose_times[0] == 0.0:
                self._mover(name)(name, rows[0, :3], rows[0, 3:], sweep=False)

    def _mover(self, name: str) -> Callable[..., None]:
        return self.sim.set_collider_pose if name in self.sim.scene.colliders else self.sim.set_handle_pose

    def _step(self, frame: int) -> None:
        """Simulate a frame, to the end of which colliders and handles move as recorded."""
        time = (frame + 1) * self.settings.frame_dt
        for name, rows in self.recording.pose.items():
            pose = [np.interp(time, self.recording.pose_times, column) for column in rows.T]
            self._mover(name)(name, pose[:3], pose[3:])
        for observer in self._observers:
            observer.keep()
        self.sim.step()
        self.frames += 1
        self.told(self.frames)


def _pinned(pair: Simulation, sought: Sequence[Sought]) -> Settings:
    """Return settings that compute all candidates alike: those chosen for worlds of the stiffest and the softest
    values."""
    for each in sought:
        pair.set(each.name, np.array([each.low, each.high]))
    settings, chosen = pair.settings, list(pair.choices.values())
    method = chosen[0].method if len({choice.method for choice in chosen}) == 1 else "xpbd"
    if method == "verlet":
        return dataclasses.replace(
            settings, method="verlet", order=0, iterations=0, substeps=max(choice.substeps for choice in chosen)
        )
    chosen = [choice for choice in chosen if choice.method == "xpbd"]
    order = chosen[0].order if len({choice.order for choice in chosen}) == 1 else 1
    substeps, iterations = (max(getattr(choice, part) for choice in chosen) for part in ("substeps", "iterations"))
    return dataclasses.replace(settings, method="xpbd", order=order, substeps=substeps, iterations=iterations)
