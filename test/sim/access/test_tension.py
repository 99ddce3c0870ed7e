# SPDX-License-Identifier: Apache-2.0
"""Tension along ropes and the load on what holds them: against the weight that hangs below."""

import numpy as np
import pytest
from fixed_settings import fixed

from cloth_sim_ros.sim import Cloth, EndReadback, Readback, Rope, Scene, Settings, Simulation, Wind
from cloth_sim_ros.study.closed_forms.ropes import catenary_chain, catenary_points

G = 9.81
LENGTH, MASS, LOAD = 1.0, 0.3, 0.6


def hanging(segments, compliance, load=LOAD, **rope):
    """A rope that hangs with a load at its lower end, and T = w (L - s) + W [N] in the middle of its segments. That is
    the weight below it in the lumped chain too."""
    masses = np.full(segments + 1, MASS / segments)
    masses[[0, -1]] *= 0.5
    masses[-1] += load
    thing = Rope(
        start=(0, 0, 0),
        end=(0, 0, -LENGTH),
        segments=segments,
        particle_masses=masses,
        stretch_compliance=compliance,
        **rope,
    )
    s = (np.arange(segments) + 0.5) * LENGTH / segments
    return thing, G * (MASS / LENGTH * (LENGTH - s) + load)


def settled(thing, device, frames=200, drag=8.0, worlds=1, **settings):
    executor = settings.pop("executor", None)
    sim = Simulation(Scene({"it": thing}), fixed(global_damping=drag, **settings), device, worlds, executor)
    sim.step(frames)
    return sim


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("compliance", [0.0, 1e-4])
def test_tension_is_the_weight_below(device, compliance, order):
    segments = 64
    thing, expected = hanging(segments, compliance)
    sim = settled(thing, device, order=order, substeps=8)
    found = []
    for _ in range(20):  # a rounding of a rigid segment's length is half a thousandth of its tension
        sim.step()
        found.append(sim.tensions("it"))
    assert np.mean(found, axis=0) == pytest.approx(expected, rel=1e-3)
    assert np.array(found) == pytest.approx(np.tile(expected, (20, 1)), rel=5e-3)
    report = sim.report()["it"]
    assert report["start_tension"] == report["max_tension"] == pytest.approx(expected[0], rel=2e-3)
    assert report["end_tension"] == pytest.approx(expected[-1], rel=2e-3)
    sim.reset()
    assert np.array_equal(sim.tensions("it"), np.zeros(segments))


@pytest.mark.parametrize("executor", ["block", pytest.param("graph", marks=pytest.mark.long)])
@pytest.mark.parametrize("compliance", [0.0, 1e-3])
def test_between_two_held_ends_the_catenary_has_its_tension(device, compliance, executor):
    segments, span = 24, 0.8
    masses = np.full(segments + 1, MASS / segments)
    points = catenary_points(span, LENGTH, segments + 1)
    lengths = np.linalg.norm(np.diff(points, axis=0), axis=1)
    rope = Rope(
        points=np.column_stack([points[:, 0], np.zeros(segments + 1), points[:, 1]]),
        particle_masses=masses,
        pins="both",
        stretch_compliance=compliance,
    )
    constants = np.full(segments, np.inf) if compliance == 0.0 else 1.0 / (compliance * lengths)
    chain = catenary_chain(span, lengths, masses, constants, G)
    run = np.diff(chain[:, 0]) / np.linalg.norm(np.diff(chain, axis=0), axis=1)
    # Between neighbours the vertical part changes by a weight, the horizontal one not at all.
    slope = np.diff(chain[:, 1]) / np.diff(chain[:, 0])
    horizontal = MASS / segments * G / np.diff(slope).mean()
    sim = settled(rope, device, substeps=8, executor=executor)
    found, places = [], []
    for _ in range(60):  # lengths are told to a rounding, whose jerks a rigid rope answers with its tension
        sim.step()
        found.append(sim.tensions("it"))
        places.append(sim.positions("it"))
    assert np.ptp(places, axis=0).max() < 1e-6
    assert np.array(found) == pytest.approx(np.tile(horizontal / run, (60, 1)), rel=1e-2)
    assert np.mean(found, axis=0) == pytest.approx(horizontal / run, rel=1e-3)


def test_a_straight_rope_between_two_held_ends_has_the_tension_of_its_strain(device):
    sim = Simulation(
        Scene({"it": Rope(segments=10, pins="both", stretch_compliance=1e-4)}, gravity=(0, 0, 0)),
        Settings(method="xpbd", order=1, substeps=20, global_damping=8.0),
        device=device,
    )
    sim.set_positions("it", sim.rest_positions("it") * (1.01, 1.0, 1.0))
    sim.step(120)
    assert sim.tensions("it") == pytest.approx(np.full(10, 100.0), rel=1e-3)


def test_a_load_at_the_end_adds_to_the_tension(device):
    rope = Rope(start=(0, 0, 0), end=(0, 0, -LENGTH), segments=10, mass=MASS, end_mass=LOAD, stretch_compliance=1e-4)
    assert settled(rope, device).tensions("it") == pytest.approx(hanging(10, 1e-4)[1], rel=1e-3)


def test_explicit_steps_tell_tension_too(device):
    thing, expected = hanging(5, 1e-2)
    sim = settled(thing, device, method="verlet", substeps=40)
    assert sim.tensions("it") == pytest.approx(expected, rel=1e-3)


def test_a_pushed_segment_has_a_negative_tension(device):
    thing = Rope(start=(0, 0, 0), end=(0, 0, 1), segments=1, stretch_compliance=1e-4, particle_masses=[0.1, 2.0])
    assert settled(thing, device).tensions("it") == pytest.approx(-2.0 * G, rel=1e-3)


