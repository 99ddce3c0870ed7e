# SPDX-License-Identifier: Apache-2.0
"""Contact and sheets: closed forms against their differential equations, sums and energies."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from cloth_sim_ros.study.closed_forms import contact, sheets

G = 9.81


def integrated(slope, start, t):
    return solve_ivp(slope, (0.0, t), start, rtol=1e-11, atol=1e-13).y[:, -1]


def test_incline_sticks_and_slides():
    assert contact.incline_acceleration(np.arctan(0.5) - 1e-6, 0.5, 0.4, G) == 0.0
    angle = np.radians(35.0)
    assert contact.incline_acceleration(angle, 0.5, 0.4, G) == pytest.approx(G * (np.sin(angle) - 0.4 * np.cos(angle)))


@pytest.mark.parametrize("kinetic", [0.3, 0.5])
def test_incline_while_friction_falls(kinetic):
    angle, times = np.radians(35.0), np.array([0.01, 0.05, 0.5])

    def motion(t, state):
        friction = kinetic + (0.5 - kinetic) * max(1.0 - state[1] / 0.05, 0.0)
        return [state[1], G * (np.sin(angle) - friction * np.cos(angle))]

    found = contact.incline_distance(times, angle, 0.5, kinetic, 0.05, G)
    assert found == pytest.approx([integrated(motion, [0.0, 0.0], t)[0] for t in times], rel=1e-8)
    assert contact.incline_distance(1.0, np.arctan(0.5) - 1e-6, 0.5, kinetic, 0.05, G) == 0.0


def test_capstan_nodes_tend_to_the_exponential():
    smooth = contact.capstan_ratio(0.3, np.pi)
    errors = [abs(contact.capstan_ratio_of_nodes(0.3, np.pi, n) / smooth - 1.0) for n in (20, 40)]
    assert errors[0] < 0.01 and np.log2(errors[0] / errors[1]) == pytest.approx(2.0, abs=0.1)


def test_sliding_chain_solves_its_equation():
    y, _ = integrated(lambda t, y: [y[1], G / 2.0 * y[0]], [0.2, 0.0], 0.8)
    assert contact.sliding_chain(0.8, 0.2, 2.0, G) == pytest.approx(y, rel=1e-9)


def test_falling_sheet_solves_its_equation():
    terminal = sheets.terminal_speed(0.2, G, 1.225, 1.2)
    drag = 0.5 * 1.225 * 1.2 / 0.2
    distance, speed = integrated(lambda t, y: [y[1], G - drag * y[1] ** 2], [0.0, 0.0], 0.5)
    assert sheets.falling_speed(0.5, terminal, G) == pytest.approx(speed, rel=1e-9)
    assert sheets.fallen_distance(0.5, terminal, G) == pytest.approx(distance, rel=1e-9)


def test_row_pendulum_sums_and_tends_to_the_plate():
    r, a = 9, 0.1
    assert sheets.row_pendulum_frequency(np.ones(r), a, G) ** 2 == pytest.approx(G / a * 3 / (2 * r + 1), rel=1e-12)
    masses = np.ones(200)
    masses[-1] = 0.5
    assert sheets.row_pendulum_frequency(masses, 1 / 200, G) == pytest.approx(
        sheets.plate_pendulum_frequency(1.0, G), rel=1e-4
    )


@pytest.mark.parametrize("strain", [(1e-3, 0.0, 0.0), (1e-3, -4e-4, 0.0), (0.0, 0.0, 1e-3)])
def test_grid_elasticity_is_the_energy_of_one_cell(strain):
    ks, kd = 70.0, 30.0
    xx, yy, gamma = strain
    matrix = np.array([[xx, gamma / 2], [gamma / 2, yy]])
    energy = 0.0
    for edge, k in (((1, 0), ks), ((0, 1), ks), ((1, 1), kd), ((1, -1), kd)):
        edge = np.array(edge, dtype=float)
        n = edge / np.linalg.norm(edge)
        energy += 0.5 * k * (n @ matrix @ n * np.linalg.norm(edge)) ** 2
    c11, c12, c66, e2d, nu = sheets.grid_elasticity(ks, kd)
    assert energy == pytest.approx(0.5 * c11 * (xx**2 + yy**2) + c12 * xx * yy + 0.5 * c66 * gamma**2, rel=1e-12)
    assert e2d == pytest.approx(c11 - c12**2 / c11) and nu == pytest.approx(c12 / c11)


def test_drape_scale():
    assert sheets.drape_coefficient(3.0, 1.0, 3.0) == 1.0 and sheets.drape_coefficient(1.0, 1.0, 3.0) == 0.0
    assert sheets.bending_length(9.81e-3 * 0.2, 0.2, G) == pytest.approx(0.1, rel=1e-3)
