# SPDX-License-Identifier: Apache-2.0
"""Signed distances of collider shapes against points sampled densely on their surfaces."""

import numpy as np
import pytest
from probed import signed_distances
from scipy.spatial import cKDTree

from cloth_sim_ros.sim import Box, Capsule, Cylinder, Ellipsoid, Plane, Sphere

rng = np.random.default_rng(7)
SAMPLES = 400_000


def on_sphere():
    points = rng.normal(size=(SAMPLES, 3))
    return points / np.linalg.norm(points, axis=1, keepdims=True)


def box_surface(half):
    points = rng.uniform(-1, 1, (SAMPLES, 3))
    axis = rng.integers(0, 3, SAMPLES)
    points[np.arange(SAMPLES), axis] = np.sign(points[np.arange(SAMPLES), axis])
    return points * half


def tube_surface(radius, half, ends):
    way = rng.uniform(0, 2 * np.pi, SAMPLES)
    side = np.stack([radius * np.cos(way), radius * np.sin(way), rng.uniform(-half, half, SAMPLES)], axis=1)
    return np.concatenate([side, ends])


def capsule_surface(radius, half):
    ends = radius * on_sphere()
    return tube_surface(radius, half, ends + np.sign(ends[:, 2:]) * (0, 0, half))


def cylinder_surface(radius, half):
    way, far = rng.uniform(0, 2 * np.pi, SAMPLES), radius * np.sqrt(rng.uniform(0, 1, SAMPLES))
    ends = np.stack([far * np.cos(way), far * np.sin(way), rng.choice([-half, half], SAMPLES)], axis=1)
    return tube_surface(radius, half, ends)


SHAPES = {
    "sphere": (Sphere(radius=0.3), lambda: 0.3 * on_sphere(), lambda p: np.linalg.norm(p, axis=1) < 0.3),
    "box": (
        Box(half_extents=(0.4, 0.1, 0.2)),
        lambda: box_surface((0.4, 0.1, 0.2)),
        lambda p: (np.abs(p) < (0.4, 0.1, 0.2)).all(axis=1),
    ),
    "capsule": (
        Capsule(radius=0.15, half_length=0.3),
        lambda: capsule_surface(0.15, 0.3),
        lambda p: np.linalg.norm(p - np.clip(p[:, 2:], -0.3, 0.3) * (0, 0, 1), axis=1) < 0.15,
    ),
    "cylinder": (
        Cylinder(radius=0.2, half_length=0.3),
        lambda: cylinder_surface(0.2, 0.3),
        lambda p: (np.hypot(p[:, 0], p[:, 1]) < 0.2) & (np.abs(p[:, 2]) < 0.3),
    ),
    **{
        f"ellipsoid {radii}": (
            Ellipsoid(radii=radii),
            lambda radii=radii: np.array(radii) * on_sphere(),
            lambda p, radii=radii: ((p / radii) ** 2).sum(axis=1) < 1.0,
        )
        for radii in ((0.4, 0.2, 0.1), (0.3, 0.3, 0.05), (0.05, 0.4, 0.4))
    },
}


@pytest.mark.long
@pytest.mark.parametrize("name", SHAPES)
def test_the_distance_is_that_of_the_nearest_point_of_the_surface(name):
    collider, surface, inside = SHAPES[name]
    points = rng.uniform(-1.2, 1.2, (4000, 3)) * collider.reach()
    points[:20, 0] = points[10:30, 1] = points[20:40, 2] = 0.0
    normals, found = signed_distances(collider, points)
    samples = surface()
    nearest, index = cKDTree(samples).query(points)
    wanted = np.where(inside(points), -nearest, nearest)
    np.testing.assert_allclose(found, wanted, atol=2e-3)
    assert (np.abs(found) <= nearest + 2e-5).all(), "no sample is nearer than the nearest point"
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0, atol=1e-5)
    away = nearest > 0.05
    onto = points - found[:, None] * normals
    assert np.abs(cKDTree(samples).query(onto[away])[0]).max() < 5e-3, "the normal leads back to the surface"


@pytest.mark.parametrize("name", SHAPES)
def test_the_reach_is_the_farthest_point(name):
    collider, surface, _ = SHAPES[name]
    assert collider.reach() == pytest.approx(np.linalg.norm(surface(), axis=1).max(), rel=0.01)


def test_a_plane_is_below_its_normal():
    normals, found = signed_distances(Plane(), np.array([[1.0, 2.0, 0.5], [0.0, 0.0, -2.0]]))
    np.testing.assert_allclose(found, [0.5, -2.0])
    np.testing.assert_allclose(normals, [[0, 0, 1], [0, 0, 1]])


@pytest.mark.parametrize("name", SHAPES)
def test_the_middle_has_a_way_out(name):
    """The nearest point of the surface lies at the distance found along the normal, and no point lies nearer."""
    collider, surface, _ = SHAPES[name]
    normals, found = signed_distances(collider, np.zeros((1, 3)))
    nearest = cKDTree(surface())
    assert found[0] == pytest.approx(-nearest.query(np.zeros(3))[0], rel=0.02)
    assert nearest.query(-found[0] * normals[0])[0] < 0.02 * collider.reach()
