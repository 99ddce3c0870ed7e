# SPDX-License-Identifier: Apache-2.0
"""Colliders that are not rigid: how deep a load lies in them, what a squeeze weighs, and what it holds."""

import numpy as np
import pytest
from fixed_settings import fixed

from cloth_sim_ros.sim import Box, Cloth, Plane, Rope, Scene, Simulation

GRAVITY, THICKNESS, MASS = 9.81, 0.002, 0.05
WAYS = [
    {"substeps": 5},
    pytest.param({"substeps": 80, "order": 1}, marks=pytest.mark.long),
    {"substeps": 20, "iterations": 3},
    pytest.param({"method": "verlet", "substeps": 120}, marks=pytest.mark.long),
]
POINTS = 16


def swatch(**more):
    """A stiff square of 3 cm with 16 particles."""
    shape = {"resolution": (4, 4), "size": (0.03, 0.03), "mass": MASS, "thickness": THICKNESS, "pins": "none"}
    return Cloth(**shape, stretch_compliance=1e-3, static_friction=0.8, kinetic_friction=0.8, **more)


@pytest.mark.parametrize("settings", WAYS)
def test_a_load_lies_as_deep_as_its_force(device, settings):
    """Every particle of a swatch at rest: compliance x its weight; the collider feels all of it."""
    compliance = 0.01
    sim = Simulation(
        Scene({"it": swatch(position=(0, 0, THICKNESS))}, {"floor": Plane(compliance=compliance)}),
        fixed(global_damping=20.0, **settings),
        device,
    )
    sim.step(120)
    depth = THICKNESS - sim.positions("it")[:, 2]
    assert depth.sum() / compliance == pytest.approx(MASS * GRAVITY, rel=0.01)
    assert sim.wrench("floor")[0] == pytest.approx([0, 0, -MASS * GRAVITY], abs=0.01 * MASS * GRAVITY)


@pytest.mark.parametrize("settings", WAYS)
@pytest.mark.parametrize(("share", "holds"), [(1.5, True), (0.5, False)])
def test_two_fingers_hold_what_their_squeeze_can(device, settings, share, holds):
    """Fingers that overlap a hanging swatch by u each press with POINTS x u / compliance, and hold twice mu of that."""
    compliance, mu = 0.02, 0.8
    squeeze = share * MASS * GRAVITY / (2.0 * mu)
    gap = THICKNESS - compliance * squeeze / POINTS
    half, upright = (0.01, 0.05, 0.05), (0.0, np.sqrt(0.5), 0.0, np.sqrt(0.5))
    fingers = {
        name: Box(
            half_extents=half,
            position=(side * (half[0] + gap), 0, 0),
            compliance=compliance,
            static_friction=mu,
            kinetic_friction=mu,
        )
        for name, side in (("left", -1.0), ("right", 1.0))
    }
    sim = Simulation(Scene({"it": swatch(orientation=upright)}, fingers), fixed(**settings), device)
    sim.step(4)
    for name, side in (("left", -1.0), ("right", 1.0)):
        assert sim.wrench(name)[0][0] == pytest.approx(side * squeeze, rel=0.12 if settings["substeps"] == 5 else 0.03)
    sim.step(56)
    fallen = -sim.positions("it")[:, 2].mean()
    assert (fallen < 1e-3) == holds
    if holds:
        felt = sum(sim.wrench(name)[0][2] for name in fingers)
        assert felt == pytest.approx(-MASS * GRAVITY, rel=0.02)


def test_a_rope_sinks_too(device):
    rope = Rope(start=(0, 0, 0.01), end=(0.3, 0, 0.01), segments=10, mass=0.1, radius=0.01, pins="none")
    sim = Simulation(Scene({"it": rope}, {"floor": Plane(compliance=0.05)}), fixed(global_damping=20.0), device)
    sim.step(120)
    depth = 0.01 - sim.positions("it")[:, 2]
    assert depth.sum() / 0.05 == pytest.approx(0.1 * GRAVITY, rel=0.02)
    assert sim.wrench("floor")[0][2] == pytest.approx(-0.1 * GRAVITY, rel=0.02)
