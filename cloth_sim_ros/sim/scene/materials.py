# SPDX-License-Identifier: Apache-2.0
"""Material presets by name: mass, stretch, bending, damping and friction of sheets and ropes.

Every preset names the source of its numbers. Cloth is anisotropic and stiffens as it stretches. A preset is the nearest
isotropic sheet at the loads of hanging cloth. "KES-F" marks rounded typical values of such cloth (Kawabata 1980, The
standardization and analysis of hand evaluation). "makers" marks rounded catalogue values. "estimate" marks values
without a source. Damping times are estimates throughout: loss factors of 0.1 to 0.3 at about 5 Hz.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Fabric:
    """A sheet: areal_mass [kg/m^2], Young's modulus `stretch` and `shear` modulus [N/m] in its plane, flexural rigidity
    `bending` [N m], `damping` time [s], `thickness` [m], coefficients of friction."""

    areal_mass: float
    stretch: float
    shear: float
    bending: float
    damping: float
    thickness: float
    static_friction: float
    kinetic_friction: float
    source: str


@dataclass(frozen=True)
class Cord:
    """A rope of `radius` [m]: linear_mass [kg/m], `stretch` = EA [N], `bending` = EI [N m^2], `damping` time [s],
    coefficients of friction."""

    radius: float
    linear_mass: float
    stretch: float
    bending: float
    damping: float
    static_friction: float
    kinetic_friction: float
    source: str


# Values from Wang et al. 2011, Data-driven elastic models for cloth. Moduli are the geometric mean of warp and weft at
# small strain. Bending is a quarter of their constant, which multiplies a force of half the angle over both heights.
FABRICS = {
    "cotton": Fabric(
        0.13, 1500.0, 50.0, 7e-6, 5e-3, 0.3e-3, 0.5, 0.4,
        "plain-woven shirting: mass, shear and bending by KES-F; stretch and friction "
        "are estimates",
    ),
    "jersey": Fabric(
        0.187, 80.0, 37.0, 5.5e-6, 8e-3, 0.7e-3, 0.5, 0.4,
        "T-shirt, 60 % cotton: Wang et al. 2011, gray interlock, its stretch between their 24 N/m at small strain and "
        "110 N/m beyond; thickness and friction are estimates",
    ),
    "denim": Fabric(
        0.324, 460.0, 60.0, 1.8e-5, 5e-3, 0.7e-3, 0.55, 0.45,
        "jeans with 1 % elastane: Wang et al. 2011, 11 oz black denim; thickness and friction are estimates",
    ),
    "silk": Fabric(
        0.06, 800.0, 15.0, 1.5e-6, 3e-3, 0.15e-3, 0.35, 0.25,
        "habutai of 14 momme: mass by its trade weight; shear and bending by KES-F; "
        "stretch and friction are estimates",
    ),
    "wool": Fabric(
        0.25, 1000.0, 40.0, 1.1e-5, 8e-3, 0.7e-3, 0.5, 0.4,
        "men's suiting: mass, shear and bending by KES-F; stretch and friction are "
        "estimates",
    ),
    "towel": Fabric(
        0.45, 600.0, 40.0, 4e-5, 1e-2, 4e-3, 0.7, 0.6,
        "cotton terry: mass by its trade weight of 400 to 600 g/m^2; all else is an estimate",
    ),
    "polyester": Fabric(
        0.128, 2000.0, 28.0, 8e-6, 4e-3, 0.25e-3, 0.4, 0.3,
        "tablecloth: Wang et al. 2011, white dots on black; thickness and friction are estimates",
    ),
    "ripstop": Fabric(
        0.04, 2e4, 100.0, 3e-6, 2e-3, 0.076e-3, 0.4, 0.3,
        "nylon for parachutes, MIL-C-44378 type I: mass 1.17 oz/yd^2, thickness 0.003 in; stretch from its strength of "
        "45 lbf/in at an elongation of 40 %; shear, bending and friction are estimates",
    ),
    "rubber": Fabric(
        1.1, 2200.0, 730.0, 2.4e-4, 3e-3, 1e-3, 1.0, 0.8,
        "natural rubber of 50 Shore A, 1 mm thick: E = 2.2 MPa, incompressible (Gent 2012, Engineering with Rubber); "
        "friction is an estimate",
    ),
    "neoprene": Fabric(
        0.6, 1500.0, 550.0, 1.2e-3, 1e-2, 3e-3, 0.8, 0.7,
        "foamed wetsuit sheet, 3 mm thick, 200 kg/m^3, E = 0.5 MPa: estimates",
    ),
}  # fmt: skip

CORDS = {
    "cotton rope": Cord(
        4e-3, 0.04, 1.5e4, 4e-4, 1e-2, 0.5, 0.4,
        "three strands, 8 mm: mass by makers' tables; EA and EI are estimates, EI from an overhang of 0.2 m (Peirce)",
    ),
    "nylon rope": Cord(
        5e-3, 0.062, 5e4, 2e-3, 1e-2, 0.4, 0.3,
        "three strands, 10 mm: makers' tables, EA from 9 % at a fifth of the breaking load; EI is an estimate",
    ),
    "polyester rope": Cord(
        5e-3, 0.076, 1.7e5, 3e-3, 8e-3, 0.4, 0.3,
        "double braid, 10 mm: makers' tables, EA from 3 % at a fifth of the breaking load; EI is an estimate",
    ),
    "climbing rope": Cord(
        4.9e-3, 0.063, 9.8e3, 1.5e-3, 1.5e-2, 0.4, 0.3,
        "dynamic single rope, 9.8 mm: makers' data, EA from 8 % under 80 kg (EN 892 allows 10 %); EI is an estimate",
    ),
    "steel cable": Cord(
        3e-3, 0.14, 1.4e6, 5e-2, 5e-4, 0.2, 0.15,
        "6 x 19 with fibre core, 6 mm: mass by engineeringtoolbox.com, EA from 14 mm^2 of metal at 100 GPa (Feyrer "
        "2015, Wire Ropes); EI, an estimate, is twice that of its wires side by side, which friction ties together",
    ),
    "rubber hose": Cord(
        9.5e-3, 0.2, 5e3, 5e-2, 3e-3, 0.9, 0.7,
        "garden hose with a textile layer, 12.5 mm by 19 mm, E = 10 MPa in bending: estimates",
    ),
    "power cable": Cord(
        4e-3, 0.105, 2e5, 2e-2, 5e-3, 0.6, 0.5,
        "flexible PVC sheath with 3 x 1.5 mm^2 of copper strands, 8 mm: mass by makers' tables, else estimates",
    ),
}  # fmt: skip


def spring_constants(stretch: float, shear: float) -> tuple[float, float]:
    """Constants (k_s, k_d) [N/m] of the structural and diagonal springs of a grid of square cells.

    Such a grid has the shear modulus C66 = k_d and Young's modulus E = k_s (k_s + 2 k_d) / (k_s + k_d) [N/m]; this
    solves the second for k_s. Poisson's ratio follows, k_d / (k_s + k_d).
    """
    return 0.5 * (stretch - 2.0 * shear + math.hypot(stretch, 2.0 * shear)), shear


def sheet_fields(name: str, area: float, mesh: bool = False, bending: str = "dihedral") -> dict[str, Any]:
    """The fields of a Cloth of `area` [m^2] in the material called `name`. Raises ValueError if there is none.

    A mesh has no shear springs. Its edges carry Young's modulus, exactly for equilateral triangles, and a shear modulus
    of 3/8 of it. The material sets the bending only if `bending` is "dihedral".
    """
    fabric = _find(FABRICS, name)
    along, diagonal = spring_constants(fabric.stretch, fabric.shear)
    fields = {
        "mass": fabric.areal_mass * area,
        "stretch_compliance": 1.0 / (fabric.stretch if mesh else along),
        "shear_compliance": 1.0 / diagonal,
        "damping": fabric.damping,
        "thickness": 0.5 * fabric.thickness,
        "static_friction": fabric.static_friction,
        "kinetic_friction": fabric.kinetic_friction,
    }
    if bending == "dihedral":
        fields |= {"bending": "dihedral", "bend_compliance": 1.0 / fabric.bending}
    return fields


def triangles_area(vertices: np.ndarray, triangles: np.ndarray) -> float:
    """The area [m^2] of `triangles` (T, 3) over `vertices` (N, 3) [m]."""
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    return 0.5 * float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum())


def rope_fields(name: str, length: float, radius: float | None = None) -> dict[str, Any]:
    """The fields of a Rope of `length` [m] in the material called `name`. Raises ValueError if there is none.

    Another `radius` [m] than the preset's scales the rope: mass and EA grow with its square, EI with its fourth power.
    """
    cord = _find(CORDS, name)
    larger = (radius or cord.radius) / cord.radius
    return {
        "radius": radius or cord.radius,
        "mass": cord.linear_mass * larger**2 * length,
        "stretch_compliance": 1.0 / (cord.stretch * larger**2),
        "bend_compliance": 1.0 / (cord.bending * larger**4),
        "damping": cord.damping,
        "static_friction": cord.static_friction,
        "kinetic_friction": cord.kinetic_friction,
    }


def _find(presets: dict[str, Any], name: str) -> Any:
    if name not in presets:
        raise ValueError(f"material is {name!r}; allowed is one of {', '.join(presets)}")
    return presets[name]
