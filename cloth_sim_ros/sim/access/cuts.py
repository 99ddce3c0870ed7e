# SPDX-License-Identifier: Apache-2.0
"""Cuts: springs that cross a planar polygon fail."""

from __future__ import annotations

from typing import Any

import numpy as np

from cloth_sim_ros.sim.engine.bodies import Bodies
from cloth_sim_ros.sim.input.checks import finite_array, worlds_of

_OFF_PLANE = 1e-3  # fraction of a polygon's size by which a corner may lie off its plane


class Cuts:
    """Cuts the objects of a simulation that tear."""

    _bodies: Bodies

    def cut(self, name: str, polygon: Any, world: Any = None) -> int:
        """Cut a sheet: every spring that crosses a planar polygon fails for good.

        Args:
            name: The sheet; it must have a tear_strain above 0.
            polygon: Corners (n, 3) [m], 3 or more.
            world: The number of a world, a mask (worlds,) of bool, or None for all.

        Returns:
            The number of structural and shear springs that failed, over all worlds that are cut.

        Raises:
            ValueError: The object does not tear, or the polygon is not flat or has no area.
        """
        topology, some = self._bodies.topology(name), self._bodies.some(world)
        if topology.tear_strain <= 0.0:
            if not len(topology.triangles):
                raise ValueError(
                    f"{name} is a rope, which cannot be cut; allowed is a sheet with a tear_strain above 0"
                )
            raise ValueError(f"{name} cannot be cut; allowed is a sheet that is built with a tear_strain above 0")
        corners, normal = plane_of(polygon)
        batch = self._bodies.batch[name]
        b = batch.index[name]
        positions = batch.read_rows("positions", name)[..., :3].astype(np.float64)
        chosen = np.zeros((self._bodies.worlds, 1), dtype=bool)
        chosen[worlds_of(some)] = True
        before = batch.torn.read(b)
        failed = {}
        for kind, elements in topology.springs.items():
            first, second = (positions[:, elements.particles[:, k]] for k in range(2))
            failed[kind] = chosen & ~before[kind] & goes_through(first, second, corners, normal)
        if any(rows.any() for rows in failed.values()):
            batch.torn.write(b, failed)
            self._bodies.wake()
        return sum(int(rows.sum()) for kind, rows in failed.items() if kind != "bending")


def plane_of(polygon: Any) -> tuple[np.ndarray, np.ndarray]:
    """Corners (n, 3) [m] and unit normal (3,) of a polygon. Raises ValueError if it has no area or is not flat."""
    corners = finite_array(polygon, "the polygon of a cut", least=3)
    middle = corners - corners.mean(axis=0)
    size = float(np.abs(middle).max())
    normal = np.cross(middle, np.roll(middle, -1, axis=0)).sum(axis=0)  # twice the area along it (Newell)
    if np.linalg.norm(normal) <= 1e-9 * size**2:
        raise ValueError(f"the polygon of a cut has an area of {np.linalg.norm(normal) / 2:g} m^2; allowed is more")
    normal /= np.linalg.norm(normal)
    off = float(np.abs(middle @ normal).max())
    if off > _OFF_PLANE * size:
        raise ValueError(f"a corner of the polygon of a cut is {off:.3g} m off its plane; allowed is a flat polygon")
    return corners, normal


def goes_through(first: np.ndarray, second: np.ndarray, corners: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """True for segments from `first` to `second` (..., 3) that cross a polygon; an end in its plane counts as below."""
    above, ends = (first - corners[0]) @ normal, (second - corners[0]) @ normal
    crosses = (above > 0.0) != (ends > 0.0)
    share = above / np.where(crosses, above - ends, 1.0)
    x = first + share[..., None] * (second - first)
    # Project onto two coordinates and cast a ray along the first. A point is inside if the ray crosses the outline an
    # odd number of times.
    u, v = np.delete(np.arange(3), np.abs(normal).argmax())
    inside = np.zeros(crosses.shape, dtype=bool)
    for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        spans = (a[v] > x[..., v]) != (b[v] > x[..., v])
        slope = (b[u] - a[u]) / (b[v] - a[v] if b[v] != a[v] else 1.0)
        inside ^= spans & (x[..., u] < a[u] + slope * (x[..., v] - a[v]))
    return crosses & inside
