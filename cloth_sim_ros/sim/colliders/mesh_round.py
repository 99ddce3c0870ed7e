# SPDX-License-Identifier: Apache-2.0
"""Test whether a closed surface of triangles is round everywhere, within a tolerance."""

from __future__ import annotations

import numpy as np
import warp as wp

from cloth_sim_ros.sim.colliders.mesh_distance import TREE, by_tree
from cloth_sim_ros.sim.kernels.compiled import compiled
from cloth_sim_ros.sim.kernels.intrinsics import load_address


@compiled
def _find_sharp(
    data: wp.uint64,
    size: wp.vec3,
    radius: float,
    within: float,
    points: wp.array(dtype=wp.vec3),
    normals: wp.array(dtype=wp.vec3),
    sharp: wp.array(dtype=int),
):
    p, n = points[wp.tid()], normals[wp.tid()]
    # From the first place on the surface is within what must be free of it.
    if by_tree(p - 2.0 * within * n, size, data)[3] >= 0.0:
        sharp[0] = 1
    elif wp.mesh_query_point_no_sign(load_address(data + TREE), p - radius * n, radius - within).result:
        sharp[0] = 1


def is_round(data: int, reach: float, points: np.ndarray, normals: np.ndarray, radius: float, within: float) -> bool:
    """True if a ball of this radius touches each vertex (N, 3) from inside, and protrudes by `within` [m] at most.

    data: the address of the surface on the CPU, where its tree is.
    """
    device = wp.get_device("cpu")
    sharp = wp.zeros(1, dtype=int, device=device)
    at, out = (wp.array(rows, dtype=wp.vec3, device=device) for rows in (points, normals))
    inputs = [data, wp.vec3(reach, 0.0, 0.0), radius, within, at, out, sharp]
    wp.launch(_find_sharp, dim=len(points), inputs=inputs, device=device)
    return sharp.numpy()[0] == 0
