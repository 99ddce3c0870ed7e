# SPDX-License-Identifier: Apache-2.0
"""Starts: a symmetric one far from rest must not come to rest where nothing but its symmetry holds it. What starts
inside of a collider starts outside of it, on one side."""

import math

import numpy as np
import pytest

from cloth_sim_ros.sim import Box, Capsule, Cloth, Handle, Plane, Rope, Scene, Settings, Simulation, Sphere
from cloth_sim_ros.sim.topology import build

HELD = (90, 99)
G = 9.81
GRID = {"resolution": (16, 16)}
UPRIGHT = {"orientation": (math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5))}
ROPE = {"start": (-0.5, 0.0, 0.0), "end": (0.5, 0.0, 0.0)}
INSIDE = {
    "ball of 0.1 m": (Cloth(**GRID), Sphere(radius=0.1)),
    "ball of 0.2 m": (Cloth(**GRID), Sphere(radius=0.2)),
    "ball of 0.3 m": (Cloth(**GRID), Sphere(radius=0.3)),
    "free, ball": (Cloth(**GRID, pins=None, position=(0.0, 0.0, -0.05)), Sphere(radius=0.2)),
    "hung, ball": (Cloth(**GRID, **UPRIGHT), Sphere(radius=0.2)),
    "hung, ball, itself": (Cloth(**GRID, **UPRIGHT, self_contact=True), Sphere(radius=0.2)),
    "box": (Cloth(**GRID, pins=None, position=(0.0, 0.0, 0.02)), Box(half_extents=(0.2, 0.2, 0.1))),
    "box, pinned": (Cloth(**GRID, position=(0.0, 0.0, 0.02)), Box(half_extents=(0.2, 0.2, 0.1))),
    "floor": (Cloth(**GRID, **UPRIGHT), Plane(position=(0.0, 0.0, -0.495))),
    "floor, free": (Cloth(**GRID, **UPRIGHT, pins=None), Plane(position=(0.0, 0.0, -0.495))),
    "rope": (Rope(**ROPE), Capsule(radius=0.05, **UPRIGHT)),
    "rope, free": (Rope(**ROPE, pins=None), Capsule(radius=0.05, **UPRIGHT)),
}


def sheet():
    cloth = Cloth(
        resolution=(10, 10), size=(0.9, 0.9), stretch_compliance=0.0, shear_compliance=0.0, damping=2e-3, pins=HELD
    )
    return Simulation(Scene({"it": cloth}), Settings(method="xpbd", substeps=5, order=2, global_damping=2.0), "cpu")


def with_collider(thing, collider, device, worlds=1, **more):
    return Simulation(Scene({"it": thing}, {"collider": collider}, **more), device=device, worlds=worlds)


def but_for_the_held(x, others):
    others = np.array(np.broadcast_to(others, x.shape))
    others[list(HELD)] = x[list(HELD)]
    return others


def depth(x, collider):
    """By how much points (N, 3) lie inside of a collider at the origin, or of a floor, at the most [m]."""
    if isinstance(collider, Plane):
        return collider.position[2] - x[:, 2].min()
    if isinstance(collider, Box):
        return (np.array(collider.half_extents) - np.abs(x)).min(axis=1).max()
    if isinstance(collider, Capsule):  # upright is along y
        x = x - np.array([0.0, 1.0, 0.0]) * np.clip(x[:, 1:2], -collider.half_length, collider.half_length)
    return collider.radius - np.linalg.norm(x, axis=1).min()


def largest_strain(sim):
    """Of a spring [-], in float64."""
    x = sim.positions("it").astype(np.float64)
    lengths = (
        (np.linalg.norm(x[pairs[:, 1]] - x[pairs[:, 0]], axis=1), rest) for pairs, rest, _ in sim.springs("it").values()
    )
    return max(np.abs(length / rest - 1.0).max() for length, rest in lengths)


def energy_of(sim):
    """Of motion and of height [J], in float64. A stiff spring that was hit may hold as much for a frame."""
    x, v = (rows("it").astype(np.float64) for rows in (sim.positions, sim.velocities))
    return G * sim.masses("it") @ x[:, 2] + 0.5 * sim.masses("it") @ (v**2).sum(axis=1)


def test_a_symmetric_start_is_moved_a_little_off_its_symmetry():
    sim = sheet()
    x = sim.rest_positions("it")
    stretched = but_for_the_held(x, 10.0 * x)
    sim.set_positions("it", stretched)
    assert 0.0 < np.abs(sim.positions("it") - stretched)[50].max() < 2e-6


def test_what_is_in_one_place_or_pinned_stays_there_and_a_calm_start_is_taken_to_the_bit():
    sim = sheet()
    x = sim.rest_positions("it").copy()
    x[50] += [0.0, 0.0, 0.01]
    sim.set_positions("it", x)
    assert np.array_equal(sim.positions("it"), x)
    sim.set_positions("it", but_for_the_held(x, [0.1, 0.2, 0.3]))
    found = sim.positions("it")
    assert np.ptp(found[:90], axis=0).max() == 0.0 and np.array_equal(found[list(HELD)], x[list(HELD)])


