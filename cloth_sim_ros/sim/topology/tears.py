# SPDX-License-Identifier: Apache-2.0
"""Elements that fail with a spring of a sheet: bending springs that lie over it, and triangles at it (NumPy)."""

from __future__ import annotations

import numpy as np

from cloth_sim_ros.sim.topology.elements import Topology
from cloth_sim_ros.sim.topology.springs import numbers_of


def under_bends(topology: Topology) -> np.ndarray:
    """Numbers (B, 2 or 5) of the structural springs that each bending spring lies over.

    On a grid these are the two along it, on a mesh the five edges of the two triangles that it joins.
    """
    if "bending" not in topology.springs:
        return np.zeros((0, 2), int)
    first, second = topology.springs["bending"].particles.T
    if topology.grid is not None:
        middle = (first + second) // 2
        pairs = [(first, middle), (middle, second)]
    else:
        edges = topology.springs["structural"].particles
        triangles = np.bincount(_numbers(topology, _sides(topology.triangles)).ravel(), minlength=len(edges))
        u, v = edges[triangles == 2].T
        pairs = [(u, v), (first, u), (first, v), (second, u), (second, v)]
    return _numbers(topology, np.stack([np.stack(pair, axis=-1) for pair in pairs], axis=1))


def at_triangles(topology: Topology) -> tuple[np.ndarray, np.ndarray]:
    """Numbers (T, 3) of the structural and of the shear springs that are sides of triangles, -1 where there is none."""
    sides = _sides(topology.triangles)
    kinds = ("structural", "shear")
    return tuple(_numbers(topology, sides, kind) for kind in kinds)


def _sides(triangles: np.ndarray) -> np.ndarray:
    """(T, 3, 2) particles."""
    return np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=-1)


def _numbers(topology: Topology, pairs: np.ndarray, kind: str = "structural") -> np.ndarray:
    """Numbers of the springs of a kind between pairs (..., 2) of particles, -1 where there is none."""
    if kind not in topology.springs:
        return np.full(pairs.shape[:-1], -1)
    return numbers_of(topology.springs[kind].particles, pairs, len(topology.masses))
