# SPDX-License-Identifier: Apache-2.0
"""The budget bounds the substeps, with what contact of triangles costs while it lasts."""

import numpy as np
import pytest
import trimesh
import warp as wp

from cloth_sim_ros.sim import Box, Cloth, Mesh, Rope, Scene, Settings, Simulation
from cloth_sim_ros.sim.kernels.compiled import compiled
from cloth_sim_ros.sim.substeps.arrays import StepLimits
from cloth_sim_ros.sim.substeps.control import afforded, fixed_share

SIDE = 16
FRAMES = 30


def sheet(fabric="jersey", **more):
    """A mesh of 0.3 m, 6 mm above a small box's top."""
    x, y = (grid.ravel() for grid in np.meshgrid(*[np.linspace(-0.15, 0.15, SIDE)] * 2))
    index = np.arange(SIDE * SIDE).reshape(SIDE, SIDE)
    a, b, c, d = (corner.ravel() for corner in (index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]))
    return Cloth.from_mesh(np.c_[x, y, 0 * x], np.r_[np.c_[a, b, c], np.c_[a, c, d]], fabric, bending="none", **more)


BOX = Box(half_extents=(0.05, 0.05, 0.05), position=(0.0, 0.0, 0.05))


def on_a_box(box=BOX, **settings):
    scene = Scene(objects={"it": sheet(position=(0.0, 0.0, 0.106), pins=None, damping=0.0)}, colliders={"box": box})
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
    left = f"contact leaves it {choice.substeps} of at least {choice.least} substeps, so it is softer"
    assert choice.substeps < choice.least and left in choice.reason
    assert choice.error > 1e-5 and "the budget allows no more substeps" in choice.reason


@pytest.mark.long
def test_contact_with_a_mesh_takes_a_larger_share():
    """Each distance of a box that is a mesh takes a search in a list of triangles."""
    box = trimesh.creation.box(extents=(0.1, 0.1, 0.1)).subdivide().subdivide()
    mesh = Mesh(vertices=box.vertices, triangles=box.faces, position=BOX.position)
    sims = [on_a_box(each, error=1e-5, budget=0.3) for each in (mesh, BOX)]
    in_a_mesh, in_a_box = (np.mean(substeps_taken(sim)[-10:]) for sim in sims)
    assert in_a_mesh < 0.6 * in_a_box


def test_contact_of_a_rope_takes_its_share_of_the_budget():
    """Over the edge of a box each substep takes several Newton steps: they cost about four times a substep beside it.

    Out of reach a box costs three times a rope alone, as points between its particles are watched.
    """
    substeps = {}
    for place, boxes in {
        "alone": {},
        "far": {"box": Box(half_extents=(0.1, 0.1, 0.1), position=(0.0, 0.0, -9.0))},
        "across": {"box": Box(half_extents=(0.1, 0.1, 0.1), position=(0.0, 0.0, 0.88))},
    }.items():
        rope = Rope(start=(-0.8, 0.0, 1.0), end=(0.8, 0.0, 1.0), segments=64, mass=0.1, radius=0.01)
        sim = Simulation(Scene({"it": rope}, boxes), Settings(error=1e-6, budget=0.05), device="cpu")
        substeps[place] = np.mean(substeps_taken(sim, 2 * FRAMES)[FRAMES:])
    assert 2.0 < substeps["alone"] / substeps["far"] < 5.0
    assert 2.0 < substeps["far"] / substeps["across"] < 8.0


def test_objects_share_the_budget():
    """What each may take of the time that it had alone adds up to all of it, and what is cheap gets more substeps."""
    things = {"cloth": sheet(), "one": Rope(start=(0, 0, 1)), "two": Rope(start=(0, 1, 1))}

    def most(*names, **more):
        scene = Scene({name: things[name] for name in names}, **more)
        found = Simulation(scene, Settings(budget=0.05), device="cpu").choices
        return np.array([found[name].most for name in names])

    alone, together = np.concatenate([most(name) for name in things]), most(*things)
    assert 0.95 < (together / alone).sum() <= 1.0
    assert together[0] < together[1] == together[2]
    coupled = most("one", "two", object_contact=True)
    assert coupled[0] == coupled[1]
    cloths = {"a": sheet(), "b": sheet(position=(1, 0, 0))}
    pair = Simulation(Scene(cloths), Settings(budget=0.05), device="cpu").choices
    assert pair["a"].most == pair["b"].most == pytest.approx(alone[0] / 2, abs=1)


def test_a_budget_that_pays_for_contact_too_keeps_the_substeps():
    """The same contact costs no substeps where a thousand times as much may be spent."""
    sim = on_a_box(budget=100.0)
    assert min(substeps_taken(sim)) >= sim.choices["it"].least


def test_a_membrane_keeps_the_substeps_below_which_its_frames_gain_energy():
    """With the six substeps that the budget pays, two frames of three are computed again."""
    fabric = Scene({"it": sheet(pins=[0, SIDE - 1])})
    sim = Simulation(fabric, Settings(budget=1e-3), device="cpu")
    sim.step(40)
    assert "the budget pays 6, with which its frames would gain energy" in sim.choices["it"].reason
    assert sim.report()["it"]["redone"] <= 2


