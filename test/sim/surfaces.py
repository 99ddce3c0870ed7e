# SPDX-License-Identifier: Apache-2.0
"""Points of surfaces and how far they are from boxes, in NumPy, for tests."""

import numpy as np


def points_of(sim, name="it", steps=20):
    """Points (M, 3) spread over every triangle or segment, in NumPy."""
    x = sim.positions(name).astype(float)
    index = np.arange(len(x))
    corners = sim.triangles(name) if len(sim.triangles(name)) else np.stack([index[:-1], index[1:], index[1:]], axis=1)
    u, v = np.meshgrid(*[np.linspace(0.0, 1.0, steps + 1)] * 2)
    u, v = u[u + v <= 1.0 + 1e-9], v[u + v <= 1.0 + 1e-9]
    a, b, c = (x[corners[:, k]][:, None] for k in range(3))
    return ((1.0 - u - v)[:, None] * a + u[:, None] * b + v[:, None] * c).reshape(-1, 3)


def outside_box(points, half, middle):
    """How far points (M, 3) are outside of a box that is not turned [m]; negative inside."""
    off = np.abs(points - middle) - half
    return np.linalg.norm(np.maximum(off, 0.0), axis=-1) + np.minimum(off.max(axis=-1), 0.0)
