# SPDX-License-Identifier: Apache-2.0
"""Material presets by name: mass, stretch, bending, damping and friction of sheets and ropes.

Every preset names the source of its numbers. Cloth stiffens as it stretches. A preset is the nearest linear sheet at
the loads of hanging cloth. "KES-F" marks rounded typical values of such cloth (Kawabata 1980, The standardization and
analysis of hand evaluation). "makers" marks rounded catalogue values. "estimate" marks values without a source. Damping
times are estimates throughout: loss factors of 0.1 to 0.3 at about 5 Hz. In bending of ropes, whose strands rub, they
are 0.3 to 0.6.

"Feng" marks bending of woven cloth of such a mass, by cantilever in warp, weft and at 45 degrees, among the 618 fabrics
of Feng, Huang, Xu and Wang 2022, Learning-based bending stiffness parameter estimation by a drape tester. "Wang" marks
Wang, O'Brien and Ramamoorthi 2011, Data-driven elastic models for cloth, at small strain. A quarter of their bending
constant is a rigidity, as it multiplies a force of half the angle over both heights.

Fabrics of one name differ by several times in bending. Which of the measured ones silk, flag, leather, cotton and denim
are was chosen with published drape coefficients in view (docs/explanation/fabric.md).
"""

from __future__ import annotations

import logging
import math
from collections.abc import Mapping
from dataclasses import MISSING, dataclass, fields
from functools import lru_cache
from numbers import Real
from types import MappingProxyType
from typing import Any

import numpy as np

from cloth_sim_ros.sim.input.mesh_repair import areas_of

_LOG = logging.getLogger(__name__)


@dataclass(frozen=True)
class Fabric:
    """A woven or knitted sheet, or one of one's own.

    areal_mass [kg/m^2]. warp, weft: Young's moduli, and shear modulus [N/m]. poisson: contraction of the weft over a
    stretch along the warp. On grids the springs give it, about shear / weft. bend_warp, bend_weft, bend_diagonal:
    flexural rigidities [N m] of strips along warp, weft and at 45 degrees, as by cantilever; 4 / bend_diagonal is more
    than 1 / bend_warp + 1 / bend_weft. damping: time [s]. thickness [m]. Coefficients of friction. Raises
    ValueError where the mass, a modulus or a rigidity is no number above 0.
    """

    areal_mass: float
    warp: float
    weft: float
    shear: float
    poisson: float
    bend_warp: float
    bend_weft: float
    bend_diagonal: float
    damping: float = 5e-3
    thickness: float = 0.5e-3
    static_friction: float = 0.5
    kinetic_friction: float = 0.4
    source: str = ""

    def __post_init__(self) -> None:
        for field in fields(self)[:-1]:
            value, positive = getattr(self, field.name), field.default is MISSING and field.name != "poisson"
            if not isinstance(value, Real) or isinstance(value, bool) or (positive and not 0.0 < value < math.inf):
                allowed = "a finite number above 0" if positive else "a number"
                raise ValueError(f"Fabric.{field.name} is {value!r}; allowed is {allowed}")


@dataclass(frozen=True)
class Cord:
    """A rope of `radius` [m]: linear_mass [kg/m], `stretch` = EA [N], `bending` = EI [N m^2], times of `damping` in
    stretch and of `bend_damping` [s], coefficients of friction."""

    radius: float
    linear_mass: float
    stretch: float
    bending: float
    damping: float
    bend_damping: float
    static_friction: float
    kinetic_friction: float
    source: str


