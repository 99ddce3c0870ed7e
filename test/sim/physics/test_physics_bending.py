# SPDX-License-Identifier: Apache-2.0
"""Bending of ropes: cantilevers, the heavy elastica and Euler's load, whatever the substeps and iterations."""

import numpy as np
import pytest
from fixed_settings import fixed

from cloth_sim_ros.sim import Handle, Rope, Scene, Settings, Simulation
from cloth_sim_ros.study.closed_forms import bending

G = 9.81
LENGTH, MASS = 1.0, 0.1


def clamped(segments, flexural_rigidity, axis, masses=None):
    """A rope of LENGTH from the origin along `axis`, clamped by a segment before it that is held at both ends."""
    points = np.arange(-1, segments + 1)[:, None] * (LENGTH / segments) * np.asarray(axis, dtype=float)
    if masses is None:
        masses = np.full(segments + 2, MASS / segments)
        masses[-1] *= 0.5
    return Rope(
        points=points,
        particle_masses=masses,
        pins=[0, 1],
        stretch_compliance=1e-6,
        bend_compliance=1.0 / flexural_rigidity,
    )


def settled(rope, device, **settings):
    sim = Simulation(Scene(objects={"it": rope}), fixed(global_damping=4.0, **settings), device=device)
    sim.step(400)
    return sim.positions("it").astype(float)[1:]


@pytest.mark.parametrize("order", [pytest.param(1, marks=pytest.mark.long), 2])
@pytest.mark.parametrize("substeps, iterations", [(5, 1), (20, 4), (80, 1)])
@pytest.mark.parametrize("segments", [8, 32])
def test_cantilever_bends_under_its_weight(device, segments, substeps, iterations, order):
    rigidity = 20.0
    rope = clamped(segments, rigidity, (1, 0, 0))
    tip = -settled(rope, device, substeps=substeps, iterations=iterations, order=order)[-1, 2]
    loads = G * rope.particle_masses[2:]
    x = np.arange(1, segments + 1) * LENGTH / segments
    assert tip == pytest.approx(bending.cantilever_chain_tip(x, loads, LENGTH / segments, rigidity), rel=1e-3)
    # The chain is stiffer than the beam by its joints' number squared.
    smooth = bending.cantilever_tip(LENGTH, rigidity, weight=G * MASS / LENGTH)
    assert tip == pytest.approx(smooth, rel=0.01 if segments > 8 else 0.02)


def test_joints_bend_as_the_heavy_chain(device):
    rope = clamped(6, 2.0, (1, 0, 0))
    found = settled(rope, device, substeps=10)
    expected = bending.heavy_chain(LENGTH / 6, 2.0, G * rope.particle_masses[2:])
    assert -found[-1, 2] == pytest.approx(expected[-1, 1], rel=1e-2)


@pytest.mark.parametrize("rigidity", [0.05, 0.2])
def test_heavy_rope_bends_as_an_elastica(device, rigidity):
    segments = 40
    found = settled(clamped(segments, rigidity, (1, 0, 0)), device)
    chain = bending.heavy_chain(LENGTH / segments, rigidity, G * clamped(segments, 1.0, (1, 0, 0)).particle_masses[2:])
    assert np.abs(found[:, [0, 2]] * (1, -1) - chain).max() < 2e-3 * LENGTH
    smooth = bending.heavy_elastica(LENGTH, rigidity, G * MASS / LENGTH, count=segments + 1)
    assert np.abs(found[:, [0, 2]] * (1, -1) - smooth).max() < 1e-2 * LENGTH


@pytest.mark.parametrize("share, buckles", [(0.98, False), (1.02, True)])
def test_column_buckles_at_eulers_load(device, share, buckles):
    """Clamped below, free above, a weight on top: a small bow decays below the critical load and grows above it."""
    segments, rigidity = 32, 1.0
    masses = np.full(segments + 2, 1e-3)
    # Of its own weight a column feels three tenths at its top (Timoshenko and Gere 1961, 2.12).
    weight = share * bending.euler_buckling(LENGTH, rigidity, effective=2.0) - 0.3 * G * masses[:-1].sum()
    masses[-1] = weight / G
    rope = clamped(segments, rigidity, (0, 0, 1), masses)
    sim = Simulation(Scene(objects={"it": rope}), fixed(substeps=10), device=device)
    start = sim.rest_positions("it").astype(float)
    bow = 1e-3 * (1.0 - np.cos(0.5 * np.pi * np.clip(start[:, 2], 0.0, None) / LENGTH))
    sim.set_positions("it", start + bow[:, None] * (1.0, 0.0, 0.0))
    peak = 0.0
    for _ in range(80):
        sim.step(10)
        peak = max(peak, abs(float(sim.positions("it")[-1, 0])))
    assert (peak > 3e-3) == buckles


def test_bending_pushes_nothing_as_a_whole(device):
    rope = Rope(start=(0, 0, 0), end=(1, 0, 0), segments=24, pins=None, bend_compliance=10.0)
    sim = Simulation(Scene(objects={"it": rope}, gravity=(0, 0, 0)), device=device)
    bent = sim.rest_positions("it").astype(float)
    bent[:, 2] = 0.02 * np.sin(np.pi * bent[:, 0])
    sim.set_positions("it", bent)
    masses = sim.masses("it")[:, None]
    sim.step(30)
    momentum = np.linalg.norm((masses * sim.velocities("it")).sum(0))
    assert np.linalg.norm(masses * sim.velocities("it"), axis=1).sum() > 1e-3
    assert momentum < 2e-5 * np.linalg.norm(masses * sim.velocities("it"), axis=1).sum()


@pytest.mark.parametrize("material", ["steel cable", "rubber hose"])
def test_a_cable_bent_between_two_still_hands_comes_to_rest(device, material):
    """The hands come 24 cm closer in a second. What then still moves only loses energy: by coarse steps, all of it."""
    segments, slack = 40, 0.24
    hands = {
        name: Handle(position=(x, 0, 1), reach=1.5 / segments, attached=True)
        for name, x in (("left", 0.0), ("right", 1.0))
    }
    cable = Rope.of(material, start=(0, 0, 1), end=(1, 0, 1), segments=segments, pins=None)
    sim = Simulation(Scene({"it": cable}, handles=hands), Settings(substeps=20), device)
    for frame in range(60):
        sim.set_handle_pose("right", (1.0 - slack * (frame + 1) / 60, 0, 1))
        sim.step()
    fastest = []
    for _ in range(6):
        sim.step(60)
        fastest.append(np.abs(sim.velocities("it")).max())
    assert fastest[-1] < 0.05 and fastest[-1] < 0.2 * fastest[0], fastest
