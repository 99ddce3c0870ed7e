# SPDX-License-Identifier: Apache-2.0
"""The material of a sheet that another model computed, and what that predicts of motions that were not recorded."""

import numpy as np
import pytest
from fem_sheet import FemSheet, plate

from cloth_sim_ros.identify.candidates import Candidates
from cloth_sim_ros.identify.fit import identify
from cloth_sim_ros.identify.recording import Recording
from cloth_sim_ros.sim import Cloth, Scene, Settings, Simulation

SIDE, SIZE, FRAMES = 11, 0.6, 60
SETTINGS = Settings(method="xpbd", order=2, substeps=20, iterations=1)
GUESS = {"stretch_compliance": 2e-2, "shear_compliance": 6e-2, "bend_compliance": 300.0, "damping": 3e-3}


def scene(pins, gravity, **material):
    cloth = Cloth(resolution=(SIDE, SIDE), size=(SIZE, SIZE), mass=0.3, pins=pins, bending="dihedral", **material)
    return Scene({"cloth": cloth}, gravity=gravity)


def by_the_other(pins, gravity):
    """Positions (FRAMES, N, 3) of the same scene, by elements of half the spacing."""
    rest = Simulation(scene(pins, gravity, **GUESS), SETTINGS, "cpu").rest_positions("cloth").reshape(SIDE, SIDE, 3)
    fine = np.linspace(0, 1, 2 * SIDE - 1)
    origin, right, up = rest[0, 0], rest[0, -1] - rest[0, 0], rest[-1, 0] - rest[0, 0]
    vertices = origin + fine[None, :, None] * right + fine[:, None, None] * up
    assert np.allclose(vertices[::2, ::2], rest)
    fixed = np.zeros(vertices.shape[:2], dtype=bool)
    fixed[-1, slice(None) if pins == "top" else [0, -1]] = True
    sheet = FemSheet(vertices, 0.3, modulus=60.0, poisson=0.3, rigidity=8e-3, damping=2e-3, fixed=fixed)
    return sheet.run(np.array(gravity), FRAMES)[:, ::2, ::2].reshape(FRAMES, -1, 3)


def off(pins, gravity, material, seen):
    """RMS distance of the product from what was seen, over the size."""
    sim, total = Simulation(scene(pins, gravity, **material), SETTINGS, "cpu"), 0.0
    for places in seen:
        sim.step()
        total += ((sim.positions("cloth") - places) ** 2).sum(axis=1).mean()
    return np.sqrt(total / len(seen)) / SIZE


def test_the_other_model_bends_as_a_plate():
    x, y = (u.ravel() for u in np.meshgrid(np.linspace(-1, 1, 41), np.linspace(-1, 1, 41)))
    stiffness = plate(41, 0.05, 0.3)
    for shape, wanted in ((x * x / 2, 1.0), (x * y, 2 * (1 - 0.3)), ((x * x + y * y) / 2, 2 * (1 + 0.3))):
        assert shape @ stiffness @ shape == pytest.approx(4.0 * wanted, rel=0.05)  # open ends lack half a row


@pytest.mark.long
def test_what_was_found_predicts_other_motions():
    """A sheet falls about its upper edge. What is found predicts it with less weight, and hung by two corners."""
    down = (0.0, 0.0, -9.81)
    seen = by_the_other("top", down)
    recording = Recording(np.arange(1, FRAMES + 1) / 60.0, positions={"cloth": seen})
    fit = [f"cloth.{name}={value / 30}:{value * 30}" for name, value in GUESS.items()]
    found = identify(Candidates(scene("top", down, **GUESS), SETTINGS, recording, fit, 16, "cpu"))[1]
    material = dict(zip(GUESS, map(float, found.values), strict=True))
    assert off("top", down, material, seen) < 0.01
    for pins, gravity, limit in (("top", (0.0, 0.0, -4.0), 0.01), ("corners", down, 0.02)):
        seen = by_the_other(pins, gravity)
        assert off(pins, gravity, material, seen) < limit
        assert off(pins, gravity, GUESS, seen) > 2.0 * limit
