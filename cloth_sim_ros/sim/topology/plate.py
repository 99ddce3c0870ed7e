# SPDX-License-Identifier: Apache-2.0
"""The bending of a sheet: energy B/2 times the integral of |H|^2, H the Hessian of the positions over the flat sheet.

A woven sheet weighs the parts of |H|^2: that of the warp with 1, those of weft and twist with ratios of rigidities.

On every triangle H is that of Morley's plate element (Morley 1968): H = sum over its edges of l psi n n^T / A. There n
is the normal of the edge in the plane of the triangle, l its length and A the area. psi is how far the slope along n at
the middle of the edge is from the slope of the triangle. Morley's element takes the slopes as unknowns. Here they
follow from the vertices: the slope at the middle of an edge is the one of the quadratic through the vertices around it.
Both triangles at an edge share that slope, so that the element passes the patch test on any mesh.

A mesh that is curved at rest is unfolded about the edges of its triangles. H is the Hessian of the surface in its own
coordinates: at rest it is along the normal of the triangle.

A *turn* is the difference of the slopes of two neighbouring triangles along n: a vector, linear in the positions.
Arrays (T, 3) of edges are as plate_mesh.py has them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from cloth_sim_ros.sim.topology.elements import Plate, PlateParts
from cloth_sim_ros.sim.topology.plate_mesh import LAST, NEXT, Mesh

_FLAT = 1e-6  # turns at rest [-] below which a mesh is flat
_EXACT = 1e-9  # error of a slope [-], or part of a weight, that counts as rounding
# Eigenvalues below this share of the largest: the vertices do not tell that curvature from others. At 1e-3 a few edges
# of jittered meshes made omega^2 of the fastest mode eight times as large; cantilevers sag alike from 1e-6 to 0.05.
_SINGULAR = 1e-2
_NOTHING = 1e-13  # share of the largest weight below which a weight is rounding


@dataclass(frozen=True)
class Weave:
    """Rigidities of weft and twist over that of the warp, and the direction of the warp, (3,) or (T, 3)."""

    weft: float = 1.0
    twist: float = 1.0
    warp: np.ndarray | tuple[float, ...] = (1.0, 0.0, 0.0)


def of_triangles(
    points: np.ndarray, triangles: np.ndarray, pinned: np.ndarray, tears: bool = False, weave: Weave = Weave()
) -> Plate | None:
    """The bending operator of a sheet whose warp has the rigidity B = 1, None where no two triangles meet.

    points (N, 3) [m] at rest, triangles (T, 3) with at most two at an edge, pinned (N,) bool. Free borders carry no
    moment. A triangle of three pinned particles is a clamp: it does not bend, and its neighbours start with its slope.
    With `tears` it is told which triangle each part of a weight is of.
    """
    mesh = Mesh.of(points, triangles, pinned, weave.warp)
    if not mesh.bends.any():
        return None
    correction = _correction(mesh)
    stencil, slopes = _slopes(mesh, correction)
    rest = _at_rest(mesh, stencil, slopes, points)
    stiffness = _stiffness(mesh, weave)
    first, second = np.triu_indices(stencil.shape[1], 1)
    weights = (slopes.transpose(0, 2, 1) @ (stiffness @ slopes))[:, first, second]
    pairs = (stencil[:, first].ravel(), stencil[:, second].ravel())
    neighbours, rows, sums, parts = _rows(*pairs, weights.ravel(), len(points), tears)
    curved = np.flatnonzero(np.abs(rest / mesh.length).max(axis=1) > _FLAT)
    of = None
    if tears:
        start, entries = parts
        of = PlateParts(sums, start, entries // len(first), weights.ravel()[entries], _needs(mesh), curved)
    if len(curved) == 0:
        return Plate(neighbours, rows, parts=of)
    gradients = (rest[curved, None, :] @ stiffness[curved] @ slopes[curved])[:, 0]
    return Plate(neighbours, rows, stencil[curved].astype(np.int32), gradients, of)


def _needs(mesh: Mesh) -> np.ndarray:
    """(T, 13) triangles: itself, its neighbours and theirs."""
    near = mesh.derived // 3
    return np.concatenate([np.arange(len(near))[:, None], near, near[near].reshape(len(near), -1)], axis=1)


def _moments(mesh: Mesh) -> tuple[np.ndarray, np.ndarray]:
    """The turn, and the error of the slope of `_slopes` without correction, for a quadratic.

    Both (T, 3, 3) [m]: the factors of H_tt, H_tn, H_nn in axes along the edge and out of the triangle.
    """
    k = (mesh.foot - 0.5) * mesh.length
    far = mesh.beyond(mesh.foot)
    l = (np.where(mesh.turned, 1.0 - far, far) - 0.5) * mesh.length
    quarter = 0.25 * mesh.length**2
    near, beyond = mesh.height, mesh.beyond(mesh.height)
    inside = np.stack([0.5 * (k**2 - quarter) / near, -k, 0.5 * near], axis=2)
    outside = np.stack([0.5 * (l**2 - quarter) / beyond, l, 0.5 * beyond], axis=2)
    turn = inside + np.where(mesh.clamped, 0.0, 1.0)[:, :, None] * outside
    error = (near[:, :, None] * outside - beyond[:, :, None] * inside) / (near + beyond)[:, :, None]
    return turn, error


def _correction(mesh: Mesh) -> np.ndarray:
    """Factors (T, 3, 5) of turns that make the slopes at edges exact for quadratics; zero where they are already.

    The turns are that of the edge itself, of the two edges after it in the triangle, and in the neighbour. Among all
    such factors the least-squares ones are taken. A curvature that the vertices do not determine stays uncorrected.
    """
    turn, error = _moments(mesh)
    result = np.zeros((*turn.shape[:2], 5))
    both = mesh.bends & mesh.beyond(mesh.bends)
    first = both & (mesh.derived > np.arange(mesh.derived.size).reshape(-1, 3))
    wrong = np.flatnonzero(first & (np.abs(error).max(axis=2) > _EXACT * mesh.length))
    if len(wrong) == 0:
        return result
    derived = mesh.derived.ravel()[wrong]
    sign = np.where(mesh.turned.ravel()[wrong], -1.0, 1.0)
    known = [turn.reshape(-1, 3)[wrong]]
    for half, flip, t_sign in ((wrong, 1.0, np.ones(len(wrong))), (derived, -1.0, sign)):
        for step in (1, 2):
            known.append(_seen_from(mesh, turn, half, step, t_sign, np.full(len(wrong), flip)))
    matrix = np.stack(known, axis=2)
    normal = matrix @ matrix.transpose(0, 2, 1)
    inverse = np.linalg.pinv(normal, rcond=_SINGULAR, hermitian=True)
    factors = -(matrix.transpose(0, 2, 1) @ (inverse @ error.reshape(-1, 3)[wrong][:, :, None]))[:, :, 0]
    result.reshape(-1, 5)[wrong] = factors
    # Seen from the neighbour, the slope has the other sign and the pairs of turns change places.
    result.reshape(-1, 5)[derived] = -factors[:, [0, 3, 4, 1, 2]]
    return result


def _seen_from(
    mesh: Mesh, turn: np.ndarray, half: np.ndarray, step: int, t_sign: np.ndarray, n_sign: np.ndarray
) -> np.ndarray:
    """Moments (E, 3) of the turn at the edge `step` corners after edge `half` (E,), in axes of `half` times the signs.
    They are zero where the triangle does not bend at that edge."""
    triangle, corner = half // 3, half % 3
    edge = 3 * triangle + (corner + step) % 3
    along, out = mesh.along.reshape(-1, 2), mesh.out.reshape(-1, 2)
    t = np.stack([t_sign * (along[edge] * along[half]).sum(1), n_sign * (along[edge] * out[half]).sum(1)], axis=1)
    n = np.stack([t_sign * (out[edge] * along[half]).sum(1), n_sign * (out[edge] * out[half]).sum(1)], axis=1)
    tt, tn, nn = turn.reshape(-1, 3)[edge].T
    seen = np.stack(
        [
            tt * t[:, 0] ** 2 + tn * t[:, 0] * n[:, 0] + nn * n[:, 0] ** 2,
            2.0 * tt * t[:, 0] * t[:, 1] + tn * (t[:, 0] * n[:, 1] + t[:, 1] * n[:, 0]) + 2.0 * nn * n[:, 0] * n[:, 1],
            tt * t[:, 1] ** 2 + tn * t[:, 1] * n[:, 1] + nn * n[:, 1] ** 2,
        ],
        axis=1,
    )
    return np.where(mesh.bends.ravel()[edge, None], seen, 0.0)


def _turns(mesh: Mesh) -> np.ndarray:
    """Weights (T, 3, 4) of turns at the corners of the triangle and at the neighbour's; zero where it does not bend."""
    result = np.zeros((len(mesh.triangles), 3, 4))
    far = mesh.beyond(mesh.foot)
    far = np.where(mesh.turned, 1.0 - far, far)
    near, beyond = 1.0 / mesh.height, 1.0 / mesh.beyond(mesh.height)
    for c in range(3):
        result[:, c, c] = near[:, c]
        result[:, c, 3] = beyond[:, c]
        result[:, c, NEXT[c]] = -(1.0 - mesh.foot[:, c]) * near[:, c] - (1.0 - far[:, c]) * beyond[:, c]
        result[:, c, LAST[c]] = -mesh.foot[:, c] * near[:, c] - far[:, c] * beyond[:, c]
    return np.where(mesh.bends[:, :, None], result, 0.0)


