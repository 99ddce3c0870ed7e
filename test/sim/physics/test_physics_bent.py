# SPDX-License-Identifier: Apache-2.0
"""Ropes with a bent rest shape. Let go, they gain no energy. Stiff ones swing as rigid bodies, and thrown ones keep
their angular momentum. They hang as a chain that is bent at rest does."""

import numpy as np
import pytest
from fixed_settings import fixed
from scipy.integrate import solve_ivp
from scipy.optimize import root

from cloth_sim_ros.sim import Rope, Scene, Settings, Simulation

G = 9.81
MASS = 0.1
PINS = {"clamped": [0, 1], "hung": [0], "free": None}


def arc(segments, turn):
    """Half a circle or so of length 1 that begins at the origin and bends down."""
    angles = 0.5 * turn - np.linspace(0.0, turn, segments)
    steps = np.stack([np.cos(angles), 0.0 * angles, np.sin(angles)], axis=1) / segments
    return np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])


def helix():
    """Three turns down."""
    angles = np.linspace(0.0, 6.0 * np.pi, 61)
    return np.stack([0.05 * np.cos(angles), 0.05 * np.sin(angles), -0.4 * angles / angles[-1]], axis=1)


def let_go(rope, start, device, **settings):
    """The most energy [J], kinetic and of height, that a rope gains in a second."""
    gravity = (0.0, 0.0, 0.0) if rope.pins is None else (0.0, 0.0, -G)
    sim = Simulation(Scene(objects={"it": rope}, gravity=gravity), fixed(**settings), device=device)
    sim.set_positions("it", start)
    masses = sim.masses("it")
    height = sim.positions("it").astype(float)[:, 2]
    most = 0.0
    for _ in range(60):
        sim.step(1)
        moving = np.isin(np.arange(len(masses)), rope.pins or [], invert=True)
        kinetic = 0.5 * (masses[:, None] * sim.velocities("it") ** 2)[moving].sum()
        lifted = -gravity[2] * (masses * (sim.positions("it")[:, 2] - height)).sum()
        most = max(most, kinetic + lifted)
    return most


def bending_energy(rope, start):
    turns = [np.linalg.norm(np.diff(x, n=2, axis=0), axis=1) * rope.segments for x in (start, rope.points)]
    return 0.5 * rope.segments / rope.bend_compliance * ((turns[0] - turns[1]) ** 2).sum()


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("compliance", [0.5, 1e-9])
@pytest.mark.parametrize("held", PINS)
@pytest.mark.long
def test_bent_rope_gains_no_energy(device, held, compliance, order):
    rope = Rope(points=arc(33, np.pi), pins=PINS[held], bend_compliance=compliance, mass=MASS)
    along = np.linspace(0.0, 1.0, 34)[:, None]
    near = rope.points + 0.01 * along**2 * np.sin(4.0 * along) * (0.0, 1.0, 0.0)
    # What a stiff joint stores beyond these, the first substep takes in.
    stored = min(bending_energy(rope, near), 0.01)
    assert let_go(rope, near, device, substeps=20, order=order) < stored + 0.02
    first = np.diff(rope.points, axis=0)[0] / np.linalg.norm(np.diff(rope.points, axis=0)[0])
    wave = 1e-3 * np.clip(along - along[1], 0.0, None) * (0.0, np.sin(5.0), np.cos(3.0))
    straight = along * first + wave
    stored = min(bending_energy(rope, straight), 500.0)
    assert let_go(rope, straight, device, substeps=20, order=order) < stored


@pytest.mark.parametrize("shape", ["fine", "helix"])
@pytest.mark.parametrize("iterations", [1, 4])
def test_fine_and_coiled_ropes_gain_none_either(device, shape, iterations):
    points = arc(100, 3.0) if shape == "fine" else helix()
    for pins in PINS.values():
        rope = Rope(points=points, pins=pins, bend_compliance=0.5, mass=MASS)
        assert let_go(rope, points, device, substeps=20, iterations=iterations) < 0.01


def swung(points, masses, lean, times):
    """By how much a rigid body that hangs by its first point leans [rad], let go where it leans by `lean`."""
    inertia = (masses * (points**2).sum(axis=1)).sum()
    lever = np.linalg.norm(masses @ points)
    course = solve_ivp(
        lambda _, y: [y[1], -G * lever / inertia * np.sin(y[0])], (0.0, times[-1]), [lean, 0.0], t_eval=times, rtol=1e-9
    )
    return course.y[0]


def zeros(times, course):
    """When a course changes its sign."""
    k = np.nonzero(course[:-1] * course[1:] < 0.0)[0]
    return times[k] + (times[k + 1] - times[k]) * course[k] / (course[k] - course[k + 1])


