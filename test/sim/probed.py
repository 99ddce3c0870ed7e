# SPDX-License-Identifier: Apache-2.0
"""The kernels' signed distances at points, for tests."""

import numpy as np
import warp as wp

from cloth_sim_ros.sim.colliders import make_signed_distance, mesh_distance, number_of, shape_of
from cloth_sim_ros.sim.kernels.compiled import compiled

wp.init()  # before a test gives caches another folder


def signed_distances(collider, points):
    """Normal (N, 3) and distance (N,) of the kernels' function at local points (N, 3)."""
    shape = shape_of(collider)
    signed_distance, number = make_signed_distance((shape,)), number_of(shape)

    @compiled(module="unique")
    def measure(at: wp.array(dtype=wp.vec3), size: wp.vec3, data: wp.uint64, found: wp.array(dtype=wp.vec4)):
        found[wp.tid()] = signed_distance(wp.static(number), at[wp.tid()], size, data)

    found = wp.zeros(len(points), dtype=wp.vec4, device="cpu")
    at = wp.array(np.asarray(points, np.float32), dtype=wp.vec3, device="cpu")
    data = collider.data(wp.get_device("cpu"))
    inputs = [at, wp.vec3(*collider.size()), wp.uint64(data.id if data else 0), found]
    wp.launch(measure, dim=len(points), inputs=inputs, device="cpu")
    return found.numpy()[:, :3], found.numpy()[:, 3]


def of_a_mesh(mesh, points):
    """What its grid says that the distance is not below (N,), and normal and distance (N, 4) by its tree."""

    @compiled(module="unique")
    def measure(
        at: wp.array(dtype=wp.vec3),
        size: wp.vec3,
        data: wp.uint64,
        least: wp.array(dtype=float),
        found: wp.array(dtype=wp.vec4),
    ):
        least[wp.tid()] = mesh_distance.at_least(at[wp.tid()], data)
        found[wp.tid()] = mesh_distance.by_tree(at[wp.tid()], size, data)

    least, found = (wp.zeros(len(points), dtype=kind, device="cpu") for kind in (float, wp.vec4))
    at, data = wp.array(np.asarray(points, np.float32), dtype=wp.vec3, device="cpu"), mesh.data(wp.get_device("cpu"))
    inputs = [at, wp.vec3(*mesh.size()), wp.uint64(data.id), least, found]
    wp.launch(measure, dim=len(points), inputs=inputs, device="cpu")
    return least.numpy(), found.numpy()
