# SPDX-License-Identifier: Apache-2.0
"""Statics: what hangs at rest does so by its compliance alone, whatever the iterations, substeps and segments."""

import numpy as np
import pytest
from fixed_settings import fixed

from cloth_sim_ros.sim import Cloth, Rope, Scene, Settings, Simulation, Sphere
from cloth_sim_ros.study.closed_forms import ropes

G = 9.81


def settled(thing, device, frames=240, drag=10.0, **settings):
    """A simulation of `thing` that has come to rest under a strong drag."""
    sim = Simulation(Scene(objects={"it": thing}), fixed(global_damping=drag, **settings), device=device)
    sim.step(frames=frames)
    return sim


def lumped(total, segments):
    masses = np.full(segments + 1, total / segments)
    masses[[0, -1]] *= 0.5
    return masses


@pytest.mark.parametrize("iterations", [1, 4, 16])
@pytest.mark.parametrize("substeps", [5, 20, 80])
def test_load_sags_by_compliance_times_load(device, substeps, iterations):
    length, compliance, load = 0.8, 1e-3, 2.0
    rope = Rope(
        start=(0, 0, 0), end=(0, 0, -length), segments=1, stretch_compliance=compliance, particle_masses=[0.1, load]
    )
    sim = settled(rope, device, substeps=substeps, iterations=iterations)
    sag = -sim.positions("it")[1, 2] - length
    assert sag == pytest.approx(compliance * length * load * G, rel=1e-3)


def test_a_heavy_hem_stretches_the_sheet_above_it(device):
    masses = np.full(9, 0.01)
    masses[:3] = 0.5, 1.0, 0.5  # border springs are half as stiff and carry half as much
    hem = Cloth(
        resolution=(3, 3), orientation=(np.sqrt(0.5), 0, 0, np.sqrt(0.5)), pins="top", particle_masses=masses,
        stretch_compliance=1e-3, shear_compliance=None,
    )  # fmt: skip
    sim = settled(hem, device, iterations=4)
    assert sim.masses("it") == pytest.approx(masses)
    row = sim.positions("it")[:, 2].reshape(3, 3)
    below = np.array([1.0, 1.0 + 0.01, 1.0])  # what hangs on the middle column: hem, hem and middle row
    assert row[1, 1] - row[0, 1] - 0.5 == pytest.approx(1e-3 * below[0] * G, rel=5e-3)
    assert row[2, 1] - row[1, 1] - 0.5 == pytest.approx(1e-3 * below[1] * G, rel=5e-3)


def test_compliance_set_live_changes_the_sag(device):
    rope = Rope(start=(0, 0, 0), end=(0, 0, -1), segments=1, stretch_compliance=1e-3, particle_masses=[0.1, 2.0])
    sim = settled(rope, device)
    sim.set("it.stretch_compliance", 3e-3)
    sim.step(frames=240)
    assert -sim.positions("it")[1, 2] - 1.0 == pytest.approx(3e-3 * 2.0 * G, rel=1e-3)


@pytest.mark.parametrize("substeps, iterations", [(5, 1), (5, 16), (20, 4), (80, 1), (80, 16)])
@pytest.mark.parametrize("segments, load", [(8, 0.0), (32, 1.0), (128, 20.0)])
def test_rope_hangs_as_its_closed_form(device, segments, load, substeps, iterations):
    length, mass, compliance = 1.0, 0.2, 1e-3
    masses = lumped(mass, segments)
    masses[-1] += load
    rope = Rope(
        start=(0, 0, 0), end=(0, 0, -length), segments=segments, stretch_compliance=compliance, particle_masses=masses
    )
    sim = settled(rope, device, drag=20.0, substeps=substeps, iterations=iterations)
    elongation = -sim.positions("it")[:, 2] - np.linspace(0.0, length, segments + 1)
    extensions = ropes.hanging_extensions(masses, sim.springs("it")["structural"][2], G)
    assert elongation[1:] == pytest.approx(np.cumsum(extensions), rel=1e-4, abs=1e-7)
    continuum = ropes.hanging_stretch(length, length, mass * G / length, load * G, 1.0 / compliance)
    assert elongation[-1] == pytest.approx(continuum, rel=1e-4)


