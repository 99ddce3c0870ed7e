# SPDX-License-Identifier: Apache-2.0
"""Laboratory tests by the product.

They are drape (ISO 9073-9), strips that are pulled or hang over an edge (ASTM D1388), and shear in a picture frame.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import brentq

from cloth_sim_ros.sim import Cloth, Fabric, Handle, Scene, Settings, Simulation
from cloth_sim_ros.study.closed_forms.bending import heavy_elastica
from cloth_sim_ros.study.fabric.meshes import areas, disc, strip

G = 9.81
RADIUS, SUPPORT = 0.15, 0.09  # [m] of Cusick's sample and of what carries it
_PIXELS = 700  # of a shadow, along each side
DRAG, DRAG_OF_STRIPS = 2.0, 8.0  # [1/s] of a sample, in place of the air
_FRAMES = 90  # in which a strip comes to rest
_STRAIN, _WIDTH, _LENGTH = 2e-3, 0.04, 0.2  # of a pulled strip; [m]
_RIBBON = 0.025  # width of a cantilever [m]
_FRAME, _ANGLE = 0.2, 0.01  # side of a picture frame [m], and by how much it leans [rad]


@dataclass(frozen=True)
class Drape:
    """coefficient [%]: share of the ring beyond the support that lies in the shadow. folds: number of waves around the
    rim. points (N, 3) [m], triangles: the sheet. Also the substeps a frame, and the number of simulated frames."""

    coefficient: float
    folds: int
    points: np.ndarray
    triangles: np.ndarray
    substeps: int
    frames: int


def drape(fabric: Fabric, kind: str, spacing: float, turn: float, seconds: float, settings: Settings) -> Drape:
    """Drape a disc of 30 cm over a support of 18 cm, with the warp turned by `turn` [rad] against the mesh."""
    flat, triangles = disc(kind, RADIUS, SUPPORT, spacing)
    points = np.column_stack([flat, np.zeros(len(flat))])
    held = np.linalg.norm(flat, axis=1) <= SUPPORT + 1e-9
    warp = (math.cos(turn), math.sin(turn), 0.0)
    cloth = Cloth.from_mesh(points, triangles, fabric, pins=np.flatnonzero(held).tolist(), warp=warp)
    sim = Simulation(Scene({"sample": cloth}), replace(settings, global_damping=DRAG), device="cpu")
    start = points.copy()
    start[~held, 2] += 1e-4 * np.random.default_rng(round(1e3 * turn)).standard_normal(np.count_nonzero(~held))
    sim.set_positions("sample", start)
    frames = round(seconds / settings.frame_dt)
    for _ in range(frames):
        sim.step()
    x = sim.positions("sample").astype(float)
    carried = math.pi * SUPPORT**2
    coefficient = 100.0 * (shadow(x, triangles) - carried) / (shadow(points, triangles) - carried)
    return Drape(coefficient, _folds(flat, x), x, triangles, sim.choices["sample"].substeps, frames)


def shadow(points: np.ndarray, triangles: np.ndarray) -> float:
    """Return the area [m^2] of the shadow of triangles on the ground, by pixels."""
    edge = 1.1 * RADIUS
    size, lit = 2.0 * edge / _PIXELS, np.zeros((_PIXELS, _PIXELS), dtype=bool)
    centres = (np.arange(_PIXELS) + 0.5) * size - edge
    flat = points[:, :2]
    for corners, double in zip(flat[triangles], 2.0 * areas(flat, triangles), strict=True):
        if abs(double) < 1e-14:
            continue
        low, high = np.searchsorted(centres, corners.min(axis=0)), np.searchsorted(centres, corners.max(axis=0))
        x, y = np.meshgrid(centres[low[0] : high[0]], centres[low[1] : high[1]], indexing="ij")
        inside = np.ones(x.shape, dtype=bool)
        for k in range(3):
            a, b = corners[k], corners[(k + 1) % 3]
            inside &= ((b[0] - a[0]) * (y - a[1]) - (b[1] - a[1]) * (x - a[0])) * double >= 0.0
        lit[low[0] : high[0], low[1] : high[1]] |= inside
    return float(lit.sum()) * size**2


def _folds(flat: np.ndarray, x: np.ndarray) -> int:
    """Return the number of waves around the rim: the strongest in its distance from the axis."""
    rim = np.flatnonzero(np.linalg.norm(flat, axis=1) > RADIUS - 1e-6)
    rim = rim[np.argsort(np.arctan2(flat[rim, 1], flat[rim, 0]))]
    out = np.linalg.norm(x[rim, :2], axis=1)
    return int(np.abs(np.fft.rfft(out - out.mean()))[1:].argmax() + 1)


def pulled(fabric: Fabric, kind: str, spacing: float, degrees: float, settings: Settings) -> float:
    """Return Young's modulus [N/m] of a strip of 4 x 20 cm at an angle to the warp, from a load on its lower edge."""
    flat, triangles = strip(kind, _LENGTH, _WIDTH, spacing)
    below = np.column_stack([flat[:, 1], np.zeros(len(flat)), -flat[:, 0]])
    share = np.bincount(triangles.ravel(), np.repeat(np.abs(areas(flat, triangles)), 3), len(flat)) / 3.0
    low, top = (np.flatnonzero(np.abs(flat[:, 0] - end) < 1e-9) for end in (_LENGTH, 0.0))
    load = np.where((flat[low, 1] < 1e-9) | (flat[low, 1] > _WIDTH - 1e-9), 0.5, 1.0)
    force = _STRAIN * modulus(fabric, degrees) * _WIDTH
    masses = fabric.areal_mass * share
    masses[low] += force / G * load / load.sum()
    angle = math.radians(degrees)
    warp = (-math.sin(angle), 0.0, math.cos(angle))
    cloth = Cloth.from_mesh(
        below, triangles, fabric, particle_masses=masses, pins=top.tolist(), warp=warp, bending="none"
    )
    z = _at_rest(cloth, settings)[:, 2]
    middle = (flat[:, 0] > 0.25 * _LENGTH) & (flat[:, 0] < 0.75 * _LENGTH)
    strain = np.polyfit(below[middle, 2], z[middle], 1)[0] - 1.0
    return (force + 0.5 * fabric.areal_mass * _WIDTH * _LENGTH * G) / (_WIDTH * strain)


