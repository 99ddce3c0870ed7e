# SPDX-License-Identifier: Apache-2.0
"""Residuals of every world against the observations of one object, on the device."""

from __future__ import annotations

import numpy as np
import warp as wp

from cloth_sim_ros.sim import Simulation
from cloth_sim_ros.sim.kernels.compiled import compiled

_AXES = 3.0**0.5  # ratio of a distance from a particle to one from the surface, for the same noise along three axes
_FAR = 3.0  # largest distance of a seen particle from points, in medians
_LEAST = 0.01  # least weight of distances of particles, if points have no noise


@compiled
def between(
    x0: wp.array3d(dtype=float),
    v0: wp.array3d(dtype=float),
    x1: wp.array3d(dtype=float),
    v1: wp.array3d(dtype=float),
    shares: wp.array(dtype=float),
    dt: float,
    places: wp.array2d(dtype=wp.vec3),
):
    """Write the positions of particles at each world's share of a frame of dt [s].

    They lie on the cubic through positions and velocities at both ends of the frame.
    """
    w, i = wp.tid()
    t = shares[w]
    a = t * t * (3.0 - 2.0 * t)
    b = dt * t * (1.0 - t) * (1.0 - t)
    c = dt * t * t * (1.0 - t)
    place = wp.vec3(0.0)
    for k in range(3):
        place[k] = x0[w, i, k] + (a * (x1[w, i, k] - x0[w, i, k]) + b * v0[w, i, k] - c * v1[w, i, k])
    places[w, i] = place


@compiled
def apart(places: wp.array2d(dtype=wp.vec3), seen: wp.array(dtype=wp.vec3), out: wp.array2d(dtype=float)):
    """Write the offset of each particle from where it was seen, 0 if it was not."""
    w, i = wp.tid()
    for k in range(3):
        d = places[w, i][k] - seen[i][k]
        out[w, 3 * i + k] = wp.where(wp.isfinite(d), d, 0.0)


@wp.func
def on_segment(p: wp.vec3, a: wp.vec3, b: wp.vec3) -> wp.vec3:
    """Return the point of segment a b that is nearest to p."""
    edge = b - a
    return a + wp.clamp(wp.dot(p - a, edge) / wp.max(wp.dot(edge, edge), 1.0e-20), 0.0, 1.0) * edge


@wp.func
def nearer(p: wp.vec3, a: wp.vec3, b: wp.vec3) -> wp.vec3:
    return wp.where(wp.length_sq(p - a) <= wp.length_sq(p - b), a, b)


@wp.func
def on_triangle(p: wp.vec3, a: wp.vec3, b: wp.vec3, c: wp.vec3) -> wp.vec3:
    """Return the point of a triangle that is nearest to p: in its plane if p is above it, else on its edges."""
    n = wp.cross(b - a, c - a)
    inside = (
        wp.dot(wp.cross(b - a, p - a), n) >= 0.0
        and wp.dot(wp.cross(c - b, p - b), n) >= 0.0
        and wp.dot(wp.cross(a - c, p - c), n) >= 0.0
    )
    if inside and wp.dot(n, n) > 0.0:
        return p - wp.dot(p - a, n) / wp.dot(n, n) * n
    return nearer(p, on_segment(p, a, b), nearer(p, on_segment(p, b, c), on_segment(p, c, a)))


@compiled
def off_surface(
    places: wp.array2d(dtype=wp.vec3),
    seen: wp.array(dtype=wp.vec3),
    elements: wp.array(dtype=wp.vec3i),
    start: wp.array(dtype=int),
    around: wp.array(dtype=int),
    aside: float,
    out: wp.array2d(dtype=float),
):
    """Write the offset of each seen point from the nearest point on the elements around its nearest particle, 0 if
    unseen.

    The component along the element, beyond an edge, is multiplied by `aside`. Offsets are vectors, as a distance has no
    slope at its minimum, on the surface.
    """
    w, m = wp.tid()
    p = seen[m]
    off = wp.vec3(0.0)
    if wp.isfinite(p[0]):
        nearest = int(0)
        least = float(1.0e30)
        for i in range(places.shape[1]):
            d = wp.length_sq(places[w, i] - p)
            if d < least:
                least = d
                nearest = i
        off = p - places[w, nearest]
        across = off
        for k in range(start[nearest], start[nearest + 1]):
            e = elements[around[k]]
            a = places[w, e[0]]
            b = places[w, e[1]]
            if e[2] < 0:
                there = p - on_segment(p, a, b)
                if wp.length_sq(there) <= wp.length_sq(off):
                    off = there
                    along = wp.normalize(b - a)
                    across = there - wp.dot(there, along) * along
            else:
                c = places[w, e[2]]
                there = p - on_triangle(p, a, b, c)
                if wp.length_sq(there) <= wp.length_sq(off):
                    off = there
                    normal = wp.normalize(wp.cross(b - a, c - a))
                    across = wp.dot(there, normal) * normal
        off = across + aside * (off - across)
    for k in range(3):
        out[w, 3 * m + k] = off[k]