FABRICS = {
    "cotton": Fabric(
        0.13, 1500.0, 1200.0, 50.0, 0.1, 1.3e-5, 8.1e-6, 1.05e-5, 5e-3, 0.3e-3, 0.5, 0.4,
        "plain-woven shirting: mass and shear by KES-F, bending the upper quartile of 72 of 0.11 to 0.15 kg/m^2 by "
        "Feng; stretch and friction are estimates",
    ),
    "jersey": Fabric(
        0.187, 80.0, 80.0, 37.0, 0.3, 5.8e-6, 3.6e-6, 6.2e-6, 8e-3, 0.7e-3, 0.5, 0.4,
        "T-shirt, 60 % cotton: Wang's gray interlock, its stretch between their 24 N/m at small strain and 110 N/m "
        "beyond; thickness and friction are estimates",
    ),
    "denim": Fabric(
        0.324, 1010.0, 205.0, 60.0, 0.1, 1.04e-4, 4.3e-5, 4.4e-5, 5e-3, 0.7e-3, 0.55, 0.45,
        "jeans with 1 % elastane in the weft: mass, stretch and shear of Wang's 11 oz black denim, bending the "
        "stiffest tenth of 51 of 0.28 to 0.36 kg/m^2 by Feng; thickness and friction are estimates",
    ),
    "silk": Fabric(
        0.07, 500.0, 400.0, 15.0, 0.1, 1.4e-6, 1.0e-6, 1.2e-6, 3e-3, 0.15e-3, 0.35, 0.25,
        "habutai of 16 momme: mass by its trade weight, shear and mean bending by KES-F; the ratio of warp to weft, "
        "stretch and friction are estimates",
    ),
    "wool": Fabric(
        0.25, 1000.0, 700.0, 40.0, 0.1, 1.4e-5, 1.0e-5, 1.2e-5, 8e-3, 0.7e-3, 0.5, 0.4,
        "men's suiting: mass, shear and mean bending by KES-F; the ratio of warp to weft, stretch and "
        "friction are estimates",
    ),
    "towel": Fabric(
        0.45, 600.0, 600.0, 40.0, 0.1, 4e-5, 4e-5, 4e-5, 1e-2, 4e-3, 0.7, 0.6,
        "cotton terry: mass by its trade weight of 400 to 600 g/m^2; all else is an estimate",
    ),
    "polyester": Fabric(
        0.128, 2000.0, 2000.0, 28.0, 0.02, 1.3e-5, 7.8e-6, 1.0e-5, 4e-3, 0.25e-3, 0.4, 0.3,
        "tablecloth: Wang's white dots on black; thickness and friction are estimates",
    ),
    "flag": Fabric(
        0.11, 800.0, 600.0, 20.0, 0.1, 1.1e-6, 1.9e-6, 1.7e-6, 4e-3, 0.2e-3, 0.35, 0.25,
        "limp polyester banner: mass by makers, bending of one of the limpest by Feng, their seventh; all else is an "
        "estimate",
    ),
    "fleece": Fabric(
        0.228, 150.0, 245.0, 30.0, 0.3, 2.9e-5, 1.5e-5, 2.2e-5, 8e-3, 2e-3, 0.6, 0.5,
        "polyester blanket: Wang's pink ribbon brown; thickness and friction are estimates",
    ),
    "leather": Fabric(
        0.5, 5000.0, 5000.0, 1800.0, 0.4, 4e-5, 4e-5, 4e-5, 1e-2, 0.8e-3, 0.6, 0.5,
        "soft sheep leather for garments: bending by its drape (Memon et al. 2021, Materials 14, 4553); all else is an "
        "estimate",
    ),
    "ripstop": Fabric(
        0.04, 2e4, 2e4, 100.0, 0.02, 3e-6, 3e-6, 3e-6, 2e-3, 0.076e-3, 0.4, 0.3,
        "nylon for parachutes, MIL-C-44378 type I: mass 1.17 oz/yd^2, thickness 0.003 in; stretch from its strength of "
        "45 lbf/in at an elongation of 40 %; shear, bending and friction are estimates",
    ),
    "rubber": Fabric(
        1.1, 2200.0, 2200.0, 730.0, 0.5, 2.4e-4, 2.4e-4, 2.4e-4, 3e-3, 1e-3, 1.0, 0.8,
        "natural rubber of 50 Shore A, 1 mm thick: E = 2.2 MPa, incompressible (Gent 2012, Engineering with Rubber); "
        "friction is an estimate",
    ),
    "neoprene": Fabric(
        0.6, 1500.0, 1500.0, 550.0, 0.36, 1.2e-3, 1.2e-3, 1.2e-3, 1e-2, 3e-3, 0.8, 0.7,
        "foamed wetsuit sheet, 3 mm thick, 200 kg/m^3, E = 0.5 MPa: estimates",
    ),
}  # fmt: skip