def test_a_dashpot_pulls_with_the_springs(device):
    """Between two ends that move apart, compliance x tension = strain + damping x its rate."""
    rope = Rope(segments=1, pins="start", stretch_compliance=1e-2, damping=0.5, mass=200.0)
    sim = Simulation(
        Scene({"it": rope}, gravity=(0, 0, 0)), Settings(method="xpbd", order=1, substeps=50), device=device
    )
    sim.set_velocities("it", [(0, 0, 0), (0.1, 0, 0)])
    sim.step()
    strain = sim.positions("it").astype(float)[1, 0] - 1.0
    rate = sim.velocities("it").astype(float)[1, 0]
    assert sim.tensions("it")[0] == pytest.approx((strain + 0.5 * rate) / 1e-2, rel=2e-3)


def test_each_world_has_its_own_tension(device):
    thing, expected = hanging(8, 1e-4)
    sim = Simulation(Scene({"it": thing}), fixed(global_damping=8.0), device, worlds=2)
    sim.set("gravity", (0, 0, -2 * G), world=1)
    sim.step(200)
    assert sim.tensions("it", 0) == pytest.approx(expected, rel=1e-3)
    assert sim.tensions("it", 1) == pytest.approx(2 * expected, rel=1e-3)
    assert sim.report(1)["it"]["max_tension"] == pytest.approx(2 * expected[0], rel=1e-3)


def test_readback_carries_the_tension_of_the_segment_behind_a_particle(device):
    thing, expected = hanging(8, 0.0)
    sim = settled(thing, device, substeps=5)
    readback = Readback(sim, "it", velocities=True, tensions=True)
    readback.request()
    rows = readback.particles()
    assert rows.shape == (9, 7)
    assert np.array_equal(rows[:-1, 6], sim.tensions("it"))
    assert rows[-1, 6] == rows[-2, 6] == pytest.approx(expected[-1], rel=1e-3)


def test_a_cloth_has_no_tension(device):
    sim = Simulation(Scene({"sheet": Cloth(resolution=(3, 3))}), device=device)
    with pytest.raises(ValueError, match="sheet is a cloth, which has no tension along it and no ends; allowed"):
        sim.tensions("sheet")
    with pytest.raises(ValueError, match="sheet is a cloth"):
        Readback(sim, "sheet", tensions=True)
    assert "max_tension" not in sim.report()["sheet"]


@pytest.mark.parametrize("compliance", [0.0, 1e-4])
def test_what_holds_a_hanging_rope_carries_all_of_it(device, compliance):
    thing, _ = hanging(5, compliance)
    sim = settled(thing, device, substeps=8)
    wrenches = sim.end_wrenches("it")
    assert wrenches[0, 2] == pytest.approx(-G * (MASS + LOAD), rel=1e-3)
    assert np.abs(wrenches[0, [0, 1, 3, 4, 5]]).max() < 1e-4
    assert np.array_equal(wrenches[1], np.zeros(6)), "a free end loads nothing"


def test_two_sided_of_a_catenary_share_its_weight_and_pull_apart(device):
    rope = Rope(start=(0, 0, 0), end=(0.8, 0, 0), segments=20, pins="both", mass=MASS, stretch_compliance=1e-2)
    start, end = settled(rope, device, frames=400).end_wrenches("it")
    assert start[2] == pytest.approx(-0.5 * G * MASS, rel=1e-3)
    assert end[2] == pytest.approx(-0.5 * G * MASS, rel=1e-3)
    assert start[0] == pytest.approx(-end[0], rel=1e-3) and start[0] > 0.5 * G * MASS


def test_a_clamp_bears_weight_and_moment_of_a_cantilever(device):
    """A clamp of two held particles: at the second the moment is that of all loads beyond it."""
    segments, span = 6, 1.0 / 6
    points = np.arange(-1, segments + 1)[:, None] * span * np.array([0.0, 1.0, 0.0])
    masses = np.full(segments + 2, MASS / segments)
    rope = Rope(points=points, particle_masses=masses, pins=(0, 1), stretch_compliance=1e-6, bend_compliance=1.0 / 20.0)
    sim = settled(rope, device, frames=400, drag=4.0, substeps=8)
    wrench = sim.end_wrenches("it")[0]
    y = sim.positions("it").astype(float)[:, 1] - points[0, 1]
    assert wrench[:3] == pytest.approx([0.0, 0.0, -G * masses.sum()], rel=2e-3, abs=2e-3 * G * masses.sum())
    assert wrench[3] == pytest.approx(-G * (masses * y).sum(), rel=5e-3)
    assert np.abs(wrench[4:]).max() < 1e-3


def test_wind_on_a_held_rope_loads_what_holds_it(device):
    """Held all along, a rope hands on the drag of the air: 1/2 rho Cd (2 r L) v^2."""
    rope = Rope(segments=4, pins=(0, 1, 2, 3, 4), radius=0.01)
    wind = Wind((0, 10.0, 0), air_density=1.2, drag_coefficient=1.0)
    sim = Simulation(Scene({"it": rope}, wind=wind, gravity=(0, 0, 0)), device=device)
    sim.step()
    assert sim.end_wrenches("it")[0, 1] == pytest.approx(0.5 * 1.2 * 0.02 * 100.0, rel=1e-4)


def test_end_readback_holds_until_the_next_request(device):
    thing, _ = hanging(5, 0.0)
    sim = Simulation(Scene({"it": thing}), device=device)
    readback = EndReadback(sim, "it")
    sim.step(20)
    readback.request()
    first = readback.wrenches().copy()
    assert np.array_equal(first, sim.end_wrenches("it")) and abs(first[0, 2]) > 1.0
    sim.step(1)
    assert np.array_equal(readback.wrenches(), first)
