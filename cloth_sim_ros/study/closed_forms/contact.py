# SPDX-License-Identifier: Apache-2.0
"""Dry friction and edges: inclines, the capstan, a chain that slides over an edge."""

from __future__ import annotations

import numpy as np


def incline_acceleration(angle, static_friction, kinetic_friction, gravity):
    """Acceleration [m/s^2] down an incline of `angle` [rad] of a body that starts at rest.

    0 while tan(angle) <= mu_s, else g (sin(angle) - mu_k cos(angle)). Source: Coulomb (1785).
    """
    if np.tan(angle) <= static_friction:
        return 0.0
    return gravity * (np.sin(angle) - kinetic_friction * np.cos(angle))


def incline_distance(t, angle, static_friction, kinetic_friction, slow, gravity):
    """Way [m] down an incline at times t [s] from rest, of a body whose friction falls with its speed v.

    It falls in proportion from mu_s at rest to mu_k at `slow` [m/s] (Stribeck 1902). So v' = a + k v with
    a = g (sin(angle) - mu_s cos(angle)) and k = g cos(angle) (mu_s - mu_k) / slow. The way is
    a / k^2 (e^(k t) - 1 - k t) until v = a / k (e^(k t) - 1) is `slow`. From then on v' is `incline_acceleration`.
    """
    t = np.asarray(t, dtype=np.float64)
    a = gravity * (np.sin(angle) - static_friction * np.cos(angle))
    k = gravity * np.cos(angle) * (static_friction - kinetic_friction) / slow
    if a <= 0.0:
        return np.zeros_like(t)
    if k == 0.0:
        return 0.5 * a * t**2
    end = np.log1p(k * slow / a) / k
    early, late = np.minimum(t, end), np.maximum(t - end, 0.0)
    after = incline_acceleration(angle, static_friction, kinetic_friction, gravity)
    return a / k**2 * (np.expm1(k * early) - k * early) + slow * late + 0.5 * after * late**2


def capstan_ratio(friction, angle):
    """T2 / T1 = exp(mu phi) at which a rope slips that is wound by `angle` phi [rad] (Euler 1769, Eytelwein 1808)."""
    return np.exp(friction * angle)


def capstan_ratio_of_nodes(friction, angle, nodes):
    """T2 / T1 at the slip of a chain that turns by `angle` / `nodes` [rad] at each of its nodes on the drum.

    A node that turns by delta is pressed by N = (T1 + T2) sin(delta / 2) and held by mu N = (T2 - T1) cos(delta / 2).
    Hence T2 / T1 = (1 + mu t) / (1 - mu t) with t = tan(delta / 2).
    """
    t = np.tan(0.5 * angle / nodes)
    return ((1.0 + friction * t) / (1.0 - friction * t)) ** nodes


def sliding_chain(t, overhang, length, gravity):
    """Overhang y(t) [m] of an inextensible chain that slides without friction over an edge from rest.

    y'' = (g / L) y, so y = y0 cosh(t sqrt(g / L)), up to y = L. Source: Lamb, Dynamics (1914), section 49.
    """
    return overhang * np.cosh(np.asarray(t, dtype=np.float64) * np.sqrt(gravity / length))