def modulus(fabric: Fabric, degrees: float) -> float:
    """Return Young's modulus [N/m] of an orthotropic sheet at an angle to the warp."""
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    mixed = 1.0 / fabric.shear - 2.0 * fabric.poisson / fabric.warp
    return 1.0 / (c**4 / fabric.warp + s**4 / fabric.weft + mixed * (c * s) ** 2)


def overhung(fabric: Fabric, kind: str, degrees: float, spans: int, settings: Settings) -> float:
    """Return the rigidity [N m] of a strip that hangs over an edge, by the heavy elastica.

    degrees: 0, 45 or 90 from the warp. spans: number of spacings along the strip. It is twice as long as its bending
    length, so that it slopes by about 41.5 degrees, as in Peirce's test.
    """
    rigidity = {0.0: fabric.bend_warp, 45.0: fabric.bend_diagonal, 90.0: fabric.bend_weft}[degrees]
    weight = fabric.areal_mass * G
    length = 2.0 * (rigidity / weight) ** (1.0 / 3.0)
    flat, triangles = strip(kind, length * (spans + 1) / spans, min(_RIBBON, length), length / spans)
    points = np.column_stack([flat, np.zeros(len(flat))])
    pins = np.flatnonzero(flat[:, 0] < 1.5 * length / spans)
    angle = math.radians(degrees)
    warp = (math.cos(angle), math.sin(angle), 0.0)
    cloth = Cloth.from_mesh(points, triangles, fabric, pins=pins.tolist(), warp=warp)
    x = _at_rest(cloth, settings)
    tip, edge = np.abs(flat[:, 0] - flat[:, 0].max()) < 1e-9, flat[pins, 0].max()
    theta = math.atan2(-x[tip, 2].mean(), x[tip, 0].mean() - edge)
    return weight * length**3 / brentq(lambda load: math.tan(theta) - _slope(load), 0.5, 50.0, xtol=1e-6)


def sheared(fabric: Fabric, kind: str, spacing: float, settings: Settings) -> float:
    """Return the shear modulus [N/m] of a square in a frame of four hands, whose sides tilt about the lower corners.

    The shear stress is the work of the hands per angle and area. Warp and weft lie along the sides. The lower side
    stays.
    """
    flat, triangles = strip(kind, _FRAME, _FRAME, spacing)
    cloth = Cloth.from_mesh(np.column_stack([flat, np.zeros(len(flat))]), triangles, fabric, pins=None, bending="none")
    thin, long = 0.1 * spacing, 2.0 * _FRAME + spacing
    hinges = {"below": (0.0, 0.0), "above": (0.0, _FRAME), "left": (0.0, 0.0), "right": (_FRAME, 0.0)}
    upright = {"left": (thin, long, thin), "right": (thin, long, thin)}
    hands = {
        name: Handle((*place, 0.0), reach=upright.get(name, (long, thin, thin)), attached=True)
        for name, place in hinges.items()
    }
    scene = Scene({"square": cloth}, handles=hands, gravity=(0.0, 0.0, 0.0))
    sim = Simulation(scene, replace(settings, global_damping=DRAG_OF_STRIPS), device="cpu")
    half = 0.5 * _ANGLE
    for name in ("left", "right"):
        sim.set_handle_pose(name, (*hinges[name], 0.0), (0.0, 0.0, -math.sin(half), math.cos(half)))
    sim.set_handle_pose("above", (_FRAME * math.sin(_ANGLE), _FRAME * math.cos(_ANGLE), 0.0))
    for _ in range(_FRAMES):
        sim.step()
    push, torques = sim.handle_wrench("above")[0], [sim.handle_wrench(name)[1][2] for name in ("left", "right")]
    moment = _FRAME * (push[0] * math.cos(_ANGLE) - push[1] * math.sin(_ANGLE)) - sum(torques)
    return -moment / (_FRAME**2 * _ANGLE)


def _slope(load: float) -> float:
    """Return height over reach of the tip of a strip over an edge; load: weight x length^3 / rigidity [-]."""
    out, down = heavy_elastica(1.0, 1.0, load, 2)[-1]
    return float(down / out)


def _at_rest(cloth: Cloth, settings: Settings) -> np.ndarray:
    """Return the positions (N, 3) [m] of a strip that has come to rest."""
    sim = Simulation(Scene({"strip": cloth}), replace(settings, global_damping=DRAG_OF_STRIPS), device="cpu")
    for _ in range(_FRAMES):
        sim.step()
    return sim.positions("strip").astype(float)
