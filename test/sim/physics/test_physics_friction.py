# SPDX-License-Identifier: Apache-2.0
"""Contact: inclines by Coulomb's law, a sheet that rests on a sphere."""

import numpy as np
import pytest
from fixed_settings import fixed

from cloth_sim_ros.sim import Box, Cloth, Plane, Rope, Scene, Settings, Simulation, Sphere
from cloth_sim_ros.study.closed_forms import contact

G = 9.81


def on_incline(angle, device, thing, static=0.5, kinetic=0.3, **settings):
    """A simulation of a cloth or rope laid on a plane inclined by `angle` [rad] down along +x, touching it exactly."""
    turn = (0.0, np.sin(0.5 * angle), 0.0, np.cos(0.5 * angle))
    normal = (np.sin(angle), 0.0, np.cos(angle))
    friction = {"static_friction": static, "kinetic_friction": kinetic}
    gap = 0.005
    place = {"position": tuple(gap * n for n in normal), "orientation": turn, **friction}
    if thing == "cloth":
        body = Cloth(resolution=(6, 6), size=(0.2, 0.2), pins=None, stretch_compliance=1e-4, thickness=gap, **place)
    else:
        body = Rope(start=(0, 0, 0), end=(0.3, 0, 0), segments=12, pins=None, radius=gap, **place)
    scene = Scene(objects={"it": body}, colliders={"slope": Plane(normal=normal, **friction)})
    return Simulation(scene, fixed(**settings), device=device), np.array([np.cos(angle), 0.0, -np.sin(angle)])


@pytest.mark.parametrize("thing", ["cloth", "rope"])
@pytest.mark.parametrize("substeps, iterations", [(20, 1), (5, 4)])
def test_sticks_below_the_angle_of_friction(device, thing, substeps, iterations):
    sim, _ = on_incline(np.arctan(0.5) - 0.01, device, thing, substeps=substeps, iterations=iterations)
    sim.step(frames=30)
    start = sim.positions("it")
    sim.step(frames=600)
    creep = np.linalg.norm(sim.positions("it") - start, axis=1).max()
    assert creep < 1e-5


@pytest.mark.parametrize("thing", ["cloth", "rope"])
@pytest.mark.parametrize("angle, kinetic", [(np.arctan(0.5) + 0.01, 0.3), (0.8, 0.3), (0.8, 0.45)])
def test_slides_with_coulombs_acceleration(device, thing, angle, kinetic):
    """Once it slides faster than 5 cm/s, from where on its friction is kinetic."""
    sim, down = on_incline(angle, device, thing, kinetic=kinetic)
    sim.step(frames=30)
    before = (sim.velocities("it") @ down).mean()
    sim.step(frames=60)
    gained = (sim.velocities("it") @ down).mean() - before
    assert before > 0.05
    assert gained == pytest.approx(contact.incline_acceleration(angle, 0.5, kinetic, G) * 1.0, rel=5e-3)


@pytest.mark.parametrize("substeps", [0, 5, 20, 80])
def test_a_stiff_cable_slips_just_beyond_the_angle_of_friction(device, substeps):
    """At 80 substeps it had stuck for ever at 1.2 times the limit, held by friction that no law allows."""
    mu, second = 0.4, 1.0
    angle = 1.05 * np.arctan(mu)
    down, normal = np.array([np.cos(angle), 0, -np.sin(angle)]), np.array([np.sin(angle), 0, np.cos(angle)])
    cable = Rope.of(
        "steel cable", segments=24, start=(0, 0, 0), end=(0.6, 0, 0), pins=None, static_friction=mu, kinetic_friction=mu
    )
    slope = Plane(normal=tuple(normal), static_friction=mu, kinetic_friction=mu)
    sim = Simulation(Scene({"it": cable}, {"slope": slope}), Settings(substeps=substeps), device=device)
    start = np.outer(np.linspace(-0.3, 0.3, 25), down) + cable.radius * normal
    sim.set_positions("it", start)
    sim.step(round(60 * second))
    slip = ((sim.positions("it") - start) @ down).mean()
    assert slip == pytest.approx(0.5 * 9.81 * (np.sin(angle) - mu * np.cos(angle)) * second**2, rel=0.02)


