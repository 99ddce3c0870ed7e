# SPDX-License-Identifier: Apache-2.0
"""Twist of ropes, read by the host: twist, torsion and directors."""

from __future__ import annotations

import numpy as np

from cloth_sim_ros.sim.engine.batch import Batch


def read_twist(batch: Batch, name: str, world: int) -> np.void:
    """The row of state.Twist of a rope in one world."""
    return batch.read_body("twists", name, world)[0, 0]


def measure_twist(batch: Batch, name: str, world: int) -> dict[str, float]:
    """twist [rad] along the whole rope, and torsion [N m], its moment."""
    row = read_twist(batch, name, world)
    return {"twist": float(row["angle"]), "torsion": float(row["moment"])}


def directors(points: np.ndarray, rest: np.ndarray, row: np.void) -> np.ndarray:
    """Unit vectors (S, 3) across the segments of a rope, which turn with its material.

    points (N, 3) [m]; rest (S,) rest lengths [m]; row: its Twist. Parallel transport carries the start's vector along
    the rope. Then each vector turns by the share of the twist before its segment's middle. The first and the last
    segment are clamped and do not twist.
    """
    tangents = np.diff(points, axis=0)
    tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
    free = rest.copy()
    free[[0, -1]] = 0.0
    angles = float(row["angle"]) * (np.cumsum(free) - 0.5 * free) / free.sum()
    u, found = np.asarray(row["start"], dtype=np.float64), np.zeros_like(tangents)
    for k, t in enumerate(tangents):
        if k > 0:
            axis, cosine = np.cross(tangents[k - 1], t), float(tangents[k - 1] @ t)
            u = cosine * u + np.cross(axis, u) + (axis @ u) / max(1.0 + cosine, 1e-2) * axis
        found[k] = np.cos(angles[k]) * u + np.sin(angles[k]) * np.cross(t, u)
    return found
