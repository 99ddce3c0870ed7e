# SPDX-License-Identifier: Apache-2.0
"""A rope as a tube: rings of vertices around its particles, with frames that do not twist from ring to ring."""

from __future__ import annotations

import numpy as np

from cloth_sim_ros.sim.physics.quaternion import quaternion_product, rotate

SIDES = 10  # corners of a ring
_SHORTEST = 1e-9  # [m] below this two particles lie at one place, as on a winch's drum


def tube_vertices(points: np.ndarray, radius: float) -> np.ndarray:
    """Return vertices (N * SIDES + 2, 3) [m] of a tube around `points` (N, 3) [m]; the last two close it."""
    tangents = _tangents(points)
    turns = _scan(_between(tangents[:-1], tangents[1:]))
    first = np.cross(tangents[0], np.eye(3)[np.argmin(np.abs(tangents[0]))])
    first /= np.linalg.norm(first)
    normals = rotate(np.concatenate([[[0.0, 0.0, 0.0, 1.0]], turns]), first)
    normals -= (normals * tangents).sum(axis=1)[:, None] * tangents  # what rounding has left
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    others = np.cross(tangents, normals)
    angle = np.arange(SIDES) * (2.0 * np.pi / SIDES)
    around = np.cos(angle)[:, None] * normals[:, None] + np.sin(angle)[:, None] * others[:, None]
    rings = points[:, None] + radius * around
    return np.concatenate([rings.reshape(-1, 3), points[:1], points[-1:]])


def tube_faces(count: int) -> np.ndarray:
    """Return triangles (T, 3) of the tube around `count` points."""
    ring, side = np.meshgrid(np.arange(count - 1), np.arange(SIDES), indexing="ij")
    a, b = ring * SIDES + side, ring * SIDES + (side + 1) % SIDES
    wall = [np.stack([a, b, b + SIDES], axis=-1), np.stack([a, b + SIDES, a + SIDES], axis=-1)]
    here, following = np.arange(SIDES), (np.arange(SIDES) + 1) % SIDES
    last, tip = (count - 1) * SIDES, count * SIDES
    start = np.stack([following, here, np.full(SIDES, tip)], axis=-1)
    end = np.stack([last + here, last + following, np.full(SIDES, tip + 1)], axis=-1)
    return np.concatenate([part.reshape(-1, 3) for part in (*wall, start, end)])


def _tangents(points: np.ndarray) -> np.ndarray:
    """Return unit directions (N, 3) at the points: means of the segments beside each.

    A segment of no length counts as the next.
    """
    segments = np.diff(points, axis=0)
    lengths = np.linalg.norm(segments, axis=1)
    good = np.flatnonzero(lengths > _SHORTEST)
    if not len(good):
        return np.tile([0.0, 0.0, 1.0], (len(points), 1))
    of = good[np.minimum(np.searchsorted(good, np.arange(len(segments))), len(good) - 1)]
    segments = segments[of] / lengths[of, None]
    sums = np.concatenate([segments[:1], segments[:-1] + segments[1:], segments[-1:]])
    sums[1:-1] += 1e-6 * segments[1:]  # a rope that folds right back has a direction too
    return sums / np.linalg.norm(sums, axis=1)[:, None]


def _between(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return quaternions (N, 4) x y z w of the smallest rotations from unit vectors a to b."""
    quaternions = np.concatenate([np.cross(a, b), 1.0 + (a * b).sum(axis=1)[:, None]], axis=1)
    quaternions[:, 3] += 1e-9  # opposite vectors leave the frame as it is
    return quaternions / np.linalg.norm(quaternions, axis=1)[:, None]


def _scan(turns: np.ndarray) -> np.ndarray:
    """Return the products turns[k] ... turns[0] for every k, in log2(N) steps."""
    result, step = turns.copy(), 1
    while step < len(result):
        result[step:] = quaternion_product(result[step:], result[:-step].copy())
        step *= 2
    return result
