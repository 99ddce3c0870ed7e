# SPDX-License-Identifier: Apache-2.0
"""Where a triangle or segment is deepest in a collider, against sampling of the whole facet."""

import numpy as np
import pytest
import trimesh
import warp as wp

from cloth_sim_ros.sim import Box, Capsule, Cylinder, Ellipsoid, Mesh, Sphere
from cloth_sim_ros.sim.colliders import make_signed_distance, number_of, shape_of
from cloth_sim_ros.sim.features.collider_contact.facet import Facet, point_of
from cloth_sim_ros.sim.features.collider_contact.facet_search import make_deepest

SHAPES = {
    "sphere": Sphere(radius=0.1),
    "capsule": Capsule(radius=0.02, half_length=0.3),
    "box": Box(half_extents=(0.1, 0.2, 0.05)),
    "cylinder": Cylinder(radius=0.1, half_length=0.05),
    "ellipsoid": Ellipsoid(radii=(0.2, 0.1, 0.05)),
}
NAMES = tuple(sorted(SHAPES))
STEPS = 60
deepest, of_segment = (make_deepest(NAMES, segments) for segments in (False, True))
distance = make_signed_distance(NAMES)

MESH = number_of("mesh")
of_mesh, in_mesh = (make_deepest(("mesh",), segments) for segments in (False, True))
to_mesh = make_signed_distance(("mesh",))
STEP = 1.2e-3  # [m], twice the thickness of cotton
FARTHEST = 10.0  # thickness [m] with which no distance is only bounded


@wp.kernel(enable_backward=False)
def look_at_mesh(
    facets: wp.array(dtype=Facet), size: wp.vec3, data: wp.uint64, steps: int, found: wp.array2d(dtype=float),
):  # fmt: skip
    """Of each facet: the distance told, and the least of points spread over it [m]."""
    k = wp.tid()
    facet = facets[k]
    found[k, 0] = of_mesh(MESH, size, data, facet, wp.static(0.5 * STEP), wp.vec3(0.0)).value
    if facet.is_segment:
        found[k, 0] = in_mesh(MESH, size, data, facet, wp.static(0.5 * STEP), wp.vec3(0.0)).value
    least = float(1.0e30)
    for i in range(steps + 1):
        for j in range(wp.where(facet.is_segment, 1, steps + 1 - i)):
            u, v = float(i) / float(steps), float(j) / float(steps)
            least = wp.min(least, to_mesh(MESH, point_of(facet, wp.vec3(1.0 - u - v, u, v)), size, data)[3])
    found[k, 1] = least


@wp.kernel(enable_backward=False)
def look(facets: wp.array(dtype=Facet), shape: int, size: wp.vec3, steps: int, found: wp.array2d(dtype=float)):
    """Of each facet: the distance at the point found, and the least of points spread over it [m]."""
    k = wp.tid()
    facet = facets[k]
    best = deepest(shape, size, wp.uint64(0), facet, wp.static(FARTHEST), wp.vec3(0.0))
    if facet.is_segment:
        best = of_segment(shape, size, wp.uint64(0), facet, wp.static(FARTHEST), wp.vec3(0.0))
    found[k, 0] = distance(shape, point_of(facet, best.weights), size, wp.uint64(0))[3]
    least = float(1.0e30)
    for i in range(steps + 1):
        for j in range(wp.where(facet.is_segment, 1, steps + 1 - i)):
            u, v = float(i) / float(steps), float(j) / float(steps)
            least = wp.min(least, distance(shape, point_of(facet, wp.vec3(1.0 - u - v, u, v)), size, wp.uint64(0))[3])
    found[k, 1] = least


@wp.kernel(enable_backward=False)
def compare(
    facets: wp.array(dtype=Facet), shape: int, size: wp.vec3, points: wp.array(dtype=wp.vec3),
    found: wp.array2d(dtype=float),
):  # fmt: skip
    """Of each facet: the distance told, the least height of a corner over the plane told, and by how much that plane is
    above the distance of a point, at most [m]."""
    k = wp.tid()
    facet = facets[k]
    best = deepest(shape, size, wp.uint64(0), facet, 0.01, wp.vec3(0.0))
    if facet.is_segment:
        best = of_segment(shape, size, wp.uint64(0), facet, 0.01, wp.vec3(0.0))
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


@pytest.mark.parametrize("name", ["box", "torus"])
def test_the_deepest_point_in_a_scanned_surface_is_found(device, name):
    """Facets of 25 mm over sharp edges and in hollows, whose surface has 0.2 mm of noise."""
    random = np.random.default_rng(7)
    surface = trimesh.creation.torus(0.09, 0.03, 64, 32)
    if name == "box":
        surface = trimesh.creation.box(extents=(0.2, 0.1, 0.06))
        for _ in range(4):
            surface = surface.subdivide()
    scanned = Mesh(
        vertices=surface.vertices + random.normal(0.0, 2e-4, surface.vertices.shape), triangles=surface.faces
    )
    places, faces = trimesh.sample.sample_surface(surface, 4000, seed=7)
    out = surface.face_normals[faces]
    across = np.cross(out, random.normal(size=out.shape))
    across *= 0.025 / np.linalg.norm(across, axis=1, keepdims=True)
    corners = np.stack([places, places + across, places + np.cross(out, across)], axis=1)
    corners += random.uniform(-0.004, 0.004, (4000, 1, 1)) * out[:, None]
    segments = np.arange(4000) % 4 == 0
    corners[segments, 2] = corners[segments, 1]
    facets, found = facets_of(corners, segments, device), wp.zeros((4000, 2), dtype=float, device=device)
    on_device = scanned.data(wp.get_device(device))  # while this lives, the address holds
    inputs = [facets, wp.vec3(*scanned.size()), on_device.id, STEPS, found]
    wp.launch(look_at_mesh, dim=4000, inputs=inputs, device=device)
    told, sampled = found.numpy().T
    touching, missed = np.abs(sampled) < STEP, told - sampled
    assert touching.sum() > 500
    assert np.quantile(missed[touching], 0.95) < 0.2 * STEP
    assert missed.max() < STEP  # where two places are as deep, the search follows one
