# SPDX-License-Identifier: Apache-2.0
"""Observations of a scene: particles or points over time, and the motion of colliders and handles."""

from __future__ import annotations

import zipfile
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from cloth_sim_ros.sim import Simulation

_KINDS = {"positions": 3, "points": 3, "pose": 7}  # kind -> columns
_MOST_DELAY = 10.0  # [s]
_TIMES = ("times", "pose_times")


@dataclass(frozen=True)
class Recording:
    """Observations at `times` (F,) [s], which rise; the scene starts at 0.

    positions: object -> (F, N, 3) [m], its particles in order, NaN where they were not seen. points: object -> (F, M,
    3) [m], points anywhere on it in any order, likewise. pose: collider or handle -> (F, 7), x y z [m] and x y z w of
    its orientation, reached at `pose_times` (F,), which are `times` unless given. late: bounds [s] of the delay of all
    times but those of poses; the fit finds one delay between them. Raises ValueError for arrays that do not fit.
    """

    times: np.ndarray
    positions: dict[str, np.ndarray] = field(default_factory=dict)
    points: dict[str, np.ndarray] = field(default_factory=dict)
    pose: dict[str, np.ndarray] = field(default_factory=dict)
    pose_times: np.ndarray | None = None
    late: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        for which in _TIMES:
            given = getattr(self, which)
            times = np.asarray(self.times if given is None else given, dtype=np.float64)
            object.__setattr__(self, which, times)
            if times.ndim != 1 or not len(times) or not (np.diff(times) > 0).all() or not times[0] >= 0:
                raise ValueError(f"{which} have shape {times.shape}; allowed are seconds from 0 on that rise")
        for kind, columns in _KINDS.items():
            for name, rows in getattr(self, kind).items():
                count = len(self.pose_times if kind == "pose" else self.times)
                wanted = (count, 7) if columns == 7 else (count, "any number", 3)
                if len(np.shape(rows)) != len(wanted) or np.shape(rows)[0] != count or rows.shape[-1] != columns:
                    raise ValueError(f"{kind}/{name} has shape {np.shape(rows)}; allowed is {wanted}")
        if not any(np.isfinite(rows).any() for seen in (self.positions, self.points) for rows in seen.values()):
            raise ValueError("the recording shows no object; allowed are positions/NAME or points/NAME")

    @property
    def size(self) -> float:
        """Longest edge [m] of the box in which objects were seen."""
        seen = np.concatenate([rows.reshape(-1, 3) for part in (self.positions, self.points) for rows in part.values()])
        return float(np.ptp(seen[np.isfinite(seen).all(axis=1)], axis=0).max())

    @staticmethod
    def read(path: Path) -> Recording:
        """Read a recording from an .npz file with the arrays times, positions/NAME, points/NAME and pose/NAME.

        Raises ValueError in one sentence.
        """
        try:
            with np.load(path, allow_pickle=False) as file:
                arrays = {name: np.asarray(file[name], dtype=np.float64) for name in file.files}
        except (OSError, ValueError, zipfile.BadZipFile) as error:
            why = "it is no .npz file of numbers" if "pickle" in str(error) else error
            raise ValueError(f"{path} cannot be read: {why}") from None
        found: dict[str, dict[str, np.ndarray]] = {kind: {} for kind in _KINDS}
        for name, rows in arrays.items():
            kind, _, owner = name.partition("/")
            if owner and kind in _KINDS:
                found[kind][owner] = rows
            elif name not in _TIMES:
                others = ", ".join([f"{kind}/NAME" for kind in _KINDS] + ["pose_times"])
                raise ValueError(f"{path} has {name!r}; allowed are times and {others}")
        if "times" not in arrays:
            raise ValueError(f"{path} has no times; allowed is an array of seconds from 0 on that rise")
        return Recording(arrays["times"], **found, pose_times=arrays.get("pose_times"))

    def delayed(self, low: float, high: float) -> Recording:
        """Return a recording whose observations, but not poses, are late by `low` to `high` [s].

        Observations that may lie before the start are left out. Raises ValueError for bounds that are not allowed.
        """
        if not -_MOST_DELAY <= low < high <= _MOST_DELAY:
            raise ValueError(
                f"the delay is looked for from {low:g} to {high:g} s; allowed is LOW:HIGH that rises within "
                f"-{_MOST_DELAY:g} to {_MOST_DELAY:g}"
            )
        kept = self.times >= high
        if not kept.any():
            raise ValueError(
                f"the recording ends at {self.times[-1]:.3g} s; allowed is a delay below that, not {high:g} s"
            )
        positions, points = (
            {name: rows[kept] for name, rows in seen.items()} for seen in (self.positions, self.points)
        )
        return replace(self, times=self.times[kept], positions=positions, points=points, late=(low, high))

    def write(self, path: Path) -> None:
        """Write an .npz file with all but `late`."""
        arrays = {f"{kind}/{name}": rows for kind in _KINDS for name, rows in getattr(self, kind).items()}
        np.savez_compressed(path, times=self.times, pose_times=self.pose_times, **arrays)

    def check(self, sim: Simulation) -> None:
        """Raise ValueError if the recording does not fit a simulation's scene."""
        scene = sim.scene
        for kind, known in (("positions", scene.objects), ("points", scene.objects), ("pose", None)):
            known = {**scene.colliders, **scene.handles} if known is None else known
            for name in getattr(self, kind):
                if name not in known:
                    raise ValueError(f"the recording has {kind}/{name}; allowed of this scene is {', '.join(known)}")
        for name, rows in self.positions.items():
            if rows.shape[1] != len(sim.masses(name)):
                raise ValueError(
                    f"positions/{name} has {rows.shape[1]} particles; allowed are the {len(sim.masses(name))} of the "
                    f"scene, or points/{name} in any order"
                )
