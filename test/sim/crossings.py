# SPDX-License-Identifier: Apache-2.0
"""Counts in float64 what goes through what, independently of the solver."""

import numpy as np


def edges_and_triangles(sim, name):
    """Positions (N, 3) of an object, its edges (E, 2) and triangles (T, 3); of a rope its segments and none."""
    x, faces = sim.positions(name).astype(float), sim.triangles(name)
    sides = np.concatenate([faces[:, [k, (k + 1) % 3]] for k in range(3)])
    edges = np.unique(np.sort(sides, 1), axis=0)
    if not len(faces):
        edges = np.stack([np.arange(len(x) - 1), np.arange(1, len(x))], 1)
    return x, edges, faces


def crossings(x, edges, y, faces, same):
    """How many of `edges` of x go through `faces` of y; of the `same` object those that share a particle do not
    count."""
    p, q = (x[edges[:, None, k]] for k in range(2))
    a, b, c = (y[faces[None, :, k]] for k in range(3))
    n = np.cross(b - a, c - a)
    from_p, from_q = ((n * (end - a)).sum(-1) for end in (p, q))
    across = from_p * from_q < 0.0
    if same:
        across &= ~(edges[:, None, :, None] == faces[None, :, None, :]).any((2, 3))
    i, j = np.nonzero(across)
    at = p[i, 0] + (from_p[i, j] / (from_p[i, j] - from_q[i, j]))[:, None] * (q[i, 0] - p[i, 0])
    corners = (a[0, j], b[0, j], c[0, j])
    sides = np.stack([(n[0, j] * np.cross(corners[k - 2] - corners[k], at - corners[k])).sum(-1) for k in range(3)])
    return int(((sides > 0.0).all(0) | (sides < 0.0).all(0)).sum())
