# SPDX-License-Identifier: Apache-2.0
"""Frequencies of ropes and the elasticity of a grid, against their discrete closed forms."""

import numpy as np
import pytest

from cloth_sim_ros.sim import Cloth, Rope, Scene, Settings, Simulation
from cloth_sim_ros.study.closed_forms import ropes, sheets

G, DT = 9.81, 1 / 60


def frequency(amplitude):
    """Angular frequency [rad/s] of the recurrence q_n+2 = 2 Re z q_n+1 - |z|^2 q_n that fits samples at 60 Hz."""
    q = np.asarray(amplitude, dtype=np.float64)
    twice, square = np.linalg.lstsq(np.stack([q[1:-1], -q[:-2]], axis=1), q[2:], rcond=None)[0]
    return np.arccos(0.5 * twice / np.sqrt(square)) / DT


def swing(sim, shape, masses, frames):
    """Amplitude of the mode `shape` (N,) along y after each frame."""
    found = []
    for _ in range(frames):
        sim.step()
        found.append((masses * shape) @ sim.positions("it")[:, 1].astype(np.float64))
    return found


@pytest.mark.parametrize("mode", [0, 1, 2])
def test_hanging_chain_swings_at_its_frequencies(device, mode):
    segments, length, mass = 16, 1.0, 0.2
    masses = np.full(segments + 1, mass / segments)
    masses[-1] *= 0.5
    frequencies, shapes = ropes.hanging_beads_modes(masses[1:], length / segments, G)
    shape = np.append(0.0, shapes[:, mode])
    # Nearly rigid and hung at its static length, so that only the swing is left.
    rope = Rope(
        start=(0, 0, 0), end=(0, 0, -length), segments=segments, stretch_compliance=1e-6, particle_masses=masses
    )
    sim = Simulation(Scene(objects={"it": rope}), Settings(method="xpbd", order=2, substeps=40), device=device)
    start = sim.rest_positions("it").astype(np.float64)
    start[:, 1] = 1e-3 * shape / np.abs(shape).max()
    sim.set_positions("it", start)
    assert frequency(swing(sim, shape, masses, 90)) == pytest.approx(frequencies[mode], rel=1e-3)
    smooth = ropes.hanging_chain_frequencies(length, G, 3)[mode]
    assert frequencies[mode] == pytest.approx(smooth, rel=0.07)


@pytest.mark.parametrize("mode", [1, 3])
def test_taut_string_rings_at_its_frequencies(device, mode):
    segments, rest, span, mass, ea = 16, 1.0, 1.1, 0.2, 50.0
    rope = Rope(start=(0, 0, 0), end=(rest, 0, 0), segments=segments, mass=mass, pins="both", stretch_compliance=1 / ea)
    scene = Scene(objects={"it": rope}, gravity=(0.0, 0.0, 0.0))
    sim = Simulation(scene, Settings(method="xpbd", order=2, substeps=80), device=device)
    s = np.linspace(0.0, 1.0, segments + 1)
    shape = np.sin(mode * np.pi * s)
    start = np.stack([span * s, 2e-3 * shape, 0.0 * s], axis=1)
    sim.set_positions("it", start)
    tension = ea * (span / rest - 1.0)
    expected = ropes.beaded_string_frequency(mode, tension, mass / segments, span / segments, segments - 1)
    assert frequency(swing(sim, shape, sim.masses("it"), 60)) == pytest.approx(expected, rel=1e-3)
    smooth = 2.0 * np.pi * mode * ropes.string_frequency(span, tension, mass / span)
    assert expected == pytest.approx(smooth, rel=0.02)


@pytest.mark.parametrize("strain", [(1e-3, 0.0, 0.0), (0.0, 2e-3, 0.0), (0.0, 0.0, 1e-3)])
def test_grid_has_the_elasticity_of_its_springs(device, strain):
    """Uniformly strained, the inside is in balance and the borders feel the stress; seen in the first tiny step."""
    count, size, mass, ks, kd, h = 6, 1.0, 0.2, 1000.0, 400.0, 1e-6
    cloth = Cloth(
        resolution=(count, count),
        size=(size, size),
        mass=mass,
        pins=None,
        stretch_compliance=1.0 / ks,
        shear_compliance=1.0 / kd,
    )
    scene = Scene(objects={"it": cloth}, gravity=(0.0, 0.0, 0.0))
    sim = Simulation(scene, Settings(method="xpbd", order=1, frame_dt=h, substeps=1), device=device)
    xx, yy, gamma = strain
    start = sim.rest_positions("it").astype(np.float64)
    start[:, :2] += start[:, :2] @ np.array([[xx, gamma / 2], [gamma / 2, yy]])
    sim.set_positions("it", start)
    sim.step()
    force = (sim.masses("it")[:, None] * sim.velocities("it") / h).reshape(count, count, 3)
    c11, c12, c66, _, _ = sheets.grid_elasticity(ks, kd)
    stress = np.array([c11 * xx + c12 * yy, c12 * xx + c11 * yy, c66 * gamma]) * size / (count - 1)
    scale = np.abs(stress).max()
    assert np.abs(force[1:-1, 1:-1]).max() < 2e-3 * scale
    right = force[1:-1, -1, :2].mean(axis=0)
    upper = force[-1, 1:-1, :2].mean(axis=0)
    assert -right == pytest.approx([stress[0], stress[2]], rel=3e-3, abs=2e-3 * scale)
    assert -upper == pytest.approx([stress[2], stress[1]], rel=3e-3, abs=2e-3 * scale)
