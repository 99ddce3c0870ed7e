# SPDX-License-Identifier: Apache-2.0
"""Colliders as triangles, to be drawn."""

from __future__ import annotations

from trimesh import Trimesh
from trimesh.creation import box, capsule, cylinder, icosphere

from cloth_sim_ros.sim import Box, Capsule, Cylinder, Ellipsoid, Mesh, Plane, Sphere
from cloth_sim_ros.sim.colliders.collider import Collider

WIDE = 20.0  # [m] of a plane, as it is drawn


def mesh_of(collider: Collider) -> Trimesh | None:
    """What to draw of a collider, in its axes; None where it has no triangles."""
    if isinstance(collider, Sphere):
        return icosphere(3, collider.radius)
    if isinstance(collider, Ellipsoid):
        ball = icosphere(3, 1.0)
        return Trimesh(ball.vertices * collider.radii, ball.faces, process=False)
    if isinstance(collider, Box):
        return box([2.0 * half for half in collider.half_extents])
    if isinstance(collider, Cylinder):
        return cylinder(collider.radius, 2.0 * collider.half_length, sections=48)
    if isinstance(collider, Capsule):
        tube = capsule(2.0 * collider.half_length, collider.radius)
        return tube.apply_translation(-tube.bounds.mean(axis=0))
    if isinstance(collider, Plane):
        return box((WIDE, WIDE, 0.01)).apply_translation((0.0, 0.0, -0.005))
    if isinstance(collider, Mesh):
        return Trimesh(collider.points(), collider.triangles, process=False)
    return None
