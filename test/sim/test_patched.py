"""Grids in patches: margins reach as far as a sweep, and no way of cutting a grid changes what is computed."""

import numpy as np
import pytest

from cloth_sim_ros.sim import Cloth, Plane, Scene, Settings, Simulation, Sphere, Wind
from cloth_sim_ros.sim.cells import passes
from cloth_sim_ros.sim.patching import cut, margin
from cloth_sim_ros.sim.schedules.patched import Patched
from cloth_sim_ros.sim.schedules.patches import plan
from cloth_sim_ros.sim.topology import build

BALL = {"ball": Sphere(radius=0.2, position=(0, 0, -0.22)), "floor": Plane(position=(0, 0, -0.3))}
SHEETS = {
    "sheet": Cloth(resolution=(40, 33), pins="top", bend_compliance=1e-2),
    "strip": Cloth(resolution=(9, 31), size=(0.3, 1.0), pins="corners", position=(0, 1.5, 0), bend_compliance=1e-2),
}


def states(device, schedule, size=None, objects=None, colliders=None, worlds=1, **settings):
    sim = Simulation(
        Scene(objects or SHEETS, colliders or {}), Settings(schedule=schedule, **settings), device=device, worlds=worlds
    )
    for batch in sim._batches:
        if size is not None:
            topologies = [sim._topologies[name] for name in batch.index]
            chosen = plan(batch.features, topologies, worlds, batch.device, size)
            batch.schedule = Patched(batch.features, batch.worlds, chosen, batch.device)
    for frame in range(6):
        if colliders:
            sim.set_collider_pose("ball", (0, 0.02 * frame, -0.2), (0, 0, 0.05 * frame, 1))
        sim.step()
    rows = [np.hstack([sim.positions(n, w), sim.velocities(n, w)]) for n in sim.scene.objects for w in range(worlds)]
    return np.concatenate(rows), sim.report()


@pytest.mark.parametrize(
    "stripped", [{}, {"bend_compliance": None}, {"bend_compliance": None, "shear_compliance": None}]
)
def test_patches_own_every_particle_once_and_have_all_cells_of_their_own(stripped):
    topology = build(Cloth(resolution=(29, 41), **{"bend_compliance": 1.0, **stripped}), "cloth", True)
    sweep = passes(topology)
    found = cut(topology.grid, sweep, 10)
    assert margin(sweep) == {0: 8, 1: 4, 2: 2}[len(stripped)]
    assert sorted(np.concatenate([patch.members[patch.own] for patch in found])) == list(range(29 * 41))
    for patch in found:
        own = set(patch.members[patch.own])
        for whole, part in zip(sweep, patch.passes, strict=True):
            mine = {frozenset(cell) for cell in whole.particles[: whole.whole] if own & set(cell)}
            assert mine <= {frozenset(cell) for cell in patch.members[part.particles[: part.whole]]}


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("substeps", [2, 3, 8])
@pytest.mark.parametrize("size", [8, 13, 64])
def test_no_cut_changes_a_bit(device, size, substeps, order):
    wanted, report = states(device, "coloured", substeps=substeps, order=order)
    found, mine = states(device, "tiled", size, substeps=substeps, order=order)
    assert np.array_equal(found, wanted)
    assert mine == report


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("damping", [0.0, 1e-3])
def test_patches_touch_colliders_like_the_other_schedules(device, damping, order):
    objects = {"sheet": Cloth(resolution=(40, 33), pins="top", bend_compliance=1e-2, damping=damping)}
    wanted, _ = states(device, "coloured", objects=objects, colliders=BALL, order=order)
    found, _ = states(device, "tiled", 16, objects=objects, colliders=BALL, order=order)
    assert np.abs(found - wanted)[:, :3].max() < 5e-6
    assert np.abs(found - wanted)[:, 3:].max() < 2e-3


def test_worlds_in_patches_are_those_alone(device):
    wanted, _ = states(device, "tiled", 13)
    found, _ = states(device, "tiled", 13, worlds=2)
    each = [found[: 2 * 40 * 33], found[2 * 40 * 33 :]]
    for rows, alone in zip(each, np.split(wanted, [40 * 33]), strict=True):
        assert np.array_equal(rows, np.concatenate([alone, alone]))


@pytest.mark.parametrize("settings", [{"iterations": 2}, {"substeps": 1}])
def test_frames_that_patches_do_not_serve_are_still_right(device, settings):
    assert np.array_equal(states(device, "tiled", 13, **settings)[0], states(device, "coloured", **settings)[0])


@pytest.mark.parametrize(
    ("words", "change"),
    [
        ("wind", {"wind": Wind((1, 0, 0))}),
        ("xpbd of other than the springs of a grid", {"bending": "dihedral"}),
    ],
)
def test_what_patches_cannot_serve_is_said(words, change):
    cloth = Cloth(bend_compliance=1.0, **{k: v for k, v in change.items() if k == "bending"})
    scene = Scene({"cloth": cloth}, wind=change.get("wind"))
    with pytest.raises(ValueError, match=f"solver.schedule is 'tiled' with {words}; allowed is"):
        Simulation(scene, Settings(schedule="tiled"), device="cpu")


@pytest.mark.parametrize("settings", [{}, {"order": 2}, {"substeps": 7}])
@pytest.mark.parametrize("value", [np.nan, 1e30])
def test_a_bad_body_is_put_back_alone_and_goes_on(device, settings, value):
    """One bad particle in a corner: patches that it never reaches have to be put back as well."""
    sims = [Simulation(Scene(SHEETS), Settings(schedule="tiled", **settings), device=device) for _ in range(2)]
    for sim in sims:
        sim.step(3)
    good = sims[0].positions("sheet")
    arrays, span, _ = sims[0].device_arrays("sheet")
    rows = arrays.state.velocities[span].numpy()
    rows[3, 1] = value
    arrays.state.velocities[span].assign(rows)
    for sim in sims:
        sim.step()
    assert np.array_equal(sims[0].positions("sheet"), good)
    assert (sims[0].velocities("sheet") == 0).all()
    for sim in sims:
        sim.step(3)
    assert [sims[0].report()[name]["recoveries"] for name in SHEETS] == [1, 0]
    assert np.array_equal(sims[0].positions("strip"), sims[1].positions("strip"))
    assert np.isfinite(sims[0].positions("sheet")).all()
    assert np.abs(sims[0].velocities("sheet")).max() > 0.1
