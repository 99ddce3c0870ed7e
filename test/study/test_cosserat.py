# SPDX-License-Identifier: Apache-2.0
"""The solver for cosseratbench: its rods, ends, loads and frictions are those of the product's ropes."""

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("cosseratbench")

from cosseratbench import registry
from cosseratbench.experiment import run
from cosseratbench.scenario import EndCondition, Material, Motion, Plane, PointLoad, Rod, Scenario

from cloth_sim_ros.study.cosserat import Solver

MATERIAL = Material(youngs_modulus=1e6, shear_modulus=1e6 / 3.0, density=1000.0)


def rod(**fields):
    return Rod(((0.0, 0.0, 0.0), (0.4, 0.0, 0.0)), radius=0.01, material=MATERIAL, **fields)


def test_the_benchmark_finds_it():
    solver = registry.load_solver("cloth_sim", time_step_scale=2.0)
    assert isinstance(solver, Solver)
    scenario = Scenario((rod(),), duration=1.0, quasi_static=True)
    assert solver.settings(scenario, n_elements=4, n_frames=2)["error"] == pytest.approx(4e-3)


def test_a_clamp_with_a_load_bends_as_the_beam_does():
    """F L^3 / 3 EI. A clamp that were an element too long or too short would miss by 3/20 here."""
    found = run(registry.load_experiment("cantilever"), Solver(), n_elements=20, n_frames=51)
    assert found.outcome == "completed"
    assert found.metrics["tip_deflection_error"] < 0.01


def test_a_turned_end_slides_as_far_as_its_load_stretches():
    """T L / EA along the rod, and directors that turn evenly from one clamp to the other, once round and a quarter."""
    times, turn = np.linspace(0.0, 0.5, 11), np.linspace(0.0, 2.5 * np.pi, 11)
    motion = Motion(
        tuple(times), ((0.0,) * 3,) * 11, tuple((angle, 0.0, 0.0) for angle in turn), slides_along=(1.0, 0.0, 0.0)
    )
    held = {"start": EndCondition.CLAMPED, "end": EndCondition.CLAMPED, "end_motion": motion}
    pulled = rod(loads=(PointLoad((3.0, 0.0, 0.0)),), **held)
    scenario = Scenario((pulled,), duration=2.0, quasi_static=True, self_contact=False)
    found = Solver().run(scenario, n_elements=10, n_frames=21)
    longer = 3.0 * pulled.length / (MATERIAL.youngs_modulus * pulled.area)
    assert found.positions[0][-1, -1, 0] - pulled.length == pytest.approx(longer, rel=0.01)
    angles = 2.5 * np.pi * (np.arange(10) + 0.5) / 10
    expected = np.stack([0.0 * angles, -np.sin(angles), np.cos(angles)], axis=1)
    assert np.abs(found.directors[0][-1] - expected).max() < 0.01
    assert np.abs(found.directors[0][0] - pulled.directors(10)).max() < 1e-6


def test_a_rope_slides_on_a_slope_as_the_larger_friction_lets_it():
    """g t^2/2 (sin a - mu cos a): with mu of the rope, of the plane, and never their mean."""
    slope, g = 0.5, np.array([np.sin(0.5), 0.0, -np.cos(0.5)]) * 9.81
    for own, floor in ((0.3, 0.1), (0.0, 0.3), (0.3, 0.3)):
        lying = rod(friction=own)
        plane = Plane((0.0, 0.0, -lying.radius), (0.0, 0.0, 1.0), friction=floor)
        scenario = Scenario((lying,), 0.5, tuple(g), (plane,), self_contact=False)
        found = Solver().run(scenario, n_elements=8, n_frames=6)
        way = 0.5 * 9.81 * 0.5**2 * (np.sin(slope) - 0.3 * np.cos(slope))
        assert found.positions[0][-1, 0, 0] == pytest.approx(way, rel=0.03)


def test_frictions_without_an_answer_are_refused():
    smooth = Scenario((rod(),), 0.1, obstacles=(Plane((0.0, 0.0, -1.0), (0.0, 0.0, 1.0), friction=0.3),))
    with pytest.raises(NotImplementedError, match="friction"):
        Solver().run(smooth, n_elements=4, n_frames=2)
    two = replace(smooth, rods=(rod(friction=0.1), rod(friction=0.2)))
    with pytest.raises(NotImplementedError, match="same friction"):
        Solver().run(two, n_elements=4, n_frames=2)