def test_coefficients_of_a_pair_are_the_geometric_mean(device):
    """0.8 on 0.2 is 0.4: sticks at tan 0.38, slides at tan 0.42."""
    for slope, sticks in ((0.38, True), (0.42, False)):
        sim, down = on_incline(np.arctan(slope), device, "cloth", static=0.8, kinetic=0.8)
        sim.set("slope.static_friction", 0.2)
        sim.set("slope.kinetic_friction", 0.2)
        start = sim.positions("it")
        sim.step(frames=60)
        moved = ((sim.positions("it") - start) @ down).mean()
        assert (abs(moved) < 1e-5) == sticks


@pytest.fixture(scope="module")
def draped(device):
    """Positions of a sheet dropped on a sphere, after 3 s and 10 s later, and the sphere."""
    radius, centre, thickness = 0.25, np.array([0.0, 0.0, 0.5]), 0.005
    cloth = Cloth(
        resolution=(24, 24),
        position=(0.0, 0.0, 0.78),
        pins=None,
        damping=2e-3,
        thickness=thickness,
        static_friction=0.8,
        kinetic_friction=0.6,
    )
    ball = Sphere(radius=radius, position=tuple(centre), static_friction=0.8, kinetic_friction=0.6)
    sim = Simulation(Scene({"it": cloth}, {"ball": ball}), fixed(global_damping=0.5), device)
    sim.step(frames=180)
    first = sim.positions("it").astype(np.float64)
    sim.step(frames=600)
    return sim, first, sim.positions("it").astype(np.float64), centre, radius + thickness


def test_sheet_rests_on_a_sphere_without_penetration(draped):
    sim, first, last, centre, contact_radius = draped
    for x in (first, last):
        assert contact_radius - np.linalg.norm(x - centre, axis=1).min() < 1e-3
    assert sim.report()["it"]["particle_penetration"] < 1e-3
    # It does rest on it: the particles of the middle are in contact and the border hangs below.
    assert np.linalg.norm(last - centre, axis=1).min() < contact_radius + 1e-3
    assert last[:, 2].min() < centre[2]


def test_sheet_on_a_sphere_does_not_creep_off(draped):
    _, first, last, centre, _ = draped
    top = np.argmin(np.linalg.norm(first - centre - [0.0, 0.0, 0.255], axis=1))
    assert np.linalg.norm(last.mean(axis=0) - first.mean(axis=0)) < 2e-3
    assert np.linalg.norm(last[top] - first[top]) < 2e-3


@pytest.mark.long
@pytest.mark.parametrize("order", [1, 2])
def test_an_edge_that_falls_on_a_bar_stays_there(device, order):
    rod = Rope(start=(-0.1, 0, 0.1), end=(0.1, 0, 0.1), segments=1, pins=None, mass=0.1)
    scene = Scene({"it": rod}, {"bar": Box(half_extents=(0.01, 0.2, 0.05), position=(0, 0, -0.05))})
    sim = Simulation(scene, Settings(method="xpbd", order=order, substeps=100), device=device)
    sim.step(9)
    highest = 0.0
    for _ in range(15):
        sim.step()
        highest = max(highest, float(sim.positions("it")[:, 2].mean()))
    assert 0.005 - 1e-5 < highest < 0.0065  # it may rock a little


@pytest.mark.parametrize("order", [pytest.param(1, marks=pytest.mark.long), 2])
@pytest.mark.parametrize("executor", ["block", pytest.param("graph", marks=pytest.mark.long)])
def test_what_falls_on_the_floor_stays_there(device, order, executor):
    """From 0.1 m at 1.4 m/s: BDF2 that remembered the fall would throw it 25 mm up again."""
    sheet = Cloth(resolution=(4, 4), size=(0.2, 0.2), pins=None, position=(0, 0, 0.105), thickness=0.005)
    scene = Scene({"it": sheet}, {"floor": Plane()})
    sim = Simulation(scene, Settings(method="xpbd", order=order, substeps=100), device=device, executor=executor)
    sim.step(9)  # it arrives after 0.143 s
    highest = 0.0
    for _ in range(20):
        sim.step()
        highest = max(highest, float(sim.positions("it")[:, 2].max()))
    assert 0.005 - 1e-6 < highest < 0.0052
