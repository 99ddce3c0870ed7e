"""Ropes with a bent rest shape: let go, they gain no energy, and they hang as a chain that is bent at rest does."""

import numpy as np
import pytest
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


def let_go(rope, start, device, **settings):
    """The most energy [J], kinetic and of height, that a rope gains in a second."""
    gravity = (0.0, 0.0, 0.0) if rope.pins is None else (0.0, 0.0, -G)
    sim = Simulation(Scene(objects={"it": rope}, gravity=gravity), Settings(**settings), device=device)
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
@pytest.mark.parametrize("compliance", [0.5, 1e-2, 1e-4, 1e-9])
@pytest.mark.parametrize("held", PINS)
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
    points = arc(100, 3.0)
    if shape == "helix":
        angles = np.linspace(0.0, 6.0 * np.pi, 61)
        points = np.stack([0.05 * np.cos(angles), 0.05 * np.sin(angles), -0.4 * angles / angles[-1]], axis=1)
    for pins in PINS.values():
        rope = Rope(points=points, pins=pins, bend_compliance=0.5, mass=MASS)
        assert let_go(rope, points, device, substeps=20, iterations=iterations) < 0.01


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


@pytest.mark.parametrize("substeps, iterations, order", [(20, 1, 1), (20, 4, 2), (80, 1, 2)])
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
    settings = Settings(global_damping=4.0, substeps=substeps, iterations=iterations, order=order)
    sim = Simulation(Scene(objects={"it": rope}), settings, device=device)
    sim.step(400)
    found = (sim.positions("it").astype(float)[2:] - rope.points[1])[:, [0, 2]] * (1.0, -1.0)
    expected = hanging(segments, rigidity, 2.0 * np.sin(0.5 * turn), G * masses[2:])
    bent_by_weight = np.abs((rope.points[2:] - rope.points[1])[:, [0, 2]] * (1.0, -1.0) - expected).max()
    assert np.abs(found - expected).max() < 0.02 * bent_by_weight
