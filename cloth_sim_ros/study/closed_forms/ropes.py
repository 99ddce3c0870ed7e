# SPDX-License-Identifier: Apache-2.0
"""Hanging ropes, catenaries, hanging chains and taut strings."""

from __future__ import annotations

import numpy as np
from scipy.linalg import eigh_tridiagonal
from scipy.optimize import brentq, root
from scipy.special import jn_zeros, roots_laguerre


def hanging_stretch(s, length, weight, load, axial_stiffness):
    """Elongation u(s) [m] at rest length s [m] from the top of a hanging elastic rope.

    u(s) = [w (L s - s^2 / 2) + W s] / EA with `weight` w [N/m], end `load` W [N] and `axial_stiffness` EA [N].
    Source: integrate EA u' = w (L - s) + W (Timoshenko and Gere, Mechanics of Materials, section 2.3).
    """
    s = np.asarray(s, dtype=np.float64)
    return (weight * (length * s - 0.5 * s**2) + load * s) / axial_stiffness


def hanging_extensions(masses, constants, gravity):
    """Extensions (N-1,) [m] of the springs of a hanging chain: each carries the weight of all particles below it.

    e_j = g sum_{i > j} m_i / k_j with `masses` (N,) [kg] from the top, `constants` k (N-1,) [N/m], `gravity` g [m/s^2].
    """
    masses = np.asarray(masses, dtype=np.float64)
    below = masses.sum() - np.cumsum(masses)[:-1]
    return below * gravity / np.asarray(constants, dtype=np.float64)


def catenary_parameter(span, length):
    """c [m] of the catenary y = c cosh(x / c) of arc `length` [m] between supports of equal height, `span` [m] apart.

    Solves 2 c sinh(span / 2c) = length. The sag is c (cosh(span / 2c) - 1), the horizontal tension is H = c w.
    Source: Irvine, Cable Structures (1981), section 1.2. Raises ValueError where the rope is not longer than the span.
    """
    if not length > span > 0.0:
        raise ValueError(f"the span is {span} and the length {length}; allowed are 0 < span < length")
    # With t = span / 2c: sinh(t) / t = length / span, which grows with t from 1.
    t = brentq(lambda t: np.sinh(t) / t - length / span, 1e-9, 700.0, xtol=1e-15)
    return span / (2.0 * t)


def catenary_points(span, length, count):
    """(count, 2) points [m] at equal arc lengths along a catenary that hangs from (0, 0) and (span, 0)."""
    c = catenary_parameter(span, length)
    s = np.linspace(-0.5 * length, 0.5 * length, count)
    x = c * np.arcsinh(s / c)
    return np.stack([x + 0.5 * span, np.hypot(c, s) - np.hypot(c, 0.5 * length)], axis=1)


def catenary_chain(span, rest_lengths, masses, constants, gravity):
    """(N, 2) points [m] of a chain of springs that hangs at rest from (0, 0) and (span, 0).

    The horizontal tension H is the same in all links and the vertical one falls by the weight of each particle. So link
    j points along tan theta_j = (V0 - g sum_{1 <= i <= j} m_i) / H. It is l_j (1 + T_j / (k_j l_j)) long, with T the
    tension. `rest_lengths` l, `constants` k (N-1,) [m], [N/m] (inf: a rigid link), `masses` (N,) [kg]. H and V0 follow
    from both ends.
    """
    rest, masses = np.asarray(rest_lengths, dtype=np.float64), np.asarray(masses, dtype=np.float64)
    carried = gravity * np.concatenate([[0.0], np.cumsum(masses[1:-1])])

    def points(unknown):
        horizontal, vertical = unknown[0], unknown[1] - carried
        tension = np.hypot(horizontal, vertical)
        stretched = rest + tension / constants
        steps = np.stack([stretched * horizontal / tension, -stretched * vertical / tension], axis=1)
        return np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])

    weight = carried[-1]
    start = weight * catenary_parameter(span, max(rest.sum(), 1.0001 * span)) / rest.sum()
    found = root(lambda u: points(u)[-1] - (span, 0.0), (start, 0.5 * weight), tol=1e-13)
    if np.abs(found.fun).max() > 1e-9 * span:
        raise ArithmeticError(f"the catenary was not found: {found.message}")
    return points(found.x)


def hanging_chain_frequencies(length, gravity, count):
    """Lowest `count` angular frequencies [rad/s] of a uniform inextensible chain that hangs from one end.

    w_n = (j_0n / 2) sqrt(g / L), j_0n the zeros of the Bessel function J0. Source: D. Bernoulli (1733); Routh, Advanced
    Rigid Dynamics, chapter 13.
    """
    return 0.5 * jn_zeros(0, count) * np.sqrt(gravity / length)


def equal_beads_frequencies(link, gravity, beads):
    """All angular frequencies [rad/s] of `beads` equal masses on light links of `link` [m], hung from a fixed point.

    w^2 = (g / l) times the roots of the Laguerre polynomial L_N. Source: Levy and Lessman, Finite Difference Equations.
    """
    return np.sqrt(gravity / link * roots_laguerre(beads)[0])


def hanging_beads_modes(masses, link, gravity):
    """Angular frequencies (N,) [rad/s], rising, and shapes (N, N), one a column, of a chain hung from a fixed point.

    Any `masses` (N,) [kg] from the top, links `link` [m]. Small transverse motion under the static tensions T:
    m_i q_i'' = T_i+1 (q_i+1 - q_i) / l - T_i (q_i - q_i-1) / l.
    """
    masses = np.asarray(masses, dtype=np.float64)
    tension = gravity * np.cumsum(masses[::-1])[::-1]
    diagonal = (tension + np.append(tension[1:], 0.0)) / (link * masses)
    beside = -tension[1:] / (link * np.sqrt(masses[:-1] * masses[1:]))
    squares, vectors = eigh_tridiagonal(diagonal, beside)
    return np.sqrt(squares), vectors / np.sqrt(masses)[:, None]


def string_frequency(length, tension, line_density):
    """First frequency [Hz] of a taut string: f1 = sqrt(T / mu) / 2L (Mersenne; Rayleigh, Theory of Sound, chapter
    6)."""
    return np.sqrt(tension / line_density) / (2.0 * length)


def beaded_string_frequency(mode, tension, mass, link, beads):
    """Angular frequency [rad/s] of `mode` (1 ...) of equal beads [kg] on a taut string with links `link` [m], fixed
    ends.

    w_n = 2 sqrt(T / (m l)) sin(n pi / (2 (N + 1))). Source: Lagrange (1759); Goldstein, Classical Mechanics, chapter
    13.
    """
    return 2.0 * np.sqrt(tension / (mass * link)) * np.sin(mode * np.pi / (2.0 * (beads + 1)))
