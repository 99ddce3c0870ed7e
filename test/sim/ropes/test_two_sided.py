# SPDX-License-Identifier: Apache-2.0
"""Direct solves along a chain on a CPU, from both its ends: what they find is what a dense matrix in float64 finds."""

import numpy as np
import pytest
from scipy.optimize import root
from scipy.spatial.transform import Rotation

from cloth_sim_ros.sim import Rope, Scene, Settings, Simulation
from cloth_sim_ros.sim.ropes.beam import STIFFEST as STIFFEST_BEAM
from cloth_sim_ros.sim.ropes.elimination import FEWEST
from cloth_sim_ros.sim.ropes.segments import STIFFEST

H = 1e-3
G = 9.81


def rope_of(segments, pins, load, **material):
    """A crooked rope of 1 m, with a load at its end."""
    random = np.random.default_rng(segments)
    x = np.linspace(0.0, 1.0, segments + 1)
    points = np.column_stack([x, 0.3 * x**2, 0.1 * np.sin(4.0 * x)]) + 2e-3 * random.standard_normal((segments + 1, 3))
    masses = np.full(segments + 1, 0.2 / segments)
    masses[-1] += 0.2 * load
    return Rope(points=points, particle_masses=masses, pins=pins, **material)


def state_of(sim):
    """Positions (N, 3) with what float32 lost of them, velocities and tensions, in float64."""
    arrays, span, _ = sim.device_arrays("it")
    high, lo = (rows[span].numpy()[:, :3].astype(float) for rows in (arrays.state.positions, arrays.state.position_lo))
    return high + lo, sim.velocities("it").astype(float), arrays.state.rope.tensions.numpy().astype(float)


def dense_step(rope, rest, x, v, tensions):
    """Velocities and tensions after one substep of implicit Euler, one Newton step from where the tensions of the last
    one are kept."""
    n = len(rest)
    w = np.where(np.isin(np.arange(n + 1), rope.pins or ()), 0.0, 1.0 / rope.particle_masses)
    free = np.repeat(w > 0.0, 3)
    predicted = np.where(w[:, None] > 0.0, H * v + H * H * np.array([0.0, 0.0, -G]), 0.0)
    e, change = np.diff(x + predicted, axis=0), np.diff(predicted, axis=0)
    length, before = np.linalg.norm(e, axis=1), np.linalg.norm(e - change, axis=1)
    gamma, pull = rope.damping / H, H * H * tensions
    alpha = rope.stretch_compliance * rest / H**2
    least = np.maximum(1e-9 * np.maximum(w[:-1], w[1:]), STIFFEST / rope.particle_masses.sum())
    gap = (length - rest - alpha * pull + gamma * (length - before)) / (1.0 + gamma)
    alpha = np.maximum(alpha / (1.0 + gamma), least)
    across = np.maximum(pull, 0.0) / length
    matrix, right = np.diag(np.repeat(rope.particle_masses, 3)), np.zeros(3 * n + 3)
    stiffness = []
    for k in range(n):
        direction = e[k] / length[k]
        along = np.outer(direction, direction)
        stiffness.append(across[k] * (np.eye(3) - along) + along / alpha[k])
        ends = np.arange(3 * k, 3 * k + 6)
        matrix[np.ix_(ends, ends)] += np.kron([[1, -1], [-1, 1]], stiffness[-1])
        right[ends] += np.kron([1, -1], direction * (pull[k] + gap[k] / alpha[k]))
    moved = np.zeros(3 * n + 3)
    moved[free] = np.linalg.solve(matrix[np.ix_(free, free)], right[free])
    moved = moved.reshape(-1, 3)
    gains = np.einsum("ki,kij,kj->k", e / length[:, None], stiffness, np.diff(moved, axis=0)) + gap / alpha
    gains[(w[:-1] == 0.0) & (w[1:] == 0.0)] = 0.0
    return (predicted + moved) / H, tensions + gains / H**2


@pytest.mark.parametrize("segments", [FEWEST, 9, 14, 17])
@pytest.mark.parametrize("pins", [None, (0,), (0, 1, -3), (0, -1)])
@pytest.mark.parametrize(
    ("load", "compliance", "damping"), [(0.0, 1e-3, 0.0), (0.0, 1e-3, 2e-3), (1e4, 1e-5, 0.0), (1e4, 0.0, 0.0)]
)
@pytest.mark.long
def test_a_substep_is_what_a_dense_matrix_finds(segments, pins, load, compliance, damping):
    pins = pins and tuple(pin % (segments + 1) for pin in pins)
    rope = rope_of(segments, pins, load, stretch_compliance=compliance, damping=damping)
    sim = Simulation(Scene({"it": rope}), Settings(method="xpbd", order=1, substeps=1, frame_dt=H), device="cpu")
    rest = sim.springs("it")["structural"][1].astype(float)
    sim.set_velocities("it", 0.3 * np.random.default_rng(1).standard_normal((segments + 1, 3)))
    sim.step(20)
    before = state_of(sim)
    sim.step()
    _, v, tensions = state_of(sim)
    wanted_v, wanted_tensions = dense_step(rope, rest, *before)
    assert v == pytest.approx(wanted_v, abs=1e-3 * np.abs(wanted_v).max())
    assert tensions == pytest.approx(wanted_tensions, abs=1e-2 * np.abs(wanted_tensions).max())