@pytest.mark.parametrize("substeps", [8, 40])
def test_substeps_that_are_set_are_kept(substeps):
    assert set(substeps_taken(on_a_box(substeps=substeps, budget=1e-3))) == {substeps}


def test_what_the_budget_does_not_pay_is_told_after_a_load_and_not_after_more_is_allowed(tmp_path):
    sim, loaded = on_a_box(error=1e-5, budget=0.1), on_a_box(error=1e-5, budget=0.1)
    sim.step(20)
    assert "the budget allows no more substeps" in sim.choices["it"].reason
    sim.save(tmp_path / "it.npz")
    loaded.load(tmp_path / "it.npz")
    assert loaded.choices["it"] == sim.choices["it"]
    sim.set("solver.budget", 100.0)
    assert "the budget allows no more substeps" not in sim.choices["it"].reason
    sim.step()
    choice = sim.choices["it"]
    assert "the budget allows no more substeps" not in choice.reason
    assert choice.error > 1e-5 and "instead of 1e-05 in the last half second" in choice.reason


def test_a_sheet_without_contact_is_as_stiff_as_it_is_set_at_once():
    """No measurement has to come first, as no contact takes a share of the budget."""
    sim = Simulation(Scene(objects={"it": sheet(pins=[0, SIDE - 1])}), Settings(error=1e-2, budget=100.0), device="cpu")
    sim.step(20)
    before = sim.choices["it"]
    sim.set("it.stretch_compliance", 0.01 * sim.get("it.stretch_compliance"))
    assert sim.choices["it"].least > before.substeps, "so few are needed that this shows nothing"
    for _ in range(2):
        assert sim.choices["it"].substeps >= sim.choices["it"].least
        sim.step()


def test_what_sleeps_in_contact_does_not_wake_with_more_than_the_budget_pays():
    sim = on_a_box(error=1e-5, budget=0.1)
    sim.step(20)
    before = sim.choices["it"]
    assert before.substeps < before.least
    sim.device_arrays("it", writes=False)[0].state.control.asleep.fill_(1)
    assert max(substeps_taken(sim, 15)) <= before.substeps


def hung(**settings):
    """A sheet in order 1, of which nearly every frame is computed again in as many substeps as its budget pays."""
    scene = Scene(objects={"it": sheet("cotton", pins=[0, SIDE - 1])})
    return Simulation(scene, Settings(order=1, error=1e-5, budget=0.1, **settings), device="cpu")


def test_where_all_frames_are_computed_again_more_substeps_are_taken():
    """Else nearly every frame of this sheet is computed twice or more."""
    sim = hung()
    taken, most = substeps_taken(sim), sim.choices["it"].most
    assert most < max(taken) <= 4 * most
    assert sim.report()["it"]["redone"] <= FRAMES // 2


def test_substeps_that_are_set_are_kept_where_all_frames_are_computed_again():
    sim = hung(substeps=20)
    assert set(substeps_taken(sim)) == {20}
    assert sim.report()["it"]["redone"] > FRAMES // 2, "too few were, so this shows nothing"


def test_substeps_fall_back_when_frames_are_no_longer_computed_again():
    sim = hung()
    taken = substeps_taken(sim)
    sim.set("solver.global_damping", 5.0)
    assert substeps_taken(sim, 90)[-1] < max(taken)


@compiled
def afford_each(tests: wp.array(dtype=wp.vec2i), n: int, limits: StepLimits, found: wp.array(dtype=int)):
    whole, half = tests[wp.tid()][0], tests[wp.tid()][1]
    fixed = fixed_share(n, whole, half)
    found[wp.tid()] = afforded(n, wp.vec4i(6, 6 * n, 6 * whole, 0), fixed, limits)


def test_substeps_fall_only_where_that_saves_time(device):
    """A frame of n substeps takes n + 0.01 (fixed + each n), of the 60 that the budget has; see the cases."""
    limits, n = StepLimits(), 40
    limits.least, limits.most, limits.fewest, limits.test = 6, 60, 20, 0.01
    cases = {
        (0, 0): 60,  # no contact
        (0, 100): 30,  # each substep takes twice as long: n + n = 60
        (2000, 0): 40,  # 20 + n = 60
        (3000, 100): 28,  # 30 + 2 n = 60 would be 15, but 28 take a quarter more than 20: (1.25 (30 + 2 x 20) - 30) / 2
        (0, 1000): 26,  # 1.25 x 20 would do, but they fall by LEAST_GROWTH at once
        (8000, 0): 45,  # no number pays: 1.25 (80 + 20) - 80
        (8000, 100): 35,  # (1.25 (80 + 2 x 20) - 80) / 2
    }
    tests = [(fixed + each * n, fixed + each * n // 2) for fixed, each in cases]
    given, found = wp.array(tests, dtype=wp.vec2i, device=device), wp.zeros(len(cases), dtype=int, device=device)
    wp.launch(afford_each, len(cases), inputs=[given, n, limits, found], device=device)
    assert found.numpy() == pytest.approx(list(cases.values()), abs=1)
