"""The gradient of the dihedral angle against differences of the angle, in float32 as the kernels use it."""

import numpy as np
import pytest
import warp as wp

from cloth_sim_ros.sim import Cloth, Scene, Settings, Simulation
from cloth_sim_ros.sim.physics.bending import hinge_gradients


@wp.kernel
def evaluate(points: wp.array2d(dtype=wp.vec3), angles: wp.array(dtype=float), gradients: wp.array2d(dtype=wp.vec3)):
    h = wp.tid()
    g = hinge_gradients(points[h, 0], points[h, 1], points[h, 2], points[h, 3])
    angles[h] = g.angle
    gradients[h, 0] = g.i
    gradients[h, 1] = g.j
    gradients[h, 2] = g.k
    gradients[h, 3] = g.l


def angle_of(p):
    """The angle of hinges (..., 4, 3) in float64."""
    i, j, k, m = np.moveaxis(p, -2, 0)
    e = j - i
    n1, n2 = np.cross(e, k - i), np.cross(m - i, e)
    return np.arctan2((np.cross(n1, n2) * e).sum(-1) / np.linalg.norm(e, axis=-1), (n1 * n2).sum(-1))


def test_the_gradient_is_that_of_the_angle(device):
    p = np.random.default_rng(5).standard_normal((40, 4, 3))
    p = p.astype(np.float32).astype(np.float64)
    angles, gradients = wp.zeros(40, dtype=float, device=device), wp.zeros((40, 4), dtype=wp.vec3, device=device)
    points = wp.array(p, dtype=wp.vec3, device=device)
    wp.launch(evaluate, dim=40, inputs=[points, angles, gradients], device=device)
    found, h = gradients.numpy(), 1e-6
    assert angles.numpy() == pytest.approx(angle_of(p), abs=1e-5)
    for corner, axis in np.ndindex(4, 3):
        step = np.zeros((4, 3))
        step[corner, axis] = h
        slope = (angle_of(p + step) - angle_of(p - step)) / (2 * h)
        assert found[:, corner, axis] == pytest.approx(slope, rel=1e-3, abs=1e-3)


def test_hinges_push_nobody_from_outside(device):
    """A crumpled free sheet with hinges alone keeps its linear and angular momentum."""
    sheet = Cloth(resolution=(8, 8), pins=None, bending="dihedral", bend_compliance=10.0, stretch_compliance=1e6)
    sim = Simulation(Scene({"it": sheet}, gravity=(0, 0, 0)), Settings(), device)
    x = sim.positions("it") + 0.04 * np.random.default_rng(2).standard_normal((64, 3))
    sim.set_positions("it", x)
    sim.step(3)
    x, v, m = sim.positions("it").astype(np.float64), sim.velocities("it").astype(np.float64), sim.masses("it")
    scale = m @ np.linalg.norm(v, axis=1)
    assert scale > 0.01
    assert np.abs(m @ v).max() < 1e-4 * scale and np.abs(m @ np.cross(x, v)).max() < 1e-2 * scale
