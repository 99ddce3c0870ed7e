# SPDX-License-Identifier: Apache-2.0
"""Poses, velocities and boxes of entities: NumPy on the host."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from cloth_sim_ros.ros.inputs.pose_track import Pose, composed
from cloth_sim_ros.sim import Handle, Plane, Simulation
from cloth_sim_ros.sim.colliders.collider import Collider
from cloth_sim_ros.sim.physics.quaternion import rotate
from cloth_sim_ros.sim.scene.handles import extents

NEAREST = 1e-6  # weight of the identity, which selects the smallest turn if a flat or straight object leaves it open

Box = tuple[np.ndarray, np.ndarray]  # lower and upper corner (3,) [m]


@dataclass(frozen=True)
class State:
    """pose; velocity [m/s] of its origin and angular velocity [rad/s], in world axes."""

    pose: Pose
    velocity: np.ndarray
    turning: np.ndarray


def state_of(sim: Simulation, name: str) -> State:
    """Return the state of an entity. For an object it is the best rigid motion of all particles, weighted by mass.

    An object that lies as at its start has the pose of its parameters.
    """
    if name not in sim.scene.objects:
        return State(Pose(sim.get(f"{name}.position"), sim.get(f"{name}.orientation")), np.zeros(3), np.zeros(3))
    thing, masses = sim.scene.objects[name], sim.masses(name)[:, None]
    rest, now, speeds = (a(name).astype(np.float64) for a in (sim.rest_positions, sim.positions, sim.velocities))
    before, middle, drift = ((masses * rows).sum(axis=0) / masses.sum() for rows in (rest, now, speeds))
    turn = best_turn(rest - before, now - middle, masses)
    start = Pose(tuple((np.asarray(thing.position) - before).tolist()), thing.orientation)
    pose = composed(Pose(tuple(middle.tolist()), turn), start)
    arms = now - middle
    inertia = (masses * arms).T @ arms
    turning = np.linalg.pinv(np.trace(inertia) * np.eye(3) - inertia, rcond=1e-6, hermitian=True) @ (
        masses * np.cross(arms, speeds - drift)
    ).sum(axis=0)
    return State(pose, drift + np.cross(turning, np.asarray(pose.position) - middle), turning)


def best_turn(before: np.ndarray, now: np.ndarray, weights: np.ndarray) -> tuple[float, float, float, float]:
    """Return the rotation x y z w of rows (N, 3) onto others by least squares.

    It is the eigenvector of the largest eigenvalue (Horn 1987).
    """
    s = (weights * before).T @ now
    s += NEAREST * max(np.linalg.norm(s), 1e-300) * np.eye(3)
    trace, odd = np.trace(s), np.array([[s[1, 2] - s[2, 1], s[2, 0] - s[0, 2], s[0, 1] - s[1, 0]]])
    even = s + s.T - trace * np.eye(3)
    vector = np.linalg.eigh(np.block([[np.array([[trace]]), odd], [odd.T, even]]))[1][:, -1]
    w, x, y, z = vector if vector[0] >= 0.0 else -vector
    return float(x), float(y), float(z), float(w)


def carried(points: np.ndarray, before: Pose, after: Pose) -> np.ndarray:
    """Return points (N, 3) [m] moved along with a pose."""
    return rotate(after.orientation, _local(points, before)) + after.position


def _local(points: np.ndarray, pose: Pose) -> np.ndarray:
    x, y, z, w = pose.orientation
    return rotate((-x, -y, -z, w), points - pose.position)


def box_of(sim: Simulation, name: str, pose: Pose) -> Box | None:
    """Return the bounding box of an entity in the axes of its `pose`; None if it is unbounded."""
    if name in sim.scene.objects:
        points = _local(sim.positions(name).astype(np.float64), pose)
        return points.min(axis=0), points.max(axis=0)
    thing = sim.scene.handles.get(name) or sim.scene.colliders[name]
    if isinstance(thing, Handle):
        half = np.asarray(extents(thing.reach)[:3])
        return -half, half
    return _of_collider(thing)


def _of_collider(collider: Collider) -> Box | None:
    solids = [] if isinstance(collider, Plane) else collider.solids()
    if not solids:
        return None
    lows, highs = [], []
    for solid in solids:
        half = 0.0 if solid.kind == "triangles" else 0.5 * np.asarray(solid.scale)
        points = np.zeros((1, 3)) if solid.points is None else solid.points
        points = points + np.asarray(solid.middle)
        lows.append(points.min(axis=0) - half)
        highs.append(points.max(axis=0) + half)
    return np.min(lows, axis=0), np.max(highs, axis=0)


def in_world(box: Box, pose: Pose) -> Box:
    """Return the box along the axes of the world around a box in the axes of `pose`."""
    corners = rotate(pose.orientation, np.array(list(itertools.product(*zip(*box, strict=True))))) + pose.position
    return corners.min(axis=0), corners.max(axis=0)
