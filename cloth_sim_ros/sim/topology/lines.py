# SPDX-License-Identifier: Apache-2.0
"""Springs joined into lines, and lines into families, for a solve along lines, family by family (NumPy).

A line is a sequence of particles with a spring between each and the next. The lines of a family share no particle, so
that they are solved side by side. A grid has a family for each direction of its springs; a mesh joins edges by their
straightest continuation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cloth_sim_ros.sim.topology.springs import Elements, numbers_of

_STRAIGHTEST = -0.5  # largest cosine between two edges away from a vertex at which one continues the other
_ORDER = ("bending", "shear", "structural")  # order of solving; the last kind is satisfied best, see `rounds`


@dataclass(frozen=True)
class Family:
    """Lines of one `kind` of springs that share no particle.

    particles (L, n) int: those of each line in order, -1 behind its end. springs (L, n - 1) int: number of the spring
    between a particle and the next in Topology.springs[kind], -1 where there is none.
    """

    kind: str
    particles: np.ndarray
    springs: np.ndarray


def families(springs: dict[str, Elements], points: np.ndarray, grid: tuple[int, int] | None) -> list[Family]:
    """All `springs`, by kind, each in one line of one family.

    points (N, 3) [m]: particles at rest; grid: how many of them lie along x and y, None where they are no grid.
    """
    found = []
    for kind in _ORDER:
        if kind in springs:
            if grid is None:
                woven = _paths(springs[kind].particles, points)
            else:
                woven = [_numbered(lines, springs[kind], len(points)) for lines in _directions(grid, kind)]
            found += [Family(kind, *lines) for lines in woven]
    return found


def rounds(families: list[Family], count: int) -> list[list[tuple[int, np.ndarray | None]]]:
    """Group families into rounds, in the order of solving, for a body of `count` particles.

    The thread that solves a line of a round's last family first solves the lines of the other families within it. Each
    entry is a family's number and (L,) the line of the last family that holds each of its lines, None for the last.
    """
    found: list[list[tuple[int, np.ndarray | None]]] = [[(k, None)] for k in range(len(families))]
    for k, family in enumerate(families):
        for j in range(k + 1, len(families)):
            lines = _lines_around(family, families[j], count)
            if lines is not None:
                found[j].insert(-1, (k, lines))
                found[k] = []
                break
    return [some for some in found if some]


def _lines_around(family: Family, other: Family, count: int) -> np.ndarray | None:
    """(L,) the line of another family that holds each line; None if one lies in none."""
    line = np.full(count + 1, -1)
    line[other.particles] = np.arange(len(other.particles))[:, None]
    line[-1] = -1  # what stands behind the end of a line
    around = line[family.particles[:, 0]]
    inside = (line[family.particles] == around[:, None]) | (family.particles < 0)
    return around if inside.all() and (around >= 0).all() else None


def _directions(grid: tuple[int, int], kind: str) -> list[np.ndarray]:
    """Particles (L, n) of the lines of a grid along each direction in which it has springs of a kind."""
    nx, ny = grid
    index = np.arange(nx * ny).reshape(ny, nx)
    if kind == "shear":
        return [_diagonals(index), _diagonals(index[:, ::-1])]
    stride = 2 if kind == "bending" else 1
    return [_strided(lines, stride) for lines in (index, index.T) if lines.shape[1] > stride]


def _strided(lines: np.ndarray, stride: int) -> np.ndarray:
    """Every line as `stride` lines that leave out the particles between, -1 behind the end of the shorter ones."""
    parts = [lines[:, first::stride] for first in range(stride)]
    return np.concatenate([np.pad(p, ((0, 0), (0, parts[0].shape[1] - p.shape[1])), constant_values=-1) for p in parts])


def _diagonals(index: np.ndarray) -> np.ndarray:
    """The diagonals of at least two of the numbers in `index` (ny, nx), -1 behind the end of the shorter ones."""
    ny, nx = index.shape
    start, step = np.arange(2 - ny, nx - 1)[:, None], np.arange(min(nx, ny))
    column, row = np.maximum(start, 0) + step, np.maximum(-start, 0) + step
    inside = (column < nx) & (row < ny)
    return np.where(inside, index[np.where(inside, row, 0), np.where(inside, column, 0)], -1)


def _numbered(lines: np.ndarray, springs: Elements, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Lines of particles (L, n) and the numbers of the springs between them."""
    return lines, numbers_of(springs.particles, np.stack([lines[:, :-1], lines[:, 1:]], axis=2), count)


