# SPDX-License-Identifier: Apache-2.0
"""Contact along edges: a sharp box and a thin pole meet the sheet between its particles, not at them alone."""

import numpy as np
import pytest
from fixed_settings import fixed

from cloth_sim_ros.sim import Box, Capsule, Cloth, Rope, Scene, Settings, Simulation
from cloth_sim_ros.sim.batch import forced_executor

HALF, THICKNESS, SPACING = np.array([0.3, 0.5, 0.2]), 0.02, 0.1  # a box whose corner is five times finer than the mesh


def deepest(sim, middle):
    """How deep any point of any edge lies in the thickened box [m], sampled, in NumPy."""
    x, worst = sim.positions("it").astype(float) - middle, 0.0
    for pairs, _, _ in sim.springs("it").values():
        t = np.linspace(0.0, 1.0, 41)[:, None, None]
        q = np.abs(x[pairs[:, 0]] * (1.0 - t) + x[pairs[:, 1]] * t) - HALF
        distance = np.linalg.norm(np.maximum(q, 0.0), axis=-1) + np.minimum(q.max(-1), 0.0)
        worst = max(worst, float(THICKNESS - distance.min()))
    return worst


def dragged_over_the_edge(device, edge_contact, rope=False, executor=None, **settings):
    """The deepest that the box ever is in what lies over its edge while it is pulled to and fro below."""
    friction = {"static_friction": 0.3, "kinetic_friction": 0.2}
    if rope:
        shape = {"start": (-0.2, 0, 0.25), "end": (1, 0, 0.25), "segments": 12}
        it = Rope(**shape, radius=THICKNESS, pins=None, edge_contact=edge_contact)
    else:
        it = Cloth(
            resolution=(15, 15),
            size=(1.4, 1.4),
            position=(0.35, 0.02, 0.25),
            pins=None,
            thickness=THICKNESS,
            edge_contact=edge_contact,
            **friction,
        )
    with forced_executor(executor):
        sim = Simulation(Scene({"it": it}, {"box": Box(half_extents=HALF, **friction)}), fixed(**settings), device)
    worst = 0.0
    for frame in range(45):
        middle = np.array([-0.15 * (1.0 - np.cos(np.pi * frame / 30)), 0.0, 0.0])
        sim.set_collider_pose("box", middle)
        sim.step()
        if frame > 12:
            worst = max(worst, deepest(sim, middle))
    assert sim.report()["it"]["max_penetration"] < 1e-5, "particles stay outside too"
    return worst


@pytest.mark.parametrize(
    "settings",
    [
        {},
        {"order": 2},
        {"iterations": 3},
        pytest.param({"executor": "graph"}, marks=pytest.mark.long),
        {"method": "verlet", "substeps": 60},
    ],
)
def test_a_sharp_edge_does_not_poke_between_the_particles(device, settings):
    assert dragged_over_the_edge(device, False, **settings) > 0.25 * SPACING
    assert dragged_over_the_edge(device, True, **settings) < 0.01 * SPACING


@pytest.mark.parametrize("settings", [{}, pytest.param({"executor": "graph", "iterations": 2}, marks=pytest.mark.long)])
def test_a_rope_lies_over_the_edge_with_its_segments(device, settings):
    assert dragged_over_the_edge(device, False, rope=True, **settings) > 0.08 * SPACING
    assert dragged_over_the_edge(device, True, rope=True, **settings) < 0.01 * SPACING


@pytest.mark.parametrize("edge_contact", [False, True])
def test_a_thin_fast_pole_takes_the_sheet_along(device, edge_contact):
    """At 20 m/s it crosses a sheet that is 30 times as wide as itself between two rows, within a frame."""
    sheet = Cloth(resolution=(6, 6), size=(0.5, 0.5), pins=None, thickness=0.002, edge_contact=edge_contact)
    pole = Capsule(
        radius=0.002, half_length=0.5, position=(0.0, 0, -0.1), orientation=(np.sqrt(0.5), 0, 0, np.sqrt(0.5))
    )
    sim = Simulation(Scene({"sheet": sheet}, {"pole": pole}, gravity=(0, 0, 0)), device=device)
    for height in (0.233, 0.567):
        sim.set_collider_pose("pole", (0, 0, height), pole.orientation)
        sim.step()
    rows = sim.positions("sheet")[:, 2].reshape(6, 6)
    beside = rows[:, 2:4].mean()  # of the two rows that the pole came up between
    assert (beside > 0.56) == edge_contact and (np.abs(beside) < 1e-6) == (not edge_contact)


def test_an_edge_is_pushed_as_by_a_force_at_the_point_of_contact(device):
    """Both ends share it so that nothing turns about that point."""
    points = [[0.0, 0, 0.1], [1.0, 0, 0.1]]
    rope = Rope(points=points, radius=0.05, pins=None, edge_contact=True, particle_masses=[1.0, 3.0])
    knife = Box(half_extents=(1e-3, 1, 0.04), position=(0.3, 0, 0))
    sim = Simulation(
        Scene({"it": rope}, {"knife": knife}, gravity=(0, 0, 0)), Settings(method="xpbd", order=1, substeps=1), device
    )
    sim.set_collider_pose("knife", (0.3, 0, 0.03))
    sim.step()
    momentum = np.array([1.0, 3.0]) * sim.velocities("it")[:, 2]
    assert momentum.sum() > 1.0 and abs(momentum @ [-0.3, 0.7]) < 5e-3 * momentum.sum()
    x = sim.positions("it")
    assert 0.7 * x[0, 2] + 0.3 * x[1, 2] == pytest.approx(0.12, abs=1e-4)
