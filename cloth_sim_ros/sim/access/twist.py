# SPDX-License-Identifier: Apache-2.0
"""Twist of ropes, read by the host: twist, torsion and directors."""

from __future__ import annotations

import numpy as np

from cloth_sim_ros.sim.engine.batch import Batch
from cloth_sim_ros.sim.topology.rope import directors as carried


def read_twist(batch: Batch, name: str, world: int | None) -> np.ndarray:
    """The rows (worlds,) of state.Twist of a rope in one world or, for None, in all."""
    return batch.read_body("twists", name, world)[:, 0]


def measure_twist(batch: Batch, name: str, world: int) -> dict[str, float]:
    """twist [rad] along the whole rope, and torsion [N m], its moment."""
    row = read_twist(batch, name, world)[0]
    return {"twist": float(row["angle"]), "torsion": float(row["moment"])}


def directors(points: np.ndarray, angles: np.ndarray, start: np.ndarray) -> np.ndarray:
    """Unit vectors (..., S, 3) across the segments of a rope, which turn with its material.

    points (..., N, 3) [m]; angles (..., S) of the material about each segment [rad]; start (..., 3) of its Twist.
    Parallel transport carries the start's vector along the rope. Then each vector turns by its angle.
    """
    tangents = np.diff(points, axis=-2)
    tangents /= np.linalg.norm(tangents, axis=-1, keepdims=True)
    u = carried(tangents, start)
    return np.cos(angles)[..., None] * u + np.sin(angles)[..., None] * np.cross(tangents, u)
