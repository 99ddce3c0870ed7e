# SPDX-License-Identifier: Apache-2.0
"""Momentum: kept without outside forces, whatever springs, dashpots and ropes do within."""

import numpy as np
import pytest
from fixed_settings import fixed

from cloth_sim_ros.sim import Cloth, Rope, Scene, Simulation
from cloth_sim_ros.study.closed_forms import oscillator

FREE = {"gravity": (0.0, 0.0, 0.0)}


def thrown(thing, velocities, device, **settings):
    """A simulation of `thing` without gravity, started with `velocities` (N, 3) or a function of the positions."""
    sim = Simulation(Scene(objects={"it": thing}, **FREE), fixed(**settings), device=device)
    if callable(velocities):
        velocities = velocities(sim.rest_positions("it").astype(np.float64))
    sim.set_velocities("it", velocities)
    return sim


def momenta(sim):
    """Linear momentum, angular momentum about the centre of mass, and sum of m |v|."""
    m = sim.masses("it")
    x, v = sim.positions("it").astype(np.float64), sim.velocities("it").astype(np.float64)
    linear = m @ v
    arm, rate = x - m @ x / m.sum(), v - linear / m.sum()
    return linear, m @ np.cross(arm, rate), m @ np.linalg.norm(v, axis=1)


def spinning(rate):
    return lambda x: np.cross(np.asarray(rate, dtype=np.float64), x - x.mean(axis=0))


SHEET = Cloth(resolution=(12, 12), pins=None, stretch_compliance=1e-3, shear_compliance=2e-3)
ROPE = Rope(start=(0, 0, 0), end=(1, 0, 0), segments=20, pins=None)


@pytest.mark.parametrize("damping, substeps", [(0.0, 20), (0.01, 20), (0.0, 77), (0.0, 320)])
@pytest.mark.parametrize("shape", ["cloth", "rope"])
def test_linear_momentum_is_kept(device, shape, damping, substeps):
    """Also over many small substeps, where each may round but none may round one way."""
    thing = SHEET if shape == "cloth" else ROPE
    thing = type(thing)(**{**vars(thing), "damping": damping})
    rng = np.random.default_rng(5)
    sim = thrown(thing, lambda x: 0.1 * rng.standard_normal(x.shape) + [3.0, -2.0, 1.0], device, substeps=substeps)
    start, _, scale = momenta(sim)
    frames = 60
    sim.step(frames=frames)
    assert np.abs(momenta(sim)[0] - start).max() < 1e-6 * frames * scale


@pytest.mark.parametrize("axis", [(0.0, 0.0, 3.0), (2.0, 0.0, 2.0)])
def test_spinning_cloth_keeps_its_angular_momentum_for_a_second(device, axis):
    sim = thrown(SHEET, spinning(axis), device)
    start = momenta(sim)[1]
    sim.step(frames=60)
    assert np.linalg.norm(momenta(sim)[1] - start) < 0.01 * np.linalg.norm(start)


def test_second_order_keeps_angular_momentum_far_better(device):
    lost = {}
    for order in (1, 2):
        sim = thrown(SHEET, spinning((0.0, 0.0, 6.0)), device, order=order, iterations=4)
        start = momenta(sim)[1][2]
        sim.step(frames=60)
        lost[order] = abs(momenta(sim)[1][2] / start - 1.0)
    assert lost[2] < 0.05 * lost[1]


@pytest.mark.parametrize("damping", [0.0, 1.0])
def test_rigid_rotation_loses_only_what_implicit_euler_loses(device, damping):
    """A stiff dumbbell keeps the share of its spin that implicit Euler's closed form gives, dashpot or not."""
    rate, substeps, frames = 4.0, 20, 60
    rope = Rope(start=(-0.5, 0, 0), end=(0.5, 0, 0), segments=1, pins=None, stretch_compliance=1e-9, damping=damping)
    sim = thrown(rope, spinning((0.0, 0.0, rate)), device, order=1, substeps=substeps)
    start = momenta(sim)[1][2]
    sim.step(frames=frames)
    expected = oscillator.implicit_rotation(rate, 1.0 / (60 * substeps), frames * substeps)
    assert momenta(sim)[1][2] / start == pytest.approx(expected, abs=2e-4)


def test_dashpots_end_the_stretching_and_leave_the_flight(device):
    rope = Rope(start=(0, 0, 0), end=(1, 0, 0), segments=1, pins=None, stretch_compliance=1e-2, damping=0.05)
    sim = thrown(rope, [[1.0, 0.5, 0.0], [2.0, 0.5, 0.0]], device)
    sim.step(frames=120)
    assert np.abs(sim.velocities("it") - [1.5, 0.5, 0.0]).max() < 1e-4


def test_global_damping_decays_all_momentum_exponentially(device):
    sim = thrown(SHEET, lambda x: np.full(x.shape, [1.0, 2.0, -1.0]), device, global_damping=0.7)
    sim.step(frames=60)
    assert sim.velocities("it") == pytest.approx(np.full((144, 3), [1.0, 2.0, -1.0]) * np.exp(-0.7), rel=1e-3)
