# SPDX-License-Identifier: Apache-2.0
"""A cable with markers on it, and guesses of its motion without a model."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from cloth_sim_ros.identify.cable_shape import BENDS, PLACES
from cloth_sim_ros.identify.markers import Markers
from cloth_sim_ros.sim import Rope

_PULL = 1.0e4  # stiffness EA [N]: cables hardly stretch in such motions
_AXIAL = 2.0e-3  # damping of stretch [s]


@dataclass(frozen=True)
class Cable:
    """Known properties of a cable before its recording is fitted.

    lengths (M - 1,): distances [m] between its markers. held: number of markers at each end that follow the recording.
    between: segments between two markers that are not both held. density [kg/m], radius [m]. Motion alone tells only
    the ratio of rigidity and density.

    bends (BENDS, 2): shape at rest. The first rows are the curvature [1/m] at PLACES even places along the cable. The
    last two are the turns [rad] at the inner held markers of the start and of the end, as a clamp need not point along
    its markers. offsets (F, 2): offsets [m] of the free markers from the cable's centreline, or None for 0. Both are
    components along two directors, see cable_shape.headings.
    """

    lengths: np.ndarray
    held: int = 2
    between: int = 3
    density: float = 0.1
    radius: float = 0.004
    bends: np.ndarray = field(default_factory=lambda: np.zeros((BENDS, 2)))
    offsets: np.ndarray | None = None

    @cached_property
    def markers(self) -> np.ndarray:
        """Indices (M,) of the particles at the markers."""
        count, ends = len(self.lengths), self.held - 1
        segments = [1 if k < ends or k >= count - ends else self.between for k in range(count)]
        return np.concatenate([[0], np.cumsum(segments)])

    @cached_property
    def places(self) -> np.ndarray:
        """Arc lengths (N,) [m] of the particles from the first marker."""
        marks = np.concatenate([[0.0], np.cumsum(self.lengths)])
        return np.interp(np.arange(self.markers[-1] + 1), self.markers, marks)

    @cached_property
    def held_markers(self) -> list[int]:
        """Indices of the markers that follow the recording."""
        count = len(self.lengths) + 1
        return [*range(self.held), *range(count - self.held, count)]

    def rest_turns(self, bends: np.ndarray) -> np.ndarray:
        """Return the turns (..., N - 2, 2) [-] of all joints at rest, from `bends` (..., BENDS, 2)."""
        places, particles = self.places, np.arange(1, self.markers[-1])
        nodes, joints = np.linspace(0.0, places[-1], PLACES), places[1:-1]
        shares = np.array([np.interp(joints, nodes, row) for row in np.eye(PLACES)])
        clamps = [particles == self.markers[m] for m in (self.held - 1, -self.held)]
        shares = np.concatenate([shares * 0.5 * (places[2:] - places[:-2]), clamps])
        return np.einsum("...pa,pj->...ja", bends, shares)

    def rope(self, bend_compliance: float, bend_damping: float, twist_compliance: float) -> Rope:
        """Return the cable as a rope that is straight at rest."""
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
            twist_compliance=twist_compliance,
        )


def mean_error(off: np.ndarray) -> float:
    """Return the mean of |x - x_ref| [m] over frames, runs, seen markers (held ones too) and coordinates."""
    return float(np.nanmean(np.abs(off)))


def guesses(markers: Markers, start: int) -> dict[str, np.ndarray]:
    """Return the errors (F, R, M, 3) [m] of two motions without a model, laid out as `CableCandidates.off`.

    "hold" keeps the shape of the start. "blend" interpolates the displacement of each marker linearly between those of
    both ends.
    """
    seen = markers.seen.swapaxes(0, 1)
    first, later = seen[start - 1], seen[start:]
    share = np.linspace(0.0, 1.0, markers.count)[:, None]
    moved = (later - first)[:, :, :1] * (1.0 - share) + (later - first)[:, :, -1:] * share
    return {"hold": first - later, "blend": first + moved - later}