CORDS = {
    "cotton rope": Cord(
        4e-3, 0.04, 1.5e4, 4e-4, 1e-2, 2e-2, 0.5, 0.4,
        "three strands, 8 mm: mass by makers' tables; EA and EI are estimates, EI from an overhang of 0.2 m (Peirce)",
    ),
    "nylon rope": Cord(
        5e-3, 0.062, 5e4, 2e-3, 1e-2, 1.5e-2, 0.4, 0.3,
        "three strands, 10 mm: makers' tables, EA from 9 % at a fifth of the breaking load; EI is an estimate",
    ),
    "polyester rope": Cord(
        5e-3, 0.076, 1.7e5, 3e-3, 8e-3, 1.5e-2, 0.4, 0.3,
        "double braid, 10 mm: makers' tables, EA from 3 % at a fifth of the breaking load; EI is an estimate",
    ),
    "climbing rope": Cord(
        4.9e-3, 0.063, 9.8e3, 1.5e-3, 1.5e-2, 2e-2, 0.4, 0.3,
        "dynamic single rope, 9.8 mm: makers' data, EA from 8 % under 80 kg (EN 892 allows 10 %); EI is an estimate",
    ),
    "steel cable": Cord(
        3e-3, 0.14, 1.4e6, 5e-2, 5e-4, 1e-2, 0.2, 0.15,
        "6 x 19 with fibre core, 6 mm: mass by engineeringtoolbox.com, EA from 14 mm^2 of metal at 100 GPa (Feyrer "
        "2015, Wire Ropes); EI, an estimate, is twice that of its wires side by side, which friction ties together",
    ),
    "rubber hose": Cord(
        9.5e-3, 0.2, 5e3, 5e-2, 3e-3, 1e-2, 0.9, 0.7,
        "garden hose with a textile layer, 12.5 mm by 19 mm, E = 10 MPa in bending: estimates",
    ),
    "power cable": Cord(
        4e-3, 0.105, 2e5, 2e-2, 5e-3, 1.5e-2, 0.6, 0.5,
        "flexible PVC sheath with 3 x 1.5 mm^2 of copper strands, 8 mm: mass by makers' tables, else estimates",
    ),
}  # fmt: skip


def spring_constants(
    warp: float, weft: float, shear: float, cell: tuple[float, float] = (1.0, 1.0)
) -> tuple[float, float, float]:
    """Constants [N/m] of the structural springs along warp and weft, and of the diagonals, of a grid.

    Such a grid has C12 = C66, its shear modulus G. Young's moduli are C11 - G^2 / C22 and C22 - G^2 / C11, which this
    solves. A cell of sides a and b has G = 2 k_d a b / (a^2 + b^2), C11 = k_warp a / b + G a^2 / b^2, and C22 likewise.
    Poisson's ratio follows, G / C22.

    Args:
        warp: Young's modulus along the warp [N/m].
        weft: Young's modulus along the weft [N/m].
        shear: Shear modulus [N/m].
        cell: Sides of a cell along warp and weft, in any unit.
    """
    longer = cell[0] / cell[1]
    along = 0.5 * (warp + math.sqrt(warp**2 + 4.0 * shear**2 * warp / weft))
    across = along * weft / warp
    diagonal = 0.5 * shear * (longer + 1.0 / longer)
    return (along - shear * longer**2) / longer, (across - shear / longer**2) * longer, diagonal


