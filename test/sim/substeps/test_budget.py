# SPDX-License-Identifier: Apache-2.0
"""The budget bounds the substeps; contact of triangles and frames that are computed again count too."""

import numpy as np
import pytest

from cloth_sim_ros.sim import Box, Cloth, Scene, Settings, Simulation

SIDE = 16
FRAMES = 30


def sheet(**more):
    """A mesh of cotton of 0.3 m, 6 mm above a small box's top."""
    x, y = (grid.ravel() for grid in np.meshgrid(*[np.linspace(-0.15, 0.15, SIDE)] * 2))
    index = np.arange(SIDE * SIDE).reshape(SIDE, SIDE)
    a, b, c, d = (corner.ravel() for corner in (index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]))
    return Cloth.from_mesh(np.c_[x, y, 0 * x], np.r_[np.c_[a, b, c], np.c_[a, c, d]], "cotton", bending="none", **more)


def on_a_box(**settings):
    scene = Scene(
        objects={"it": sheet(position=(0.0, 0.0, 0.106), pins=None)},
        colliders={"box": Box(half_extents=(0.05, 0.05, 0.05), position=(0.0, 0.0, 0.05))},
    )
    return Simulation(scene, Settings(**settings), device="cpu")


def substeps_taken(sim, frames=FRAMES):
    """Substeps of each frame."""
    taken = []
    for _ in range(frames):
        taken.append(sim.choices["it"].substeps)
        sim.step()
    return taken


def test_contact_takes_its_share_of_the_budget():
    """An error out of reach takes all that the budget pays: less where triangles lie on the box."""
    sim = on_a_box(error=1e-5, budget=0.1)
    taken, choice = substeps_taken(sim), sim.choices["it"]
    assert taken[0] == choice.most
    assert taken[-1] < 0.75 * choice.most
    assert min(taken) >= choice.fewest
    assert choice.error > 1e-5 and "the budget allows no more substeps" in choice.reason


def test_a_budget_that_pays_for_contact_too_keeps_the_substeps():
    """The same contact costs no substeps where a thousand times as much may be spent."""
    sim = on_a_box(budget=100.0)
    assert min(substeps_taken(sim)) >= sim.choices["it"].least


@pytest.mark.parametrize("substeps", [8, 40])
def test_substeps_that_are_set_are_kept(substeps):
    assert set(substeps_taken(on_a_box(substeps=substeps, budget=1e-3))) == {substeps}


def test_after_frames_that_are_computed_again_more_substeps_are_taken():
    """Else nearly every frame of this sheet, in order 1, is computed twice: 17 of 18 that were counted."""
    scene = Scene(objects={"it": sheet(pins=[0, SIDE - 1])})
    sim = Simulation(scene, Settings(order=1, error=1e-5, budget=0.1), device="cpu")
    taken = substeps_taken(sim)
    assert max(taken) > sim.choices["it"].most, "no frame was computed again, so this shows nothing"
    assert sim.report()["it"]["redone"] <= FRAMES // 4


def test_substeps_fall_back_when_frames_are_no_longer_computed_again():
    scene = Scene(objects={"it": sheet(pins=[0, SIDE - 1])})
    sim = Simulation(scene, Settings(order=1, error=1e-5, budget=0.1), device="cpu")
    taken = substeps_taken(sim)
    sim.set("solver.global_damping", 5.0)
    assert substeps_taken(sim, 90)[-1] < max(taken)
