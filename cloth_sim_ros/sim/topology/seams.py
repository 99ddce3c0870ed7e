# SPDX-License-Identifier: Apache-2.0
"""Stitches of seams: which points of two objects they tie, from lines through given particles."""

from __future__ import annotations

import heapq
from collections.abc import Sequence

import numpy as np

from cloth_sim_ros.sim.input.mesh_repair import edges_of
from cloth_sim_ros.sim.scene.seams import Seam
from cloth_sim_ros.sim.topology.elements import Stitches, Topology

# Shares are multiples of it. So both weights of a point add up to 1 exactly in float32, and the forces to 0.
_EXACT = 2.0**-20


def stitches_of(name: str, seam: Seam, row: int, first: Topology, second: Topology) -> Stitches:
    """Return the stitches of a seam called `name`. Raises ValueError for particles that cannot be sewn so."""
    if seam.slides and len(second.triangles):
        raise ValueError(f"{name}.slides is True along {seam.second}, a sheet; allowed is along a rope")
    lines = [
        _line(topology, seam, f"{name}.{which}_particles", getattr(seam, f"{which}_particles"), getattr(seam, which))
        for which, topology in (("first", first), ("second", second))
    ]
    turned = len(lines[0]) < len(lines[1]) and not seam.slides
    fine, coarse = ((lines[1], second), (lines[0], first)) if turned else ((lines[0], first), (lines[1], second))
    pairs, shares = _points(*fine, *coarse)
    if seam.slides:
        pairs, shares = _on_segments(pairs, shares, len(second.masses))
    parts = [(np.stack([fine[0], fine[0]], axis=1), np.zeros(len(pairs))), (pairs, shares)]
    particles, shares = (np.stack(each, axis=1) for each in zip(*(parts[::-1] if turned else parts), strict=True))
    alone = seam.first == seam.second
    if alone and (particles[:, 0] == particles[:, 1]).any():
        raise ValueError(f"{name} sews a particle of {seam.first} to itself; allowed are lines without a common one")
    return Stitches(name, seam.second, particles.reshape(-1, 4), shares, row, seam.slides)


def _points(
    fine: np.ndarray, of_fine: Topology, coarse: np.ndarray, of_coarse: Topology
) -> tuple[np.ndarray, np.ndarray]:
    """Two particles of a line (n, 2), and the share of the second (n,), where each of the finer line is sewn to it."""
    if len(fine) == len(coarse):
        return np.stack([coarse, coarse], axis=1), np.zeros(len(fine))
    at = np.interp(_along(fine, of_fine), _along(coarse, of_coarse), np.arange(len(coarse)))
    before = np.minimum(at.astype(int), max(len(coarse) - 2, 0))
    after = np.minimum(before + 1, len(coarse) - 1)
    shares = np.round((at - before) / _EXACT) * _EXACT
    return np.stack([coarse[before], coarse[after]], axis=1), shares


def _along(line: np.ndarray, topology: Topology) -> np.ndarray:
    """Share (n,) of the length of a line at each of its particles."""
    lengths = np.linalg.norm(np.diff(topology.layout[line], axis=0), axis=1)
    return np.append(0.0, np.cumsum(lengths)) / max(lengths.sum(), 1e-300)


def _on_segments(pairs: np.ndarray, shares: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """The same points of a rope of `count` particles, between a particle and the next one."""
    at = np.where(pairs[:, 0] <= pairs[:, 1], pairs[:, 0] + shares, pairs[:, 0] - shares)
    segment = np.minimum(at.astype(int), count - 2)
    return np.stack([segment, segment + 1], axis=1), at - segment


def _line(topology: Topology, seam: Seam, name: str, particles: Sequence[int], thing: str) -> np.ndarray:
    """The particles of a line (n,) through given ones, or these alone. Raises ValueError."""
    most = len(topology.masses) - 1
    if max(particles) > most:
        raise ValueError(f"{name} has {max(particles)}; allowed is 0 to {most}, those of {thing}")
    if seam.points:
        return np.array(particles)
    edges, border = topology.panels[:, :2], slice(None)
    if len(topology.triangles):
        edges, count, _ = edges_of(topology.triangles, most + 1)
        border = count == 1
    ways = [_neighbours(edges[border], topology), _neighbours(edges, topology)]
    found = [particles[0]]
    for begin, end in zip(particles[:-1], particles[1:], strict=True):
        path = next(filter(None, (_shortest(neighbours, begin, end) for neighbours in ways)), None)
        if path is None or begin == end:
            raise ValueError(f"{name} has {begin}, then {end}; allowed are two particles that edges of {thing} join")
        found += path[1:]
    return np.array(found)


def _neighbours(edges: np.ndarray, topology: Topology) -> dict[int, list[tuple[int, float]]]:
    """Particle -> the particles that edges (E, 2) join it to, with the lengths of these [m]."""
    lengths, found = np.linalg.norm(np.diff(topology.layout[edges], axis=1)[:, 0], axis=1), {}
    for (a, b), length in zip(edges.tolist(), lengths.tolist(), strict=True):
        found.setdefault(a, []).append((b, length))
        found.setdefault(b, []).append((a, length))
    return found


def _shortest(neighbours: dict[int, list[tuple[int, float]]], begin: int, end: int) -> list[int] | None:
    """The shortest way from one particle to another (Dijkstra 1959), None if there is none."""
    before, queue = {}, [(0.0, begin, begin)]
    while queue:
        so_far, particle, last = heapq.heappop(queue)
        if particle in before:
            continue
        before[particle] = last
        if particle == end:
            break
        for other, length in neighbours.get(particle, ()):
            heapq.heappush(queue, (so_far + length, other, particle))
    if end not in before:
        return None
    path = [end]
    while path[-1] != begin:
        path.append(before[path[-1]])
    return path[::-1]
