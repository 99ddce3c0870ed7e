# SPDX-License-Identifier: Apache-2.0
"""Dry contact in float64, to judge the solver by: explicit steps, then a projection out of colliders.

In the limit of small steps this is a plastic impact (no rebound) with Coulomb's friction, which falls from the static
to the kinetic coefficient as a slip gets faster (Stribeck 1902). It is first order in the step. The code shares nothing
with the solver that it judges.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from cloth_sim_ros.sim import Cloth, Plane, Rope, Sphere
from cloth_sim_ros.study.motion import Step
from cloth_sim_ros.study.springs import SpringSystem

SLOW = 0.05  # slip [m/s] from which on friction is kinetic; slower slips have more, up to the static friction at rest


@dataclass(frozen=True)
class Obstacle:
    """`surface`(x (N, 3)) -> outward normals (N, 3) and distances (N,) [m] of the middle surface; and friction."""

    surface: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
    static_friction: float
    kinetic_friction: float


def obstacle(collider: Plane | Sphere, body: Cloth | Rope) -> Obstacle:
    """Return a resting collider as `body` meets it. Raises ValueError for a shape that the study lacks."""
    thickness = body.radius if isinstance(body, Rope) else body.thickness
    position = np.asarray(collider.position)

    def plane(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        normal = np.asarray(collider.normal)
        return np.broadcast_to(normal, x.shape), (x - position) @ normal - thickness

    def sphere(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        distance = np.linalg.norm(x - position, axis=1)
        return (x - position) / distance[:, None], distance - collider.radius - thickness

    shapes = {Plane: plane, Sphere: sphere}
    if type(collider) not in shapes:
        raise ValueError(f"a {type(collider).__name__} has no exact motion; allowed are Plane and Sphere")
    static = float(np.sqrt(collider.static_friction * body.static_friction))
    kinetic = float(np.sqrt(collider.kinetic_friction * body.kinetic_friction))
    return Obstacle(shapes[type(collider)], static, kinetic)


def projected_leapfrog(obstacles: Iterable[Obstacle]) -> Step:
    """A kick and a drift, then for each obstacle the normal and the tangential correction of friction (Moreau 1988)."""
    obstacles = tuple(obstacles)

    def step(system: SpringSystem, x: np.ndarray, v: np.ndarray, h: float) -> tuple[np.ndarray, np.ndarray]:
        d = h * (v + h * system.accelerations(x, v))
        for each in obstacles:
            normal, gap = each.surface(x + d)
            pressed = np.where(system.fixed, 0.0, np.clip(-gap, 0.0, None))
            d = d + pressed[:, None] * normal
            slip = d - (d * normal).sum(axis=1, keepdims=True) * normal
            size = np.linalg.norm(slip, axis=1)
            beyond = size - each.static_friction * pressed
            fallen = np.clip(beyond / (SLOW * h), 0.0, 1.0) * (each.static_friction - each.kinetic_friction)
            friction = (each.static_friction - fallen) * pressed
            share = np.where(beyond > 0.0, friction / np.maximum(size, 1e-300), 1.0)
            d = d - np.where(pressed > 0.0, np.minimum(share, 1.0), 0.0)[:, None] * slip
        return x + d, d / h

    return step
