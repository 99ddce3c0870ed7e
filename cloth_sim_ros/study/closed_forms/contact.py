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
