# SPDX-License-Identifier: Apache-2.0
"""Reading the stitches of seams."""

from __future__ import annotations

import numpy as np

from cloth_sim_ros.sim.engine.bodies import Bodies
from cloth_sim_ros.sim.features.seams.arrays import BROKEN
from cloth_sim_ros.sim.input.checks import named


def read_stitches(bodies: Bodies, seam: str, world: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """See Simulation.stitches."""
    name, start = named(bodies.scene.seams, seam, "seam").first, 0
    for each in bodies.topology(name).stitches:
        if each.seam == seam:
            break
        start += len(each.shares)
    batch, world = bodies.batch[name], bodies.one(world)
    begin = batch.stitches(name).start + start
    rows = slice(begin, begin + len(each.shares))
    slid, state, _ = batch.part("stitches", rows, world).numpy().reshape(-1, 3).T
    first, second = (_places(bodies, thing, world) for thing in (name, each.other))
    points = _points(first, each.particles[:, :2], each.shares[:, 0])
    if each.slides:
        gaps = _off_rope(points, second, each.particles[:, 2] + each.shares[:, 1] + slid)
    else:
        gaps = points - _points(second, each.particles[:, 2:], each.shares[:, 1])
    broken = state == BROKEN
    forces = np.where(broken[:, None], 0.0, batch.part("stitch_forces", rows, world).numpy().reshape(-1, 3))
    return gaps, forces, broken


def _places(bodies: Bodies, name: str, world: int) -> np.ndarray:
    """Positions (N, 3) float64 [m] of an object's particles."""
    batch = bodies.batch[name]
    return sum(batch.read_rows(part, name, world)[0, :, :3].astype(np.float64) for part in ("positions", "position_lo"))


def _points(places: np.ndarray, particles: np.ndarray, shares: np.ndarray) -> np.ndarray:
    first, second = places[particles[:, 0]], places[particles[:, 1]]
    return first + shares[:, None] * (second - first)


def _off_rope(points: np.ndarray, rope: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Vectors (E, 3) from a rope's particles (N, 3) to points, from the nearest of the segments around `at` (E,)."""
    segments = np.clip(at.astype(int)[:, None] + (-1, 0, 1), 0, len(rope) - 2)
    along, off = rope[segments + 1] - rope[segments], points[:, None] - rope[segments]
    square = np.maximum((along * along).sum(axis=2), 1e-300)
    gaps = off - np.clip((off * along).sum(axis=2) / square, 0.0, 1.0)[..., None] * along
    return gaps[np.arange(len(gaps)), np.linalg.norm(gaps, axis=2).argmin(axis=1)]
