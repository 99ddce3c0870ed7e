# SPDX-License-Identifier: Apache-2.0
"""One mass on one spring: decay and period of each order, and the dashpot, against their closed forms."""

import numpy as np
import pytest
from fixed_settings import fixed

from cloth_sim_ros.sim import Rope, Scene, Simulation
from cloth_sim_ros.study.closed_forms import oscillator

MASS, FREQUENCY, LENGTH, STRETCH = 0.3, 12.0, 1.0, 0.1


def motion(device, frames, damping=0.0, **settings):
    """Stretch [m] after each of `frames` frames of a pinned spring along x, released 0.1 m beyond its length."""
    compliance = 1.0 / (MASS * FREQUENCY**2 * LENGTH)
    rope = Rope(
        start=(0, 0, 0),
        end=(LENGTH, 0, 0),
        segments=1,
        stretch_compliance=compliance,
        particle_masses=[MASS, MASS],
        damping=damping,
    )
    scene = Scene(objects={"it": rope}, gravity=(0.0, 0.0, 0.0))
    sim = Simulation(scene, fixed(**settings), device=device)
    sim.set_positions("it", [[0.0, 0.0, 0.0], [LENGTH + STRETCH, 0.0, 0.0]])
    found = [STRETCH]
    for _ in range(frames):
        sim.step()
        found.append(sim.positions("it")[1, 0] - LENGTH)
    return np.array(found)


def growth(q):
    """z of the recurrence q_n+2 = 2 Re z q_n+1 - |z|^2 q_n that fits the sequence."""
    twice, square = np.linalg.lstsq(np.stack([q[1:-1], -q[:-2]], axis=1), q[2:], rcond=None)[0]
    return 0.5 * twice + 1j * np.sqrt(square - 0.25 * twice**2)


@pytest.mark.parametrize("damping", [0.0, 0.02])
@pytest.mark.parametrize("iterations", [1, 4])
def test_first_order_is_implicit_euler_to_the_digit(device, damping, iterations):
    h = 1.0 / 60
    q = motion(device, 60, damping, order=1, substeps=1, iterations=iterations)
    zeta = 0.5 * damping * FREQUENCY
    z, expected = growth(q), oscillator.implicit_euler(FREQUENCY * h, zeta)
    assert oscillator.decay_rate(z, h) == pytest.approx(oscillator.decay_rate(expected, h), rel=1e-4)
    assert oscillator.period(z, h) == pytest.approx(oscillator.period(expected, h), rel=1e-4)


def test_dashpot_damps_by_its_time_constant(device):
    """At small steps the ratio of damping is tau w / 2 beyond what the method itself damps."""
    h, damping = 1.0 / 60, 0.01
    q = motion(device, 90, damping, order=1, substeps=200)
    zeta = oscillator.decay_rate(growth(q), h) / FREQUENCY
    numerical = FREQUENCY * h / 200 / 2.0
    dashpot = oscillator.damping_ratio(damping * MASS * FREQUENCY**2, MASS * FREQUENCY**2, MASS)
    assert zeta - numerical == pytest.approx(dashpot, rel=5e-3)


def test_second_order_is_bdf2(device):
    h, damping, stretch = 1.0 / 60, [], []
    for substeps in (1, 2):
        theta = FREQUENCY * h / substeps
        q = motion(device, 120, order=2, substeps=substeps)[20:]
        z, expected = growth(q), oscillator.bdf2(theta) ** substeps
        assert oscillator.decay_rate(z, h) == pytest.approx(oscillator.decay_rate(expected, h), rel=2e-3)
        assert oscillator.period(z, h) == pytest.approx(oscillator.period(expected, h), rel=1e-3)
        damping.append(oscillator.decay_rate(z, h))
        stretch.append(oscillator.period(z, h) * FREQUENCY / (2.0 * np.pi) - 1.0)
    assert np.log2(damping[0] / damping[1]) == pytest.approx(3.0, abs=0.2)
    assert np.log2(stretch[0] / stretch[1]) == pytest.approx(2.0, abs=0.2)


@pytest.mark.parametrize("order", [1, 2])
def test_fitted_order_of_the_oscillator(device, order):
    counts = [8, 16, 32, 64]
    exact = STRETCH * np.cos(FREQUENCY * np.arange(31) / 60)
    errors = [np.sqrt(np.mean((motion(device, 30, order=order, substeps=n) - exact) ** 2)) for n in counts]
    slope = -np.polyfit(np.log(counts), np.log(errors), 1)[0]
    assert slope == pytest.approx(order, abs={1: 0.15, 2: 0.2}[order])