@pytest.mark.parametrize("rest", [0.0, np.pi])
@pytest.mark.parametrize("segments, compliance", [(4, 1e-9), (33, 1e-4)])
@pytest.mark.parametrize("substeps, iterations, order", [(20, 1, 1), (10, 1, 2), (20, 1, 2), (10, 4, 2)])
@pytest.mark.long
def test_stiff_rope_swings_as_a_rigid_pendulum(device, rest, segments, compliance, substeps, iterations, order):
    points = arc(segments, rest)
    rope = Rope(points=points, bend_compliance=compliance, mass=MASS, stretch_compliance=1e-6)
    settings = Settings(method="xpbd", substeps=substeps, iterations=iterations, order=order)
    sim = Simulation(Scene(objects={"it": rope}), settings, device=device)
    masses = sim.masses("it").astype(float)

    def lean(x):
        return np.arctan2(masses @ x[:, 0], -(masses @ x[:, 2]))

    turn = lean(points) - 1.0
    across = np.array([[np.cos(turn), 0.0, np.sin(turn)], [0.0, 1.0, 0.0], [-np.sin(turn), 0.0, np.cos(turn)]])
    sim.set_positions("it", points @ across.T)
    times = np.arange(181) / 60.0
    found = [lean(sim.positions("it").astype(float))]
    for _ in times[1:]:
        sim.step(1)
        found.append(lean(sim.positions("it").astype(float)))
    assert found[0] == pytest.approx(1.0, abs=1e-5)
    wanted = swung(points, masses, 1.0, times)
    swings = zeros(times, wanted)
    # First order loses a share of its swing each second, and faster swings are shorter.
    period, height = (0.01, 0.08) if order == 1 else (4e-3, 0.03)
    assert zeros(times, np.array(found)) == pytest.approx(swings, abs=period * swings[-1])
    last = times > swings[-2]
    assert np.abs(found)[last].max() == pytest.approx(np.abs(wanted)[last].max(), rel=height)


@pytest.mark.parametrize("shape", ["short", "arc", "helix"])
@pytest.mark.parametrize("compliance", [0.5, 1e-2, 1e-4])
@pytest.mark.parametrize("axis", [(0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (1.0, 0.3, 0.5)])
def test_thrown_bent_rope_keeps_its_angular_momentum(device, shape, compliance, axis):
    points = {"short": arc(4, 2.0), "arc": arc(33, np.pi), "helix": helix()}[shape]
    rope = Rope(points=points, pins=None, bend_compliance=compliance, mass=MASS, stretch_compliance=1e-6)
    settings = Settings(method="xpbd", substeps=20, order=2)
    sim = Simulation(Scene(objects={"it": rope}, gravity=(0.0, 0.0, 0.0)), settings, device=device)
    masses = sim.masses("it").astype(float)[:, None]
    spin = 10.0 * np.array(axis) / np.linalg.norm(axis)
    sim.set_velocities("it", np.cross(spin, points - points.mean(axis=0)) + (1.0, 0.0, 0.0))

    def angular_momentum():
        x, v = sim.positions("it").astype(float), sim.velocities("it").astype(float)
        return (masses * np.cross(x - (masses * x).sum(axis=0) / masses.sum(), v)).sum(axis=0)

    before = angular_momentum()
    sim.step(60)
    # In single precision, as GPUs solve it, bending as stiff as it can be tells turns by a few hundredths. At most
    # 0.062 of it was lost on an H200, and 0.36 to all of it while the rest shape was held for a substep.
    share = 1e-3 if device == "cpu" and shape != "short" else 0.1
    assert np.linalg.norm(angular_momentum() - before) < share * np.linalg.norm(before)


def hanging(segments, rigidity, rest, loads):
    """(n, 2) points [m] (out, down) of a chain of length 1, clamped and level at its start, bent down by `rest` [-] at
    every joint."""
    length = 1.0 / segments
    stiff = np.full(segments, rigidity / length)
    stiff[0] *= 2.0
    carried = np.cumsum(loads[::-1])[::-1]

    def imbalance(angles):
        half = 0.5 * np.diff(angles, prepend=0.0)
        held = stiff * (2.0 * np.sin(half) - rest) * np.cos(half)
        return held - np.cumsum((length * np.cos(angles) * carried)[::-1])[::-1]

    found = root(imbalance, rest * np.arange(1, segments + 1), tol=1e-12)
    assert found.success
    return length * np.cumsum(np.stack([np.cos(found.x), np.sin(found.x)], axis=1), axis=0)


@pytest.mark.parametrize(
    "substeps, iterations, order", [pytest.param(20, 1, 1, marks=pytest.mark.long), (20, 4, 2), (80, 1, 2)]
)
@pytest.mark.parametrize("segments, rigidity", [(3, 2.0), (8, 2.0), (32, 0.2), (32, 20.0)])
def test_bent_rope_hangs_as_its_chain(device, segments, rigidity, substeps, iterations, order):
    turn = 1.0 / segments
    angles = turn * np.arange(segments + 1)
    steps = np.stack([np.cos(angles), 0.0 * angles, -np.sin(angles)], axis=1) / segments
    masses = np.full(segments + 2, MASS / segments)
    masses[-1] *= 0.5
    rope = Rope(
        points=np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)]),
        particle_masses=masses,
        pins=[0, 1],
        stretch_compliance=1e-6,
        bend_compliance=1.0 / rigidity,
    )
    settings = Settings(method="xpbd", global_damping=4.0, substeps=substeps, iterations=iterations, order=order)
    sim = Simulation(Scene(objects={"it": rope}), settings, device=device)
    sim.step(400)
    found = (sim.positions("it").astype(float)[2:] - rope.points[1])[:, [0, 2]] * (1.0, -1.0)
    expected = hanging(segments, rigidity, 2.0 * np.sin(0.5 * turn), G * masses[2:])
    bent_by_weight = np.abs((rope.points[2:] - rope.points[1])[:, [0, 2]] * (1.0, -1.0) - expected).max()
    assert np.abs(found - expected).max() < 0.02 * bent_by_weight