@pytest.mark.parametrize("substeps, iterations", [(5, 1), (5, 16), (20, 4), (80, 1), (80, 16)])
def test_rope_hangs_as_a_catenary(device, substeps, iterations):
    span, length, segments, mass = 1.0, 1.4, 40, 0.1
    # Started as a V, so that it has to find its shape.
    points = np.zeros((segments + 1, 3))
    points[:, 0] = np.linspace(0.0, span, segments + 1)
    depth = 0.5 * np.sqrt(length**2 - span**2)
    points[:, 2] = -depth * (1.0 - np.abs(np.linspace(-1.0, 1.0, segments + 1)))
    rope = Rope(points=points, mass=mass, pins="both", stretch_compliance=1e-5)
    sim = settled(rope, device, frames=400, drag=5.0, substeps=substeps, iterations=iterations)
    found = sim.positions("it")[:, [0, 2]]
    chain = ropes.catenary_chain(span, np.full(segments, length / segments), lumped(mass, segments), 1e5 * 40 / 1.4, G)
    assert np.abs(found - chain).max() < 1e-4 * length
    assert np.abs(found - ropes.catenary_points(span, length, segments + 1)).max() < 1e-3 * length
    assert np.abs(sim.positions("it")[:, 1]).max() < 1e-6


@pytest.mark.parametrize("resolution", [(5, 9), (9, 17)])
def test_strip_of_cloth_stretches_as_its_springs(device, resolution):
    """Without shear springs the columns are separate chains; borders carry half the weight on half the constant."""
    width, height, mass, compliance = 0.4, 0.8, 0.3, 0.02
    cloth = Cloth(
        resolution=resolution,
        size=(width, height),
        mass=mass,
        orientation=(np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)),
        pins="top",
        stretch_compliance=compliance,
        shear_compliance=None,
    )
    sim = settled(cloth, device, frames=400, drag=8.0, iterations=4)
    nx, ny = resolution
    z = sim.positions("it")[:, 2].reshape(ny, nx)
    # A column of an inner line: spacing b wide, so w = mass g b / (width height), springs of 1/compliance.
    weight, column = mass * G / (width * height), width / (nx - 1)
    ea = (1.0 / compliance) * height / (ny - 1)
    expected = ropes.hanging_stretch(height, height, weight * column, 0.0, ea)
    assert z[-1] - z[0] - height == pytest.approx(np.full(nx, expected), rel=1e-3)


def pressed(device, constant, **settings):
    """A ball of 10 cm is pressed 0.2 m deep into a sheet of 0.6 m that is clamped; its strain and energy [J/kg]."""
    springs = {"stretch_compliance": 1.0 / constant, "shear_compliance": 3.0 / constant}
    sheet = Cloth(resolution=(24, 24), size=(0.6, 0.6), mass=0.1, thickness=0.005, pins="edges", **springs)
    start = np.array([0.03, 0.02, -0.16])
    scene = Scene({"it": sheet}, {"ball": Sphere(radius=0.1, position=tuple(start))})
    sim = Simulation(scene, Settings(**settings), device)
    for frame in range(90):
        sim.set_collider_pose("ball", start + (0, 0, min(0.5 * (frame + 1) / 60.0, 0.35)))
        sim.step()
    told = sim.report()["it"]
    return told["max_strain"], told["kinetic_energy"] / 0.1


@pytest.mark.long
def test_a_ball_strains_a_clamped_sheet_alike_however_stiff_it_is(device):
    """Who moves a linear system by hand moves it alike, whatever its springs are. It shook at 160 J/kg."""
    strain, _ = pressed(device, 1e3, method="verlet")
    for settings in ({}, {"method": "xpbd", "substeps": 40}, {"method": "xpbd", "substeps": 80, "order": 1}):
        stiff, energy = pressed(device, 1e5, **settings)
        assert stiff == pytest.approx(strain, rel=0.05) and energy < 2.0, settings


def test_what_is_taut_lies_still(device):
    """A clamped sheet of 1e5 N/m, stretched by 20 %, is strained alike everywhere, and what shakes it dies down."""
    springs = {"stretch_compliance": 1e-5, "shear_compliance": 3e-5}
    sheet = Cloth(resolution=(48, 48), size=(0.6, 0.6), mass=0.1, pins="edges", **springs)
    sim = Simulation(Scene({"it": sheet}), Settings(substeps=60), device)
    x = sim.positions("it")
    x[:, :2] *= 1.2
    sim.set_positions("it", x)
    speeds = 0.1 * np.random.default_rng(1).normal(size=x.shape)
    sim.set_velocities("it", speeds)
    sim.step(60)
    told = sim.report()["it"]
    assert told["max_strain"] == pytest.approx(0.2, abs=2e-3) and told["kinetic_energy"] < 1e-3