@compiled
def off_points(
    places: wp.array2d(dtype=wp.vec3),
    seen: wp.array(dtype=wp.vec3),
    cap: float,
    weight: float,
    first: int,
    out: wp.array2d(dtype=float),
):
    """Write the distance of each particle from the nearest seen point, at most `cap`, times a weight; 0 if none was
    seen."""
    w, i = wp.tid()
    least = float(1.0e30)
    for m in range(seen.shape[0]):
        d = wp.length_sq(places[w, i] - seen[m])
        if d < least:  # False for NaN, an unseen point
            least = d
    out[w, first + i] = wp.where(least < 1.0e30, weight * wp.min(wp.sqrt(least), cap), 0.0)


class Observer:
    """Compares one object in all worlds with its observations, frame by frame.

    ordered: True if `seen` (F, M, 3) are its particles in order, False if they are points anywhere on it. Unordered
    points are compared both ways: each point with the surface, and each particle with the points. Without the second,
    too large a sheet would fit. The second counts only as far as points lie close, see `settle`.
    """

    def __init__(self, sim: Simulation, name: str, seen: np.ndarray, ordered: bool) -> None:
        self._sim, self._name, self._ordered = sim, name, ordered
        self._device = wp.get_device(sim.device)
        self._shape = (sim.worlds, len(sim.masses(name)))
        self._last = [wp.zeros((*self._shape, 3), dtype=float, device=self._device) for _ in range(2)]
        self._places = wp.zeros(self._shape, dtype=wp.vec3, device=self._device)
        self._seen = wp.array(seen.astype(np.float32), dtype=wp.vec3, device=self._device)
        self._count = seen.shape[1]
        # Largest distance [m] of a particle that counts, its weight, and the factor of offsets along; see settle
        self.worth = (1e15, 1.0, 1.0)
        self.size = 3 * self._count + (0 if ordered else self._shape[1])
        self._out = wp.zeros((sim.worlds, self.size), dtype=float, device=self._device)
        self._elements, self._start, self._around = (
            wp.array(rows, dtype=dtype, device=self._device)
            for rows, dtype in zip(_surface(sim, name), (wp.vec3i, int, int), strict=True)
        )

    def settle(self, residuals: np.ndarray, aside: float) -> None:
        """Set the weight of distances from particles to points, from the residuals (F, size) of a good candidate.

        aside: factor of offsets along the surface, which are these distances and points beyond an edge.
        """
        if self._ordered:
            return
        cap, weight, _ = self.worth
        there = np.isfinite(self._seen.numpy()[:, :, 0])
        points = residuals[:, : 3 * self._count].reshape(*there.shape, 3)[there]
        particles = residuals[:, 3 * self._count :][there.any(axis=1)] / weight
        cap = min(cap, _FAR * float(np.median(particles)))
        rms = np.sqrt([(points**2).sum(axis=1).mean(), (np.minimum(particles, cap) ** 2).mean()])
        self.worth = cap, aside * float(np.clip(_AXES * rms[0] / max(rms[1], 1e-30), _LEAST, 1.0)), aside

    def _now(self) -> list[wp.array]:
        return [self._sim.tensor(self._name, what) for what in ("positions", "velocities")]

    def keep(self) -> None:
        """Store the state at the beginning of a frame."""
        for last, now in zip(self._last, self._now(), strict=True):
            wp.copy(last, now)

    def residuals(self, frame: int, share: np.ndarray) -> np.ndarray:
        """Return the residuals (worlds, size) float32 [m] against observation `frame` of the recording.

        share (worlds,): the time of that observation in each world, as a share of the last simulated frame.
        """
        shares = wp.array(share.astype(np.float32), device=self._device)
        inputs = [*self._last, *self._now(), shares, self._sim.settings.frame_dt, self._places]
        self._launch(between, self._shape[1], inputs)
        seen = self._seen[frame]
        if self._ordered:
            self._launch(apart, self._count, [self._places, seen, self._out])
        else:
            cap, weight, aside = self.worth
            surface = [self._elements, self._start, self._around, aside]
            self._launch(off_surface, self._count, [self._places, seen, *surface, self._out])
            inputs = [self._places, seen, cap, weight, 3 * self._count, self._out]
            self._launch(off_points, self._shape[1], inputs)
        return self._out.numpy().copy()

    def _launch(self, kernel: wp.Kernel, count: int, inputs: list) -> None:
        wp.launch(kernel, dim=(self._shape[0], count), inputs=inputs, device=self._device)


def _surface(sim: Simulation, name: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the elements (E, 3) of an object, and those around each particle, in compressed rows.

    Segments have -1 as third corner. Elements around particle i are entries start[i] to start[i + 1] of the third
    array.
    """
    elements, count = sim.triangles(name), len(sim.masses(name))
    if not len(elements):
        first = np.arange(count - 1)
        elements = np.column_stack([first, first + 1, np.full(len(first), -1)])
    corner = elements.ravel()
    order = np.argsort(corner, kind="stable")
    order = order[corner[order] >= 0]
    return elements, np.searchsorted(corner[order], np.arange(count + 1)), order // 3