def _slopes(mesh: Mesh, correction: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (T, S) and weights (T, 3, S) of l psi at the edges of a triangle.

    The vertices: its own three, the neighbours' three, and, where there is a correction, six beyond those.
    """
    count, turns = len(mesh.triangles), _turns(mesh)
    opposite = np.where(mesh.bends, mesh.beyond(mesh.triangles), mesh.triangles)
    share = np.where(mesh.clamped, 1.0, mesh.height / (mesh.height + mesh.beyond(mesh.height)))
    size = 12 if correction.any() else 6
    stencil = np.concatenate([mesh.triangles, opposite, np.repeat(mesh.triangles, 2, axis=1)], axis=1)[:, :size]
    slopes = np.zeros((count, 3, size))
    for c in range(3):
        for step in range(3):
            d = (c + step) % 3
            factor = (share[:, c] if step == 0 else 0.0) + correction[:, c, step]
            slopes[:, c, :3] += factor[:, None] * turns[:, d, :3]
            slopes[:, c, 3 + d] += factor * turns[:, d, 3]
        if size == 6:
            continue
        there, corner = mesh.derived[:, c] // 3, mesh.derived[:, c] % 3
        rows, turned = np.arange(count), mesh.turned[:, c]
        start = np.where(turned, LAST[c], NEXT[c])  # where the neighbour's edge begins and ends
        end = np.where(turned, NEXT[c], LAST[c])
        for step in (1, 2):
            edge = (corner + step) % 3
            weights = turns[there, edge]
            slot, factor = 5 + 2 * c + step, correction[:, c, 2 + step]
            stencil[:, slot] = np.where(mesh.bends[:, c], opposite[there, edge], stencil[:, slot])
            slopes[:, c, 3 + c] += factor * weights[rows, corner]
            slopes[rows, c, start] += factor * weights[rows, (corner + 1) % 3]
            slopes[rows, c, end] += factor * weights[rows, (corner + 2) % 3]
            slopes[:, c, slot] += factor * weights[:, 3]
    return stencil, slopes * mesh.length[:, :, None]


def _at_rest(mesh: Mesh, stencil: np.ndarray, slopes: np.ndarray, points: np.ndarray) -> np.ndarray:
    """l psi (T, 3) [m] at rest along the normals of triangles; takes what lies in their planes out of `slopes`.

    That part is a combination of the triangle's own edges, and the Hessian of a curved surface in its own coordinates
    has none (Gauss's formula). Without it a mesh that is curved at rest would not rest.
    """
    rest = slopes @ points[stencil]
    normal = (rest * mesh.normal[:, None, :]).sum(2)
    inside = rest - normal[:, :, None] * mesh.normal[:, None, :]
    edge = points[mesh.triangles[:, LAST]] - points[mesh.triangles[:, NEXT]]
    outward = np.cross(edge, mesh.normal[:, None, :]) / mesh.length[:, :, None]
    part = -(inside @ outward.transpose(0, 2, 1)) / mesh.height[:, None, :]
    slopes[:, :, :3] -= np.where(np.abs(part) > _EXACT, part, 0.0)
    return normal


def _stiffness(mesh: Mesh, weave: Weave) -> np.ndarray:
    """(T, 3, 3) [1/m^2]: A |H|^2 as a quadratic form of l psi at the edges, the least over the slopes at free edges.

    In the square of H = [[a, c], [c, b]], a^2 + 2 c^2 + b^2, the weave weighs the parts of weft b and twist c.
    """
    warp, weft = mesh.out[:, :, 0], mesh.out[:, :, 1]
    parts = np.stack([warp**2, math.sqrt(2.0 * weave.twist) * warp * weft, math.sqrt(weave.weft) * weft**2], axis=2)
    gram = parts @ parts.transpose(0, 2, 1)
    free = ~mesh.bends
    kept = np.where(free[:, :, None] | free[:, None, :], 0.0, gram)
    solved = free & ~free.all(axis=1, keepdims=True)
    pair = np.where(solved[:, :, None] & solved[:, None, :], gram, 0.0) + np.eye(3) * ~solved[:, :, None]
    mixed = np.where(free[:, :, None] & ~free[:, None, :], gram, 0.0)
    return (kept - mixed.transpose(0, 2, 1) @ np.linalg.solve(pair, mixed)) / mesh.area[:, None, None]


def _rows(
    first: np.ndarray, second: np.ndarray, weights: np.ndarray, count: int, tears: bool
) -> tuple[np.ndarray, np.ndarray, np.ndarray, tuple[np.ndarray, np.ndarray]]:
    """Neighbours and weights (N, W) from entries (i, j, w) of a symmetric matrix without its diagonal.

    A row that is not full names its own particle with weight 0. Also which sum each weight is (N, W), -1 for none, and
    of sums where each begins (S + 1,) in a list of entries, and that list. With `tears` sums that vanish are kept:
    what is left of them does not.
    """
    keep = np.flatnonzero((first != second) & (np.abs(weights) > _NOTHING * np.abs(weights).max()))
    first, second = first[keep].astype(np.int64), second[keep]
    key = np.minimum(first, second) * count + np.maximum(first, second)
    order = np.argsort(key)
    key, entries = key[order], keep[order]
    start = np.flatnonzero(np.concatenate([[True], key[1:] != key[:-1]]))
    total = np.add.reduceat(weights[entries], start)
    some = (np.abs(total) > _NOTHING * np.abs(total).max()) | tears
    low, high = np.divmod(key[start[some]], count)
    row, column = np.concatenate([low, high]), np.concatenate([high, low])
    ranked = np.argsort(row * count + column)
    row, column = row[ranked], column[ranked]
    number = np.bincount(row, minlength=count)
    place = np.arange(len(row)) - np.repeat(np.cumsum(number) - number, number)
    neighbours = np.repeat(np.arange(count, dtype=np.int32)[:, None], number.max(), axis=1)
    result = np.zeros(neighbours.shape)
    sums = np.full(neighbours.shape, -1)
    neighbours[row, place], result[row, place] = column, np.tile(total[some], 2)[ranked]
    sums[row, place] = np.tile(np.flatnonzero(some), 2)[ranked]
    return neighbours, result, sums, (np.append(start, len(key)), entries)