@pytest.mark.long
@pytest.mark.parametrize("thing, collider", INSIDE.values(), ids=INSIDE)
def test_what_starts_inside_of_a_collider_starts_outside_of_it_unstrained_and_is_not_flung(device, thing, collider):
    """At first it falls. Later a corner may be faster, as that of any sheet that falls on an edge."""
    topology, sim = build(thing, "it", False), with_collider(thing, collider, device)
    x, thickness = sim.positions("it").astype(np.float64), getattr(thing, "radius", None) or thing.thickness
    assert np.array_equal(sim.positions("it")[topology.pinned], topology.rest[topology.pinned].astype(np.float32))
    assert depth(topology.rest, collider) > 0.0 > depth(x, collider) + thickness - 1e-6
    farthest = np.linalg.norm(x - topology.rest, axis=1).max()
    deep, way = sim.moved["it"]
    assert deep > thickness and 0.9 * way < farthest < 1.001 * way
    start = energy_of(sim)
    assert largest_strain(sim) < 1e-5
    for frame in range(60):
        sim.step()
        if frame < 3:
            assert np.linalg.norm(sim.velocities("it"), axis=1).max() < G * sim.time + 1.0
        assert energy_of(sim) < start + 0.05 * G * thing.mass * way
        report = sim.report()["it"]
        assert report["max_penetration"] < thickness and report.get("crossings", 0) == 0


@pytest.mark.parametrize("radius", [0.1, 0.2, 0.3])
def test_a_sheet_is_moved_by_just_enough(device, radius):
    """A free one by the radius and the thickness, upwards; one on two pins by the angle at which it touches."""
    enough = radius + 0.005
    for gravity in (-G, G):
        sim = with_collider(Cloth(**GRID, pins=None), Sphere(radius=radius), device, gravity=(0.0, 0.0, gravity))
        shift = sim.positions("it") - build(Cloth(**GRID), "it", False).rest
        up = -math.copysign(1.0, gravity)
        assert np.ptp(shift, axis=0).max() < 1e-6 and enough - 1e-6 < up * shift[0, 2] < enough + 2e-3
        assert np.abs(shift[:, :2]).max() < 1e-6
    x = with_collider(Cloth(**GRID), Sphere(radius=radius), device).positions("it").astype(np.float64)
    normal = np.cross(x[15] - x[0], x[240] - x[0])
    normal /= np.linalg.norm(normal)
    assert enough - 1e-6 < abs(normal @ x[0]) < enough + 2e-3, "of its plane from the middle of the ball"
    assert x[:, 2].min() > -1e-6


def test_what_cannot_or_need_not_be_moved_starts_where_the_scene_puts_it(device):
    angle, height = (each.ravel() for each in np.meshgrid(np.arange(24) * math.pi / 12, np.linspace(-0.1, 0.1, 8)))
    points = np.stack([0.097 * np.cos(angle), 0.097 * np.sin(angle), height], axis=1)
    first = np.concatenate([24 * row + np.arange(24) for row in range(7)])
    beside = 24 * (first // 24) + (first + 1) % 24
    faces = np.concatenate([np.stack([first, beside, beside + 24], 1), np.stack([first, beside + 24, first + 24], 1)])
    calm = {
        "on no line": (Cloth(**GRID, pins="edges"), Sphere(radius=0.1)),
        "around it": (Cloth.from_mesh(points, faces), Capsule(radius=0.1, half_length=0.5)),
        "in what gives way": (Cloth(**GRID, pins=None), Sphere(radius=0.1, compliance=1e-3)),
        "within the thickness": (Cloth(**GRID, pins=None), Plane(position=(0.0, 0.0, -1e-4))),
        "outside": (Cloth(**GRID), Sphere(radius=0.1, position=(0.0, 0.0, -0.2))),
    }
    for name, (thing, collider) in calm.items():
        sim = with_collider(thing, collider, device)
        rest = build(thing, "it", False).rest.astype(np.float32)
        assert sim.moved == {} and sim.builds == 1 and np.array_equal(sim.positions("it"), rest), name


@pytest.mark.long
def test_it_starts_there_in_all_worlds_and_after_a_reset_and_what_a_handle_holds_stays(device):
    sim = with_collider(Cloth(**GRID), Sphere(radius=0.1), device, worlds=2)
    start = sim.positions("it", None)
    assert np.array_equal(start[0], start[1]) and np.array_equal(start[0], sim.rest_positions("it"))
    sim.step(3)
    sim.set("it.pins", (240, 250, 255))
    sim.reset()
    assert np.array_equal(sim.positions("it", None), start) and sim.time == 0.0 and sim.moved
    sim.take_over("it", sim)
    assert not sim.moved, "it goes on from elsewhere"
    thing, hand = Cloth(**GRID, pins=None), Handle(position=(0.5, 0.5, 0.0), attached=True)
    sim = with_collider(thing, Sphere(radius=0.1), device, handles={"hand": hand})
    rest = build(thing, "it", False).rest
    moved = np.linalg.norm(sim.positions("it") - rest, axis=1)
    assert sim.held("hand") == 1 and moved[255] < 1e-6 and moved[0] > 0.1
