# SPDX-License-Identifier: Apache-2.0
"""Sheets: as a pendulum, falling in air, as an elastic continuum, draped over a table."""

from __future__ import annotations

import numpy as np


def plate_pendulum_frequency(length, gravity):
    """Angular frequency [rad/s] of small swings of a stiff uniform sheet hung from one edge: w^2 = 3 g / (2 L)."""
    return np.sqrt(1.5 * gravity / length)


def row_pendulum_frequency(row_masses, spacing, gravity):
    """Angular frequency [rad/s] of a stiff sheet of rows at `spacing` a [m] below its fixed row.

    w^2 = (g / a) sum(j m_j) / sum(j^2 m_j), j = 1 ... r; for r equal rows (g / a) 3 / (2 r + 1). `row_masses` (r,)
    [kg].
    """
    masses = np.asarray(row_masses, dtype=np.float64)
    j = np.arange(1, len(masses) + 1)
    return np.sqrt(gravity / spacing * (j * masses).sum() / (j**2 * masses).sum())


def terminal_speed(areal_density, gravity, air_density, drag_coefficient):
    """v_t [m/s] = sqrt(2 sigma g / (rho Cd)) of a flat sheet that falls face on in still air; sigma [kg/m^2]."""
    return np.sqrt(2.0 * areal_density * gravity / (air_density * drag_coefficient))


def falling_speed(t, terminal, gravity):
    """Speed [m/s] after t [s] from rest under quadratic drag: v = v_t tanh(g t / v_t)."""
    return terminal * np.tanh(gravity * np.asarray(t, dtype=np.float64) / terminal)


def fallen_distance(t, terminal, gravity):
    """Distance [m] fallen after t [s] from rest under quadratic drag: (v_t^2 / g) ln cosh(g t / v_t)."""
    return terminal**2 / gravity * np.log(np.cosh(gravity * np.asarray(t, dtype=np.float64) / terminal))


def grid_elasticity(spring, diagonal):
    """(C11, C12, C66, E2D, nu) of a square grid of springs `spring` k_s and both diagonals `diagonal` k_d [N/m].

    C11 = k_s + k_d, C12 = C66 = k_d, E2D = k_s (k_s + 2 k_d) / (k_s + k_d), nu = k_d / (k_s + k_d); all but nu in N/m.
    Springs on a border belong to half a cell and have half the constant. Source: the energy of uniform strain per cell
    (Ostoja-Starzewski, Lattice models in micromechanics, Applied Mechanics Reviews 55, 2002).
    """
    c11, c12 = spring + diagonal, diagonal
    return c11, c12, diagonal, spring * (spring + 2.0 * diagonal) / c11, diagonal / c11


def drape_coefficient(draped_area, table_area, cloth_area):
    """(A_s - A_d) / (A_c - A_d): shadow of the draped cloth, table and flat cloth [m^2] (Cusick 1968; BS 5058).

    1 for a stiff sheet that does not droop, 0 for one whose shadow is the table's.
    """
    return (draped_area - table_area) / (cloth_area - table_area)


def bending_length(flexural_rigidity, areal_density, gravity):
    """(B / (sigma g))^(1/3) [m]: over this length a sheet bends under its weight; B [N m] (Peirce 1930)."""
    return np.cbrt(flexural_rigidity / (areal_density * gravity))
