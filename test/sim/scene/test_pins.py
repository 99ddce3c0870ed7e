# SPDX-License-Identifier: Apache-2.0
"""Pins that change while a simulation runs: everything goes on from where it is."""

import numpy as np
import pytest

from cloth_sim_ros.sim import Cloth, Rope, Scene, Settings, Simulation

VERLET = pytest.param({"method": "verlet", "substeps": 80}, marks=pytest.mark.long)


@pytest.mark.parametrize("settings", [{}, {"substeps": 20}, VERLET])
def test_other_pins_hold_others_where_they_are(device, settings):
    cloth = Cloth(resolution=(8, 8), pins="corners", bending="dihedral", bend_compliance=100.0)
    sim = Simulation(Scene({"cloth": cloth, "rope": Rope(segments=8)}), Settings(**settings), device)
    sim.step(20)
    x, v = sim.positions("cloth"), sim.velocities("cloth")
    rope = sim.positions("rope")
    sim.set("cloth.pins", [0, 7])
    np.testing.assert_array_equal(sim.positions("cloth"), x)
    np.testing.assert_array_equal(sim.positions("rope"), rope)
    moving = np.delete(np.arange(64), [0, 7, 56, 63])
    np.testing.assert_array_equal(sim.velocities("cloth")[moving], v[moving])
    assert (sim.velocities("cloth")[[0, 7]] == 0).all()
    sim.step(30)
    np.testing.assert_array_equal(sim.positions("cloth")[[0, 7]], x[[0, 7]])
    assert (sim.positions("cloth")[[56, 63], 2] < x[[56, 63], 2] - 0.1).all(), "what was pinned falls"


@pytest.mark.parametrize("settings", [{}, {"method": "xpbd", "substeps": 80, "iterations": 1}])
def test_a_rigid_sheet_whose_sides_are_pulled_apart_stays_between_them_and_comes_back(device, settings):
    """To twice its width, which no rigid spring can meet: it does not fly away, and all is well when they are back."""
    pins = tuple(np.r_[0:100:10, 9:100:10].tolist())
    sheet = Cloth(resolution=(10, 10), size=(0.9, 0.9), stretch_compliance=0.0, pins=pins, damping=2e-3)
    sim = Simulation(Scene({"it": sheet}), Settings(global_damping=2.0, **settings), device)
    rest = sim.rest_positions("it")
    for frame in range(200):
        x, v = sim.positions("it"), sim.velocities("it")
        x[list(pins)] = rest[list(pins)] * [1.0 + np.clip(min(frame, 90 - frame) / 30.0, 0.0, 1.0), 1.0, 1.0]
        sim.set_positions("it", x)
        sim.set_velocities("it", v)
        sim.step()
        assert np.abs(sim.positions("it")).max() < 3.0
    assert sim.report()["it"]["recoveries"] == 0
    assert sim.report()["it"]["max_strain"] < 5e-3
    assert np.abs(sim.positions("it") - rest).max() < 5e-3, "between its sides it is flat again"


def test_what_is_let_go_falls_freely(device):
    sim = Simulation(Scene({"cloth": Cloth(resolution=(6, 6), pins="none")}), Settings(substeps=20), device)
    sim.step(10)
    sim.set("cloth.pins", "none")
    sim.step(20)
    fallen = -sim.positions("cloth")[:, 2]
    assert fallen == pytest.approx(0.5 * 9.81 * 0.25, rel=0.01)
    assert sim.velocities("cloth")[:, 2] == pytest.approx(-9.81 * 0.5, rel=2e-3)


def test_pins_that_cannot_be_change_nothing():
    sim = Simulation(Scene({"cloth": Cloth(resolution=(6, 6))}), Settings(substeps=20), "cpu")
    with pytest.raises(ValueError, match="cloth.pins is 'top left'; allowed is one of"):
        sim.set("cloth.pins", "top left")
    with pytest.raises(ValueError, match="allowed is to set it in all of them"):
        Simulation(Scene({"cloth": Cloth()}), worlds=2, device="cpu").set("cloth.pins", "none", world=1)
    sim.step(5)
    assert (sim.velocities("cloth")[[30, 35]] == 0).all()