def sheet_fields(
    material: str | Fabric,
    area: float,
    given: Mapping[str, Any] = MappingProxyType({}),
    cell: tuple[float, float] | None = None,
) -> dict[str, Any]:
    """The fields of a Cloth in a material.

    The material sets bending only where that is "dihedral". A compliance that is given scales those of weft and
    diagonal that are not. The log tells where long cells of a grid cannot carry all of the shear modulus.

    Args:
        material: A name of FABRICS, or a Fabric of one's own.
        area: Area of the cloth [m^2].
        given: Fields that are set.
        cell: Sides of the cells of a grid along warp and weft [m]; None for a mesh.

    Raises:
        ValueError: There is no material of that name.
    """
    fabric = material if isinstance(material, Fabric) else _find(FABRICS, material)
    warp, weft, shear = fabric.warp, fabric.weft, fabric.shear
    mesh = cell is None
    if not mesh:
        longer = cell[0] / cell[1]
        most = _MOST_SHEAR * min(warp / longer**2, weft * longer**2)
        if shear > most:
            name = material if isinstance(material, str) else "this fabric"
            _tell_less_shear(name, 1e3 * cell[0], 1e3 * cell[1], shear, most)
        warp, weft, shear = spring_constants(warp, weft, min(shear, most), cell)
    fields = {
        "mass": fabric.areal_mass * area,
        "stretch_compliance": 1.0 / warp,
        "weft_compliance": 1.0 / weft,
        "shear_compliance": 1.0 / shear,
        "damping": fabric.damping,
        "thickness": 0.5 * fabric.thickness,
        "static_friction": fabric.static_friction,
        "kinetic_friction": fabric.kinetic_friction,
    }
    if mesh:
        fields["poisson"] = fabric.poisson
    if given.get("bending", "dihedral") == "dihedral":
        fields |= {
            "bending": "dihedral",
            "bend_compliance": 1.0 / fabric.bend_warp,
            "weft_bend_compliance": 1.0 / fabric.bend_weft,
            "diagonal_bend_compliance": 1.0 / fabric.bend_diagonal,
        }
    for base, others in _FOLLOWERS.items():
        if base in given and base in fields:
            for name in others:
                fields[name] = _in_proportion(fields[name], given[base], fields[base])
    if mesh and given.get("shear_compliance", 1.0) is None:
        fields |= {"weft_compliance": None, "poisson": 0.0}
    return {**fields, **given}


def _in_proportion(usual: float, given: Any, base: float) -> float | None:
    """A follower's `usual` value times what is `given` over the usual `base`; None, as the base, if that is rigid.

    What is no number is left to the checks of the object.
    """
    return usual * given / base if isinstance(given, Real) and given else None


# Largest shear modulus of a grid over that of which its diagonals alone are as stiff as the fabric along warp or weft.
_MOST_SHEAR = 0.9


@lru_cache
def _tell_less_shear(material: str, along: float, across: float, shear: float, most: float) -> None:
    """Tell once that a grid of such cells [mm] has the shear modulus `most` for `shear` [N/m]."""
    _LOG.warning(
        "a grid of %s with cells of %.3g x %.3g mm has a shear modulus of %.3g N/m for %.3g; a resolution with squarer "
        "cells has all of it",
        *(material, along, across, most, shear),
    )


# Compliance -> those that keep their ratio to it.
_FOLLOWERS = {
    "stretch_compliance": ("weft_compliance",),
    "bend_compliance": ("weft_bend_compliance", "diagonal_bend_compliance"),
}


def cell_of(size: tuple[float, float], resolution: tuple[int, int]) -> tuple[float, float]:
    """The sides [m] of a cell of a grid of this size [m] and number of particles."""
    return size[0] / (resolution[0] - 1), size[1] / (resolution[1] - 1)


def triangles_area(vertices: np.ndarray, triangles: np.ndarray) -> float:
    """The area [m^2] of all `triangles` (T, 3) over `vertices` (N, 3) [m]."""
    return float(areas_of(vertices, triangles).sum())


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
        "bend_damping": cord.bend_damping,
        "static_friction": cord.static_friction,
        "kinetic_friction": cord.kinetic_friction,
    }


def _find(presets: dict[str, Any], name: str) -> Any:
    if not isinstance(name, str) or name not in presets:
        raise ValueError(f"material is {name!r}; allowed is one of {', '.join(presets)}")
    return presets[name]