def _paths(pairs: np.ndarray, points: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """Particles and springs of families of lines that hold each of the springs `pairs` (S, 2) of a mesh at `points`.

    At each vertex the two springs that come nearest to a straight line continue into one another, then the next two. A
    line ends where it would meet itself. Long lines come first, each into the first family that it does not touch.
    """
    following = _continuations(pairs, points)
    lines, done = [], np.zeros(len(pairs), dtype=bool)
    for spring in range(len(pairs)):
        if not done[spring]:
            lines.append(_walk(spring, pairs, following, done))
    lines.sort(key=lambda line: len(line[0]), reverse=True)
    touched = [0] * len(points)  # a bit for each family that a particle is in
    found: list[list[tuple[list[int], list[int]]]] = []
    for line in lines:
        taken = 0
        for particle in line[0]:
            taken |= touched[particle]
        free = ~taken & (taken + 1)
        for particle in line[0]:
            touched[particle] |= free
        family = free.bit_length() - 1
        if family == len(found):
            found.append([])
        found[family].append(line)
    return [(_padded([line[0] for line in family]), _padded([line[1] for line in family])) for family in found]


def _padded(lines: list[list[int]]) -> np.ndarray:
    rows = np.full((len(lines), max(map(len, lines))), -1)
    for row, line in zip(rows, lines, strict=True):
        row[: len(line)] = line
    return rows


def _walk(spring: int, pairs: np.ndarray, following: np.ndarray, done: np.ndarray) -> tuple[list[int], list[int]]:
    """The particles and the springs of the line through a spring; its springs are `done` then."""
    particles, springs = pairs[spring].tolist(), [spring]
    seen = set(particles)
    done[spring] = True
    for side in (1, 0):
        current, end = spring, side
        while True:
            half = following[current, end]
            if half < 0 or done[half // 2]:
                break
            current, end = int(half // 2), int(1 - half % 2)
            particle = int(pairs[current, end])
            if particle in seen:
                break
            done[current] = True
            seen.add(particle)
            particles.append(particle)
            springs.append(current)
        particles.reverse()
        springs.reverse()
    return particles, springs


def _continuations(pairs: np.ndarray, points: np.ndarray) -> np.ndarray:
    """(S, 2): the end of a spring that continues each end of a spring, as 2 x spring + end, -1 for none."""
    vertex = pairs.ravel()
    away = points[pairs[:, ::-1].ravel()] - points[vertex]
    away = away / np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-300)
    order = np.argsort(vertex, kind="stable")
    degree = np.bincount(vertex, minlength=len(points))
    start = np.cumsum(degree) - degree
    rank = np.arange(len(vertex)) - start[vertex[order]]
    others = np.repeat(np.arange(len(vertex)), rank)  # pairs of ends at a vertex: each with all before it
    first = order[others]
    second = order[others - 1 - (np.arange(len(others)) - np.repeat(np.cumsum(rank) - rank, rank))]
    cosine = (away[first] * away[second]).sum(1)
    keep = cosine < _STRAIGHTEST
    first, second, cosine = first[keep], second[keep], cosine[keep]
    following = np.full(len(vertex), -1)
    while len(first):
        best = np.full(len(vertex), np.inf)
        np.minimum.at(best, first, cosine)
        np.minimum.at(best, second, cosine)
        wins = (cosine == best[first]) & (cosine == best[second])
        for a, b in zip(first[wins].tolist(), second[wins].tolist(), strict=True):
            if following[a] < 0 and following[b] < 0:  # of equally straight ones the first
                following[a], following[b] = b, a
        left = (following[first] < 0) & (following[second] < 0)
        first, second, cosine = first[left], second[left], cosine[left]
    return following.reshape(-1, 2)
