# SPDX-License-Identifier: Apache-2.0
"""Colliders out of reach change no bit of anything, and none within reach is missed, however fast something gets."""

import numpy as np
import pytest
from fixed_settings import fixed

from cloth_sim_ros.sim import Capsule, Cloth, Plane, Rope, Scene, Simulation, Sphere
from cloth_sim_ros.sim.engine import bodies, saved

WAYS = [
    (None, {"iterations": 3}),
    (None, {"method": "verlet", "substeps": 160}),
    pytest.param("graph", {"order": 2, "iterations": 2}, marks=pytest.mark.long),
]
COUNT = 100


def simulated(executor, settings, device, colliders, objects=None, worlds=1):
    objects = objects or {
        "sheet": Cloth(resolution=(10, 10), pins="none", position=(0, 0, 0.35), damping=1e-3),
        "rope": Rope(start=(-0.4, 0.9, 0.3), end=(0.4, 0.9, 0.3), segments=16, pins="none"),
    }
    return Simulation(Scene(objects, colliders), fixed(**settings), device, worlds=worlds, executor=executor)


def near_ones():
    return {"ball": Sphere(0.2, position=(0.05, 0, 0)), "rod": Capsule(0.05, 0.6, position=(0, 0.9, 0))}


@pytest.fixture
def always(monkeypatch):
    """The list is in the kernels of all scenes, also of those with few colliders."""
    monkeypatch.setattr(bodies, "FEW", 0)


@pytest.mark.long
@pytest.mark.parametrize(("executor", "settings"), WAYS)
def test_colliders_out_of_reach_change_no_bit(device, executor, settings, always):
    """Also where they come last or first, one moves, one passes by and touches, and the sheet is thrown at them."""
    rng = np.random.default_rng(2)
    far = {f"far{k}": Capsule(0.05, 0.3, position=rng.uniform(4, 20, 3)) for k in range(COUNT)}
    few = simulated(executor, settings, device, near_ones())
    many = simulated(executor, settings, device, {**far, **near_ones()})
    for frame in range(24):
        for sim in (few, many):
            sim.set_collider_pose("ball", (0.05, 0.01 * frame, 0.004 * frame))
            if frame == 12:  # it comes from far away within a frame
                sim.set_collider_pose("rod", (0, 0.9, -40), sweep=False)
                sim.set_collider_pose("rod", (0, 0.5, 0.1), (0, 0.6, 0, 0.8))
            if frame == 16:
                sim.set_velocities("sheet", np.full((100, 3), (0.0, 0.0, 30.0)))
        many.set_collider_pose("far7", (8.0, 0.0, 0.1 * frame))
        few.step()
        many.step()
        for name in few.scene.objects:
            assert np.array_equal(few.positions(name), many.positions(name)), frame
        for name in near_ones():
            assert np.array_equal(few.wrench(name), many.wrench(name)), frame
        assert not np.any(many.wrench("far7"))


@pytest.mark.long
@pytest.mark.parametrize(("executor", "settings"), WAYS)
def test_what_is_hit_away_meets_the_wall_behind_in_the_same_frame(device, executor, settings, always):
    """A free particle at rest is hit at 90 m/s, so that it leaves all that could be foreseen of it."""
    settings = {**settings, "substeps": max(settings.get("substeps", 0), 40)}
    sheet = Cloth(resolution=(2, 2), size=(0.02, 0.02), pins="none", stretch_compliance=1.0, shear_compliance=None)
    bat, wall = Sphere(0.1, position=(0, 0, -0.2)), Sphere(1.0, position=(0, 0, 2.0))
    sim = simulated(executor, settings, device, {"bat": bat, "wall": wall}, {"sheet": sheet})
    sim.set_collider_pose("bat", (0, 0, 1.3))
    sim.step()
    x = sim.positions("sheet")
    away = np.linalg.norm(x - (0, 0, 2.0), axis=1)
    assert away.min() > 1.0, "nothing is in the wall"
    assert np.linalg.norm(x, axis=1).max() > 0.5, "it was hit"


@pytest.mark.long
def test_what_touched_is_forgotten_when_it_is_out_of_reach(device, always):
    floor = {"floor": Plane(), "ball": Sphere(0.2, position=(0, 0, 5))}
    sim = simulated(None, {}, device, floor, {"sheet": Cloth(resolution=(6, 6), pins="none", position=(0, 0, 0.005))})
    sim.set_collider_pose("ball", (0, 0, 0.05), sweep=False)
    sim.step(2)
    assert sim.wrench("ball")[0].any()
    sim.set_collider_pose("ball", (0, 0, 5), sweep=False)
    sim.step()
    assert not sim.wrench("ball")[0].any() and not sim.wrench("ball")[1].any()


@pytest.mark.long
def test_a_collider_that_is_added_is_met(device):
    sheet = Cloth(resolution=(8, 8), pins="none", position=(0, 0, 0.3))
    sim = Simulation(Scene({"sheet": sheet}, near_ones(), spare_colliders=70), fixed(), device)
    for k in range(70):
        sim.add_collider(f"added{k}", Sphere(0.3, position=(0, 0, -0.05 if k == 69 else 50 + k)))
    sim.step(40)
    assert np.linalg.norm(sim.positions("sheet") - (0, 0, -0.05), axis=1).min() > 0.3
    assert sim.wrench("added69")[0].any() and not sim.wrench("added3")[0].any()


@pytest.mark.long
def test_frames_that_are_computed_again_begin_as_if_all_were_copied(monkeypatch):
    """Trials meet what comes from afar, and what the copy of their start has of it is where nobody was near yet."""
    far = {f"far{k}": Capsule(0.05, 0.3, position=(9, k, 0)) for k in range(20)}
    scene = Scene({"sheet": Cloth(resolution=(9, 9), pins="corners", position=(0, 0, 0.3))}, {**far, **near_ones()})
    part = Simulation(scene, device="cpu")
    monkeypatch.setattr(saved, "_MANY", 0.0)
    whole = Simulation(scene, device="cpu")
    touched = set()
    for frame in range(48):
        for sim, many in ((part, 0.25), (whole, 0.0)):
            monkeypatch.setattr(saved, "_MANY", many)
            sim.set_collider_pose("ball", (0.05, 0.0, 0.2 * np.sin(0.4 * frame)))
            sim.set_collider_pose("far3", (0.3, 0.2, 0.25) if 20 < frame < 40 else (9, 3, 0.1 * frame), sweep=False)
            sim.step()
        assert np.array_equal(part.positions("sheet"), whole.positions("sheet")), frame
        assert part.report()["sheet"] == whole.report()["sheet"], frame
        touched |= {name for name in ("ball", "far3") if part.wrench(name)[0].any()}
    assert touched == {"ball", "far3"}
