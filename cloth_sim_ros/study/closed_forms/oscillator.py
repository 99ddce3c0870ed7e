# SPDX-License-Identifier: Apache-2.0
"""One linear spring under each method: growth per step and period, in theta = w h (angular frequency times step).

Every method turns q'' = -w^2 q (with damping -2 zeta w q') into q_n ~ z^n; |z| is the growth per step, arg z the angle.
Source: Hairer and Wanner, Solving Ordinary Differential Equations II, chapter V; Hairer, Lubich, Wanner, Geometric
Numerical Integration, chapter I.
"""

from __future__ import annotations

import numpy as np


def implicit_euler(theta, zeta=0.0):
    """z of implicit Euler: the complex root of (1 + 2 zeta theta + theta^2) z^2 - (2 + 2 zeta theta) z + 1 = 0.

    Undamped, ln|z| = -ln(1 + theta^2) / 2 and arg z = atan(theta): the period is longer by theta^2 / 3. Damped, |z|^2 =
    1 / (1 + 2 zeta theta + theta^2). Converged first-order XPBD is this method (Macklin, Mueller, Chentanez 2016).
    """
    return _upper_root([1.0 + 2.0 * zeta * theta + theta**2, -2.0 - 2.0 * zeta * theta, 1.0])


def bdf2(theta):
    """z of BDF2: the root of (3/2 - i theta) z^2 - 2 z + 1/2 = 0 near exp(i theta).

    For small theta the damping ratio is theta^3 / 4 and the period is longer by theta^2 / 3.
    """
    roots = np.roots([1.5 - 1j * theta, -2.0, 0.5])
    return roots[np.argmin(np.abs(roots - np.exp(1j * theta)))]


def forward_euler(theta):
    """z = 1 + i theta of forward Euler: every step grows the motion by sqrt(1 + theta^2)."""
    return 1.0 + 1j * theta


def verlet(theta):
    """z of leapfrog Verlet: z^2 - (2 - theta^2) z + 1 = 0. |z| = 1 up to theta = 2 and arg z = 2 asin(theta / 2)."""
    return _upper_root([1.0, theta**2 - 2.0, 1.0])


def decay_rate(z, step):
    """Exponential decay rate [1/s] of a motion whose growth per `step` [s] is z: -ln|z| / h."""
    return -np.log(np.abs(z)) / step


def period(z, step):
    """Period [s] of a motion that turns by arg z in a `step` [s]: 2 pi h / arg z."""
    return 2.0 * np.pi * step / np.angle(z)


def damping_ratio(dashpot, constant, mass):
    """zeta = c / (2 sqrt(k m)) of a mass [kg] on a spring k [N/m] with a dashpot c [N s/m] beside it.

    With axial damping given as a time constant tau [s], c = tau k and zeta = tau w / 2.
    """
    return dashpot / (2.0 * np.sqrt(constant * mass))


def damped_oscillation(t, frequency, zeta):
    """q(t) of q'' + 2 zeta w q' + w^2 q = 0 with q(0) = 1, q'(0) = 0, at times t [s], `frequency` w [rad/s], zeta <
    1."""
    t = np.asarray(t, dtype=np.float64)
    damped = frequency * np.sqrt(1.0 - zeta**2)
    return np.exp(-zeta * frequency * t) * (np.cos(damped * t) + zeta * frequency / damped * np.sin(damped * t))


def implicit_rotation(rate, step, steps):
    """Share of its angular momentum that a rigid body turning at `rate` [rad/s] keeps over `steps` of implicit Euler.

    The next position is 2 x_n - x_n-1 brought back to the circle. So the angle a step goes from phi to atan(sin(phi) /
    (2 - cos(phi))), about phi - phi^3. It is atan(W h) in the first. L ~ r^2 sin(phi) / h.
    """
    angle = np.arctan(rate * step)
    for _ in range(steps - 1):
        angle = np.arctan2(np.sin(angle), 2.0 - np.cos(angle))
    return np.sin(angle) / (rate * step)


def _upper_root(polynomial):
    roots = np.roots(polynomial)
    return roots[np.argmax(np.imag(roots))]
