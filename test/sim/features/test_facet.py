# SPDX-License-Identifier: Apache-2.0
"""Where a triangle or segment is deepest in a collider, against sampling of the whole facet."""

import numpy as np
import pytest
import warp as wp

from cloth_sim_ros.sim import Box, Capsule, Cylinder, Ellipsoid, Sphere
from cloth_sim_ros.sim.colliders import make_signed_distance, number_of, shape_of
from cloth_sim_ros.sim.features.collider_contact.facet import Facet, make_deepest, point_of

SHAPES = {
    "sphere": Sphere(radius=0.1),
    "capsule": Capsule(radius=0.02, half_length=0.3),
    "box": Box(half_extents=(0.1, 0.2, 0.05)),
    "cylinder": Cylinder(radius=0.1, half_length=0.05),
    "ellipsoid": Ellipsoid(radii=(0.2, 0.1, 0.05)),
}
NAMES = tuple(sorted(SHAPES))
STEPS = 60
deepest = make_deepest(NAMES)
distance = make_signed_distance(NAMES)


@wp.kernel
def look(facets: wp.array(dtype=Facet), shape: int, size: wp.vec3, steps: int, found: wp.array2d(dtype=float)):
    """Of each facet: the distance at the point found, and the least of points spread over it [m]."""
    k = wp.tid()
    facet = facets[k]
    found[k, 0] = distance(
        shape,
        point_of(facet, deepest(shape, size, wp.uint64(0), facet, 0.01, wp.vec3(0.0)).weights),
        size,
        wp.uint64(0),
    )[3]
    least = float(1.0e30)
    for i in range(steps + 1):
        for j in range(wp.where(facet.is_segment, 1, steps + 1 - i)):
            u, v = float(i) / float(steps), float(j) / float(steps)
            least = wp.min(least, distance(shape, point_of(facet, wp.vec3(1.0 - u - v, u, v)), size, wp.uint64(0))[3])
    found[k, 1] = least


@wp.kernel
def compare(
    facets: wp.array(dtype=Facet), shape: int, size: wp.vec3, points: wp.array(dtype=wp.vec3),
    found: wp.array2d(dtype=float),
):  # fmt: skip
    """Of each facet: the distance told, the least height of a corner over the plane told, and by how much that plane is
    above the distance of a point, at most [m]."""
    k = wp.tid()
    facet = facets[k]
    best = deepest(shape, size, wp.uint64(0), facet, 0.01, wp.vec3(0.0))
    g, c = wp.vec3(best.plane[0], best.plane[1], best.plane[2]), best.plane[3]
    found[k, 0] = best.value
    found[k, 1] = wp.min(wp.min(wp.dot(g, facet.a), wp.dot(g, facet.b)), wp.dot(g, facet.c)) + c
    most = float(-1.0e30)
    for i in range(points.shape[0]):
        most = wp.max(most, wp.dot(g, points[i]) + c - distance(shape, points[i], size, wp.uint64(0))[3])
    found[k, 2] = most


def facets_of(corners, segments, device):
    rows = np.zeros(len(corners), dtype=Facet.numpy_dtype())
    for place, name in enumerate("abc"):
        rows[name] = corners[:, place]
    rows["is_segment"] = segments
    return wp.array(rows, dtype=Facet, device=device)


@pytest.mark.parametrize("name", NAMES)
def test_the_deepest_point_is_found(device, name):
    random = np.random.default_rng(5)
    corners = random.normal(size=(4000, 3, 3)) * 0.05 + random.normal(size=(4000, 1, 3)) * 0.1
    segments = np.arange(4000) % 4 == 0
    corners[segments, 2] = corners[segments, 1]
    facets, found = facets_of(corners, segments, device), wp.zeros((4000, 2), dtype=float, device=device)
    size = wp.vec3(*SHAPES[name].size())
    wp.launch(look, dim=4000, inputs=[facets, number_of(shape_of(SHAPES[name])), size, STEPS, found], device=device)
    ours, sampled = found.numpy().T
    missed = np.maximum(ours - sampled, 0.0)
    assert (sampled < 0.0).sum() > 200
    assert missed.max() < 2e-4


@pytest.mark.parametrize("name", NAMES)
def test_a_plane_parts_a_facet_from_a_collider(device, name):
    """The distance is nowhere below what the plane says, and nowhere on the facet is that less than at the nearest."""
    random = np.random.default_rng(6)
    corners = random.normal(size=(2000, 3, 3)) * 0.05 + random.normal(size=(2000, 1, 3)) * 0.2
    segments = np.arange(2000) % 4 == 0
    corners[segments, 2] = corners[segments, 1]
    facets, found = facets_of(corners, segments, device), wp.zeros((2000, 3), dtype=float, device=device)
    points = wp.array(random.uniform(-0.4, 0.4, size=(2000, 3)), dtype=wp.vec3, device=device)
    size = wp.vec3(*SHAPES[name].size())
    wp.launch(compare, dim=2000, inputs=[facets, number_of(shape_of(SHAPES[name])), size, points, found], device=device)
    told, on_facet, above = found.numpy()[found.numpy()[:, 0] > 0.0].T
    assert len(told) > 500
    assert above.max() < 1e-6
    assert np.quantile(told - on_facet, 0.99) < 1e-4 and (told - on_facet).max() < 2e-3