def dense_bending(masses, turns, stiff, x, rest, moved, held):
    """Displacements of particles of masses (N,), `inf` where pinned, and moments, stiffness times what turn vectors
    lack. Both are those after a solve from x + moved, of which `moved` knows `held`. The rest shape turns so that they
    bear no torque.
    """
    turned = turns @ x
    points = rest[:, None] * turned / np.linalg.norm(turned, axis=1)[:, None]
    free = np.isfinite(masses)
    matrix = np.diag(np.where(free, masses, 0.0)) + turns.T @ (stiff[:, None] * turns)

    def solved(vector):
        now = Rotation.from_rotvec(vector).apply(points)
        right = -turns.T @ (stiff[:, None] * (turns @ (x + moved) - now) - held)
        after = moved.copy()
        after[free] += np.linalg.solve(matrix[np.ix_(free, free)], right[free])
        return after, stiff[:, None] * (turns @ (x + after) - now), now

    def torque(vector):
        _, moments, now = solved(vector)
        return np.cross(now, moments).sum(axis=0) / stiff.max()

    found = root(torque, np.zeros(3), tol=1e-12)
    assert np.abs(found.fun).max() < 1e-12
    return solved(found.x)[:2]


@pytest.mark.parametrize("segments", [4, FEWEST, 9, 17])
@pytest.mark.parametrize("pins", [None, (0,), (0, 1), (0, 3, 4)])
@pytest.mark.parametrize("compliance", [1e2, 1.0])
@pytest.mark.parametrize("bent", [0.0, 0.5, 1.0])
def test_bending_is_what_a_dense_matrix_finds(segments, pins, compliance, bent):
    """Of a rope that stretches as if there were nothing, which is moved from a rest shape of which so much is bent."""
    x = np.linspace(0.0, 1.0, segments + 1)
    points = np.column_stack([x, 0.3 * np.maximum(x - 1.0 + bent, 0.0) ** 2, 0.0 * x])
    masses = np.full(segments + 1, 0.2 / segments)
    material = {"stretch_compliance": 1e6, "bend_compliance": compliance}
    rope = Rope(points=points, particle_masses=masses, pins=pins, **material)
    sim = Simulation(Scene({"it": rope}), Settings(method="xpbd", order=1, substeps=1, frame_dt=H), device="cpu")
    random = np.random.default_rng(1).standard_normal((segments + 1, 3))
    sim.set_velocities("it", 0.3 * random + np.cross((3.0, 5.0, 8.0), points))
    sim.step(5)
    x, v, _ = state_of(sim)
    arrays, _, _ = sim.device_arrays("it")
    moments = arrays.state.rope.moments.numpy()[: segments - 1].astype(float)
    rest, span, before, behind = arrays.model.joints.numpy()[: segments - 1].astype(float).T
    sim.step()
    masses = np.where(np.isin(np.arange(segments + 1), rope.pins or ()), np.inf, masses)
    w = 1.0 / masses
    turns = np.zeros((segments - 1, segments + 1))
    for j in range(segments - 1):
        turns[j, j : j + 3] = before[j], -before[j] - behind[j], behind[j]
    heaviest = [w[j : j + 3].max() for j in range(segments - 1)]
    stiff = 1.0 / np.maximum(compliance * span / H**2, heaviest * (before + behind) ** 2 / STIFFEST_BEAM)
    held = np.where(rest[:, None] > 0.0, 0.0, H * H * moments)
    moved = H * v + H * H * np.array([0.0, 0.0, -G]) - w[:, None] * (turns.T @ held)
    moved[w == 0.0] = 0.0
    moved, wanted = dense_bending(masses, turns, stiff, x, rest, moved, held)
    assert sim.velocities("it") == pytest.approx(moved / H, abs=1e-3 * np.abs(moved / H).max())
    found = H * H * arrays.state.rope.moments.numpy()[: segments - 1]
    assert found == pytest.approx(wanted, abs=1e-3 * np.abs(wanted).max())


@pytest.mark.long
@pytest.mark.parametrize("segments", [9, 32])
def test_a_stiff_rod_that_falls_stays_straight_and_level(segments):
    """In single precision it bends and drifts by centimetres a second, since its stiffness is 1e5 times its inertia."""
    rod = Rope(
        start=(0, 0, 0),
        end=(1, 0, 0),
        segments=segments,
        mass=0.2,
        pins=None,
        stretch_compliance=1e-5,
        bend_compliance=1e-9,
    )
    sim = Simulation(Scene({"it": rod}), Settings(method="xpbd", order=2, substeps=20), device="cpu")
    sim.step(60)
    x = sim.positions("it").astype(float)
    assert x[:, 0] == pytest.approx(np.linspace(0.0, 1.0, segments + 1), abs=1e-6)
    assert np.ptp(x[:, 1:], axis=0) == pytest.approx(0.0, abs=1e-6)


def test_chains_too_short_for_two_walks_swing_as_longer_ones_do():
    """A pendulum of so many rigid segments, the last one loaded, on both sides of where walks from both ends begin."""
    found = []
    for segments in (FEWEST - 1, FEWEST):
        masses = np.full(segments + 1, 1e-4)
        masses[-1] = 1.0
        rope = Rope(
            start=(0, 0, 0), end=(0.6, 0, -0.8), segments=segments, particle_masses=masses, stretch_compliance=0.0
        )
        sim = Simulation(Scene({"it": rope}), Settings(method="xpbd", order=2, substeps=20), device="cpu")
        sim.step(30)
        found.append(sim.positions("it")[-1])
    assert found[0] == pytest.approx(found[1], abs=1e-4)
