# SPDX-License-Identifier: Apache-2.0
"""Reading the stitches of seams."""

from __future__ import annotations

import numpy as np

from cloth_sim_ros.sim.engine.bodies import Bodies
from cloth_sim_ros.sim.input.checks import names_of
from cloth_sim_ros.sim.topology.elements import Stitches


def read_stitches(bodies: Bodies, seam: str, world: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """See Simulation.stitches."""
    if seam not in bodies.scene.seams:
        raise ValueError(f"there is no seam {seam!r}; allowed is {names_of(bodies.scene.seams)}")
    name, start = bodies.scene.seams[seam].first, 0
    for each in bodies.topology(name).stitches:
        if each.seam == seam:
            break
        start += len(each.shares)
    batch, world = bodies.batch[name], bodies.one(world)
    begin = batch.stitches(name).start + start
    rows = slice(begin, begin + len(each.shares))
    slid, broken, _ = batch.part("stitches", rows, world).numpy().reshape(-1, 3).T
    first, second = (_places(bodies, thing, world) for thing in (name, each.other))
    ends, shares, free = _second_points(each, slid, len(second))
    gaps = _points(first, each.particles[:, :2], each.shares[:, 0]) - _points(second, ends, shares)
    along = second[ends[:, 1]] - second[ends[:, 0]]
    square = np.maximum((along * along).sum(axis=1, keepdims=True), 1e-300)
    gaps -= np.where(free[:, None], (gaps * along).sum(axis=1, keepdims=True) / square * along, 0.0)
    forces = np.where(broken[:, None] > 0.0, 0.0, batch.part("stitch_forces", rows, world).numpy().reshape(-1, 3))
    return gaps, forces, broken > 0.0


def _places(bodies: Bodies, name: str, world: int) -> np.ndarray:
    """Positions (N, 3) float64 [m] of an object's particles."""
    batch = bodies.batch[name]
    return sum(batch.read_rows(part, name, world)[0, :, :3].astype(np.float64) for part in ("positions", "position_lo"))


def _points(places: np.ndarray, particles: np.ndarray, shares: np.ndarray) -> np.ndarray:
    first, second = places[particles[:, 0]], places[particles[:, 1]]
    return first + shares[:, None] * (second - first)


def _second_points(stitches: Stitches, slid: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Particles (E, 2) and shares (E,) where stitches slid by so many segments (E,) lie on an object of `count`.

    The third array (E,) is True for those that are free to slide both ways.
    """
    particles, shares = stitches.particles[:, 2:], stitches.shares[:, 1]
    if not stitches.slides:
        return particles, shares, np.zeros(len(shares), bool)
    at = np.clip(particles[:, 0] + shares + slid, 0.0, count - 1.0)
    segment = np.minimum(at.astype(int), count - 2)
    return np.stack([segment, segment + 1], axis=1), at - segment, (at > 0.0) & (at < count - 1.0)
