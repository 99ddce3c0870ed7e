# SPDX-License-Identifier: Apache-2.0
"""Oscillator: each growth factor is that of the method itself, stepped; expansions hold in the limit."""

import numpy as np
import pytest

from cloth_sim_ros.study.closed_forms import oscillator


def stepped(method, theta, zeta, steps):
    """q after each of `steps` steps of size theta of q'' = -q - 2 zeta q' from q = 1, q' = 0."""
    matrix = np.array([[0.0, 1.0], [-1.0, -2.0 * zeta]])
    if method == "implicit":
        advance = np.linalg.inv(np.eye(2) - theta * matrix)
    else:
        advance = np.eye(2) + theta * matrix
    state, found = np.array([1.0, 0.0]), [1.0]
    for _ in range(steps):
        state = advance @ state
        found.append(state[0])
    return np.array(found)


def is_sequence_of(z, q):
    """Whether q solves the two-term recurrence with the roots z and its conjugate."""
    return np.allclose(q[2:], 2.0 * z.real * q[1:-1] - abs(z) ** 2 * q[:-2], rtol=1e-10, atol=1e-12)


@pytest.mark.parametrize("theta, zeta", [(0.05, 0.0), (0.7, 0.0), (0.3, 0.2)])
def test_implicit_euler(theta, zeta):
    z = oscillator.implicit_euler(theta, zeta)
    assert is_sequence_of(z, stepped("implicit", theta, zeta, 20))
    assert abs(z) ** 2 == pytest.approx(1.0 / (1.0 + 2.0 * zeta * theta + theta**2), rel=1e-12)
    if zeta == 0.0:
        assert oscillator.decay_rate(z, theta) == pytest.approx(np.log(1 + theta**2) / (2 * theta), rel=1e-12)


def test_forward_euler_grows():
    z = oscillator.forward_euler(0.2)
    assert is_sequence_of(z, stepped("explicit", 0.2, 0.0, 20))
    assert abs(z) == pytest.approx(np.sqrt(1 + 0.2**2), rel=1e-12)


def test_verlet_keeps_its_amplitude_and_turns_faster():
    theta = 0.4
    q = [1.0, 1.0 - 0.5 * theta**2]
    for _ in range(20):
        q.append((2.0 - theta**2) * q[-1] - q[-2])
    z = oscillator.verlet(theta)
    assert is_sequence_of(z, np.array(q))
    assert abs(z) == pytest.approx(1.0, abs=1e-12)
    assert np.angle(z) == pytest.approx(2.0 * np.arcsin(theta / 2), rel=1e-12)


def test_bdf2_expansion():
    for theta in (0.02, 0.04):
        z = oscillator.bdf2(theta)
        damping = -np.log(abs(z)) / theta
        assert damping == pytest.approx(theta**3 / 4, rel=0.01)
        assert oscillator.period(z, theta) / (2 * np.pi) - 1 == pytest.approx(theta**2 / 3, rel=0.01)


def test_implicit_euler_period_expansion():
    theta = 0.02
    assert oscillator.period(oscillator.implicit_euler(theta), theta) / (2 * np.pi) - 1 == pytest.approx(
        theta**2 / 3, rel=1e-3
    )


def test_damped_step_tends_to_the_damped_oscillation():
    frequency, tau, mass = 5.0, 0.02, 0.3
    zeta = oscillator.damping_ratio(tau * mass * frequency**2, mass * frequency**2, mass)
    assert zeta == pytest.approx(0.5 * tau * frequency, rel=1e-12)
    errors = []
    for steps in (400, 800):
        q = stepped("implicit", frequency / steps, zeta, steps)[-1]
        errors.append(abs(q - oscillator.damped_oscillation(1.0, frequency, zeta)))
    assert np.log2(errors[0] / errors[1]) == pytest.approx(1.0, abs=0.1)


def test_implicit_rotation_is_a_step_brought_back_to_the_circle():
    rate, h = 4.0, 0.01
    x, v = np.array([1.0, 0.0]), np.array([0.0, rate])
    for _ in range(50):
        new = x + h * v
        new /= np.linalg.norm(new)
        x, v = new, (new - x) / h
    assert oscillator.implicit_rotation(rate, h, 50) == pytest.approx((x[0] * v[1] - x[1] * v[0]) / rate, rel=1e-12)
