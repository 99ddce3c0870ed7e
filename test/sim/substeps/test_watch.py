# SPDX-License-Identifier: Apache-2.0
"""Every frame tells from its last substep that its error grew, so substeps follow a sudden event at once."""

import numpy as np
import pytest

from cloth_sim_ros.sim import Cloth, Rope, Scene, Settings, Simulation
from cloth_sim_ros.sim.substeps.control import is_measured

DT = 1 / 60


def jerked(seed):
    """A crooked rope with a load of thirty times its mass, which falls until it jerks the rope."""
    ways = np.random.default_rng(seed).standard_normal((30, 3)) * 0.3 + [1, 0, 0]
    points = 0.03 * np.cumsum(np.r_[np.zeros((1, 3)), ways], axis=0)
    return Rope(points=points, mass=0.1, end_mass=3.0, stretch_compliance=1e-4)


def path(thing, settings, device, frames):
    """Positions (frames, N, 3) [m] after each frame, and the simulation."""
    sim = Simulation(Scene({"it": thing}), settings, device)
    found = []
    for _ in range(frames):
        sim.step()
        found.append(sim.positions("it").astype(np.float64))
    return np.array(found), sim


def rms(vectors):
    return np.sqrt((vectors**2).sum(axis=-1).mean())


@pytest.mark.parametrize("seed", range(4))
def test_a_rope_that_a_load_jerks_is_as_right_as_asked_and_told(device, seed):
    error, frames, rope = 1e-2, 20, jerked(seed)
    found, sim = path(rope, Settings(error=error), device, frames)
    exact, _ = path(rope, Settings(substeps=2000, order=2), device, frames)
    true = rms(found - exact) / rms(exact - sim.rest_positions("it"))
    assert true < error
    assert true < sim.report()["it"]["expected_error"]


LEVEL = {"start": (0, 0, 0), "end": (0.3, 0, 0), "segments": 24, "mass": 0.03}
PATCH = {"resolution": (12, 12), "size": (0.1, 0.1), "mass": 2e-3, "pins": "edges", "thickness": 5e-4}
SUDDEN = {  # within a frame a rope whips, and what was let go straight is stopped
    "rope let go level": Rope(**LEVEL, radius=0.0015, stretch_compliance=3.4e-3),
    "rope between two pins": Rope(**LEVEL, radius=0.002, stretch_compliance=1e-4, pins="both"),
    "sheet held at its edges": Cloth(**PATCH, stretch_compliance=1e-2, shear_compliance=3e-2),
}


@pytest.mark.parametrize("thing", SUDDEN.values(), ids=SUDDEN.keys())
def test_a_frame_with_a_sudden_event_is_computed_again(device, thing):
    """The events are over before the next measurement. They were off by 1.2 to 1.7 % of the motion."""
    found, sim = path(thing, Settings(), device, 30)
    exact, _ = path(thing, Settings(substeps=1000, order=2), device, 30)
    assert rms(found - exact) < 1e-2 * rms(exact - sim.rest_positions("it"))


def test_substeps_grow_between_two_measurements(device):
    sim = Simulation(Scene({"it": jerked(0)}), device=device)
    grown = []
    for frame in range(20):
        before = sim.choices["it"].substeps
        sim.step()
        if not is_measured(frame, DT) and sim.choices["it"].substeps > before:
            grown.append(frame)
    assert grown


def test_a_fall_that_the_steps_have_right_asks_for_no_more(device):
    """BDF2 and the trapezoidal rule are exact for a parabola."""
    sheet = Cloth(resolution=(9, 9), pins=None, position=(0, 0, 2))
    sim = Simulation(Scene({"it": sheet}), Settings(error=1e-3), device)
    sim.step(60)
    assert sim.choices["it"].substeps == sim.choices["it"].least
    assert sim.report()["it"]["expected_error"] < 1e-4


def test_substeps_that_are_set_stay(device):
    sim = Simulation(Scene({"it": jerked(0)}), Settings(substeps=12), device)
    for _ in range(20):
        sim.step()
        assert sim.report()["it"]["substeps"] == 12
    assert sim.report()["it"]["expected_error"] > 1e-2
