# SPDX-License-Identifier: Apache-2.0
"""What colliders feel: the weight of what lies on them, and the change of momentum of what they push."""

import re

import numpy as np
import pytest

from cloth_sim_ros.sim import Box, Capsule, Cloth, Plane, Rope, Scene, Settings, Simulation, Sphere

WEIGHT = 0.2 * 9.81
WAYS = [
    (None, {}),
    (None, {"method": "xpbd", "substeps": 20, "order": 2}),
    (None, {"substeps": 5, "order": 1, "iterations": 3}),
    ("block", {"method": "verlet", "substeps": 80}),
    ("graph", {"method": "xpbd", "substeps": 20, "order": 2}),
]


def sheet(**more):
    return Cloth(resolution=(16, 16), pins="none", **{"position": (0, 0, 0.006), **more})


@pytest.mark.long
@pytest.mark.parametrize(("executor", "settings"), WAYS)
def test_the_weight_of_a_cloth_is_read_from_what_it_lies_on(device, executor, settings):
    scene = Scene({"cloth": sheet()}, {"floor": Plane(), "ball": Sphere(radius=0.6, position=(0, 0, 5))})
    sim = Simulation(scene, Settings(global_damping=2.0, **settings), device, executor=executor)
    sim.step(60)
    force, torque = sim.wrench("floor")
    assert force[2] == pytest.approx(-WEIGHT, rel=0.005) and np.abs(force[:2]).max() < 0.005 * WEIGHT
    assert np.abs(torque).max() < 0.005 * WEIGHT
    assert not sim.wrench("ball")[0].any()


def test_the_torque_is_about_the_origin_of_the_collider(device):
    scene = Scene({"cloth": sheet(position=(0.3, 0, 0.006))}, {"floor": Plane()})
    sim = Simulation(scene, Settings(global_damping=2.0), device)
    sim.step(60)
    np.testing.assert_allclose(sim.wrench("floor")[1], (0, 0.3 * WEIGHT, 0), atol=0.005 * WEIGHT)


BALLS = [(*WAYS[0], 0.6), *((*way, 0.05) for way in WAYS)]  # the small one comes between particles


@pytest.mark.long
@pytest.mark.parametrize(("executor", "settings", "radius"), BALLS)
def test_what_a_moving_collider_gives_is_the_momentum_that_the_cloth_gains(device, executor, settings, radius):
    scene = Scene(
        {"cloth": sheet()}, {"ball": Sphere(radius=radius, position=(0.1, 0, -0.1 - radius))}, gravity=(0, 0, 0)
    )
    sim = Simulation(scene, Settings(**settings), device, executor=executor)
    given = np.zeros(3)
    for frame in range(60):
        sim.set_collider_pose("ball", (0.1 + 0.002 * frame, 0, -0.1 - radius + 0.008 * frame))
        sim.step()
        given -= sim.wrench("ball")[0] / 60
    momentum = sim.masses("cloth") @ sim.velocities("cloth").astype(float)
    assert momentum[2] > 0.02
    # Order 2 carries half a substep of momentum on, which other substeps change.
    allowed = 1e-3 if settings else 1e-2
    assert np.linalg.norm(momentum - given) < allowed * np.linalg.norm(given)


@pytest.mark.long
def test_a_rope_over_a_pole_weighs_on_it(device):
    rope = Rope(segments=40, start=(-0.5, 0, 0.06), end=(0.5, 0, 0.06), pins="none", radius=0.01, mass=0.3)
    pole = Capsule(radius=0.05, half_length=0.3, orientation=(np.sqrt(0.5), 0, 0, np.sqrt(0.5)), static_friction=1.0)
    sim = Simulation(Scene({"rope": rope}, {"pole": pole}), Settings(global_damping=3.0), device)
    sim.step(350)
    felt = []
    for _ in range(50):  # a rope that leans on something trembles by some parts in a thousand
        sim.step()
        felt.append(sim.wrench("pole")[0][2])
    assert np.mean(felt) == pytest.approx(-0.3 * 9.81, rel=0.002)


@pytest.mark.long
def test_two_colliders_share_a_weight_in_every_world(device):
    boxes = {
        name: Box(half_extents=(0.2, 0.6, 0.1), position=(x, 0, -0.1)) for name, x in (("left", -0.3), ("right", 0.3))
    }
    sim = Simulation(
        Scene({"cloth": sheet(bending="dihedral", bend_compliance=0.1)}, boxes),
        Settings(global_damping=4),
        device,
        worlds=2,
    )
    sim.set("gravity", (0, 0, -5.0), 1)
    sim.step(200)
    for world, g in ((0, 9.81), (1, 5.0)):
        left, right = (sim.wrench(name, world)[0][2] for name in boxes)
        assert left + right == pytest.approx(-0.2 * g, rel=0.005) and left == pytest.approx(right, rel=0.05)


@pytest.mark.parametrize("name", ["wall", None, ["floor"]])
def test_an_unknown_name_is_told(name):
    sim, wrong = Simulation(Scene({"cloth": sheet()}, {"floor": Plane()}), device="cpu"), re.escape(repr(name))
    for ask in (sim.wrench, sim.is_squeezing):
        with pytest.raises(ValueError, match=f"there is no collider {wrong}; allowed is floor"):
            ask(name)
    for ask, kind in (
        (sim.positions, "object"),
        (sim.springs, "object"),
        (sim.attach, "handle"),
        (sim.stitches, "seam"),
    ):
        with pytest.raises(ValueError, match=f"there is no {kind} {wrong}; allowed is "):
            ask(name)
    with pytest.raises(ValueError, match=f"there is no live parameter {wrong} in this scene"):
        sim.get(name)
    with pytest.raises(ValueError, match=f"{wrong} is no collider that was added"):
        sim.remove_collider(name)
