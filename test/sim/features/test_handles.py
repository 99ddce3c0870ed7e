# SPDX-License-Identifier: Apache-2.0
"""Handles: what they grasp goes with them, they feel its load, and what they let go flies on."""

import numpy as np
import pytest
from fixed_settings import fixed
from scipy.optimize import brentq

from cloth_sim_ros.sim import Cloth, Handle, Rope, Scene, Settings, Simulation, Sphere, Wind
from cloth_sim_ros.sim.physics.quaternion import rotate

WEIGHT = 0.2 * 9.81
WAYS = [
    (None, {}),
    (None, {"method": "xpbd", "substeps": 5}),
    *(
        pytest.param(executor, settings, marks=pytest.mark.long)
        for executor, settings in (
            (None, {"method": "xpbd", "substeps": 20, "order": 1, "iterations": 2}),
            (None, {"method": "verlet", "substeps": 100}),
            ("graph", {"method": "xpbd", "substeps": 20}),
        )
    ),
]


def towel(**handles):
    cloth = Cloth(resolution=(12, 12), pins="none", damping=0.002, bend_compliance=0.1)
    return Scene({"towel": cloth}, handles=handles)


def corners(attached=True, **more):
    return {
        "left": Handle(position=(-0.5, -0.5, 0), reach=0.02, attached=attached, **more),
        "right": Handle(position=(0.5, -0.5, 0), reach=0.02, attached=attached, **more),
    }


def momentum(sim, name="towel"):
    return sim.masses(name) @ sim.velocities(name).astype(float)


@pytest.mark.parametrize(("executor", "settings"), WAYS)
def test_two_hands_lift_a_towel_and_feel_its_weight(device, executor, settings):
    sim = Simulation(towel(**corners()), Settings(global_damping=2.0, **settings), device, executor=executor)
    assert (sim.held("left"), sim.held("right")) == (1, 1)
    held = [np.linalg.norm(sim.positions("towel") - hand.position, axis=1).argmin() for hand in corners().values()]
    off = 0.0
    for frame in range(1, 301):
        t = frame / 60
        middle = np.array([0.2 * np.sin(2 * t) * (t < 3.14), -0.5, 0.5 * min(t, 1.0)])
        for name, side in (("left", -0.5), ("right", 0.5)):
            sim.set_handle_pose(name, middle + (side, 0, 0))
        sim.step()
        off = max(off, np.abs(sim.positions("towel")[held] - [middle - (0.5, 0, 0), middle + (0.5, 0, 0)]).max())
    assert off < 1e-4
    forces = [np.zeros(3), np.zeros(3)]
    for _ in range(60):  # the towel still swings a little
        sim.step()
        forces = [
            total + sim.handle_wrench(name)[0] / 60 for total, name in zip(forces, sim.scene.handles, strict=True)
        ]
    assert sum(forces)[2] == pytest.approx(-WEIGHT, rel=0.01)
    assert forces[0][2] == pytest.approx(forces[1][2], rel=0.02) and forces[0][0] > 0.1 > -0.1 > forces[1][0]


@pytest.mark.parametrize(("executor", "settings"), WAYS)
def test_what_is_let_go_keeps_its_momentum(device, executor, settings):
    sim = Simulation(towel(**corners()), Settings(**settings), device, executor=executor)
    for frame in range(1, 31):
        for name, side in (("left", -0.5), ("right", 0.5)):
            sim.set_handle_pose(name, (side + 0.03 * frame, -0.5, 0))
        sim.step()
    before = momentum(sim)
    assert before[0] > 0.1
    sim.release("left")
    sim.release("right")
    assert sim.held("left") == sim.held("right") == 0
    sim.step(6)
    # Order 2 forgets a force that ends over its next two substeps: what it pulls in that time may be missing.
    substep = 1 / 60 / sim.report()["towel"]["substeps"]
    off = np.linalg.norm(momentum(sim) - before + (0, 0, WEIGHT * 0.1))
    assert off < max(1e-3 * np.linalg.norm(before), 1.5 * WEIGHT * substep)
    assert np.abs(sim.handle_wrench("left")).max() == 0.0


def test_a_patch_turns_with_its_hand_and_the_torque_is_its_load(device):
    hand = Handle(position=(-0.5, 0, 0), reach=(0.3, 2.0, 0.1), attached=True)
    cloth = Cloth(resolution=(9, 5), size=(1, 0.5), pins="none", bending="dihedral", bend_compliance=1.0)
    scene = Scene({"flag": cloth}, handles={"hand": hand}, gravity=(0, 0, -1.0))
    sim = Simulation(scene, Settings(global_damping=3.0), device)
    start = sim.positions("flag").astype(float)
    held = start[:, 0] < -0.36
    assert sim.held("hand") == held.sum() == 10
    for frame in range(1, 121):
        half = 0.5 * min(frame / 60, 1.0)
        turn = (0, 0, np.sin(half), np.cos(half))
        sim.set_handle_pose("hand", (-0.5, 0, 0.1), turn)
        sim.step()
    wanted = rotate(turn, start[held] - (-0.5, 0, 0)) + (-0.5, 0, 0.1)
    np.testing.assert_allclose(sim.positions("flag")[held], wanted, atol=1e-4)
    sim.step(200)
    mean = np.zeros((2, 3))
    rates = []
    for _ in range(120):
        sim.step()
        mean += np.array(sim.handle_wrench("hand")) / 120
        x, m = sim.positions("flag").astype(float), sim.masses("flag")
        rates.append(np.cross(x - (-0.5, 0, 0.1), m[:, None] * np.array([0, 0, -1.0])).sum(0))
    assert mean[0][2] == pytest.approx(-0.2, rel=0.03)
    np.testing.assert_allclose(mean[1][:2], np.mean(rates, axis=0)[:2], rtol=0.03, atol=1e-3)


@pytest.mark.parametrize("compliance", [0.0, 0.01, 0.2])
@pytest.mark.long
def test_a_soft_hold_gives_way_by_its_compliance(device, compliance):
    hand = Handle(position=(0, 0, 1), reach=0.02, compliance=compliance, attached=True)
    rope = Rope(segments=8, start=(0, 0, 1), end=(0, 0, 0), pins="none", stretch_compliance=1e-4)
    for settings in ({"substeps": 5}, {"substeps": 40, "order": 1}, {"method": "verlet"}):
        sim = Simulation(Scene({"rope": rope}, handles={"hand": hand}), Settings(global_damping=3, **settings), device)
        sim.step(300)
        assert 1 - sim.positions("rope")[0, 2] == pytest.approx(compliance * WEIGHT, rel=0.01, abs=2e-5)
        assert sim.handle_wrench("hand")[0][2] == pytest.approx(-WEIGHT, rel=0.01)


@pytest.mark.parametrize("substeps", [6, 11, 20, 60])
def test_a_rigid_hold_does_not_give_way_under_load(device, substeps):
    """A hand stretches a rope to 650 N. It stood 0.5 mm off at 11 substeps, as its force was limited there."""
    rope = Rope(start=(0, 0, 1), end=(0.5, 0, 1), segments=34, pins=[0], mass=0.02, stretch_compliance=1 / 1.5e4)
    hand = Handle(position=(0.5, 0, 1), reach=0.006, attached=True)
    scene = Scene({"rope": rope}, handles={"hand": hand})
    sim = Simulation(scene, Settings(substeps=substeps), device=device)
    stretch = 0.5 * 650.0 / 1.5e4
    for frame in range(1, 61):
        sim.set_handle_pose("hand", (0.5 + stretch * frame / 60, 0, 1), (0, 0, 0, 1))
        sim.step()
    sim.step(30)
    assert sim.positions("rope")[-1, 0] == pytest.approx(0.5 + stretch, abs=3e-5)
    assert sim.handle_wrench("hand")[0][0] == pytest.approx(-650.0, rel=2e-3)


def test_a_very_soft_hold_far_away_pulls_with_a_constant_force(device):
    """F t^2 / 2 m of a rope in free space, though in a substep the pull moves it by 1e-10 of the way to its hand."""
    force, far = 0.02, 1e3
    hand = Handle(position=(0, 0, 0), reach=0.02, compliance=far / force)
    rope = Rope(segments=4, start=(0, 0, 0), end=(-0.4, 0, 0), pins="none", mass=0.1, stretch_compliance=1e-6)
    scene = Scene({"rope": rope}, handles={"hand": hand}, gravity=(0, 0, 0))
    sim = Simulation(scene, Settings(sleep=False), device)
    assert sim.attach("hand") == 1
    sim.set_handle_pose("hand", (far, 0, 0), sweep=False)
    sim.step(30)
    assert sim.positions("rope")[:, 0].mean() + 0.2 == pytest.approx(0.5 * force / 0.1 * 0.5**2, rel=0.02)


def test_a_hand_of_limited_strength_lets_go_there_and_not_before(device):
    rope = Rope(segments=8, start=(0, 0, 1), end=(0, 0, 0), pins="none")
    for share, holds in ((0.98, False), (1.02, True)):
        hand = Handle(position=(0, 0, 1), reach=0.02)
        sim = Simulation(Scene({"rope": rope}, handles={"hand": hand}), Settings(global_damping=5), device)
        assert sim.attach("hand") == 1
        sim.step(240)
        sim.set("hand.break_force", share * WEIGHT)
        sim.step(10)
        assert (sim.held("hand") == 1) == holds and sim.broken("hand") == (0 if holds else 1)


def test_a_rope_carried_at_a_constant_pace_has_the_tension_of_a_catenary(device):
    length, span, weight = 1.0, 0.8, 0.5 * 9.81
    rope = Rope(segments=64, start=(-0.4, 0, 0), end=(0.6, 0, 0), mass=0.5, pins="none", stretch_compliance=1e-6)
    hands = {
        "left": Handle(position=(-0.4, 0, 0), reach=0.003, attached=True),
        "right": Handle(position=(0.6, 0, 0), reach=0.003, attached=True),
    }
    sim = Simulation(Scene({"rope": rope}, handles=hands), Settings(global_damping=8), device)
    for frame in range(1, 121):
        sim.set_handle_pose("right", (0.6 - 0.2 * min(frame / 60, 1), 0, 0))
        sim.step()
    sim.step(600)
    sim.set("solver.global_damping", 0.0)
    sim.set_velocities("rope", np.tile([0.0, 0.5, 0.0], (65, 1)))
    forces = np.zeros((2, 3))
    for frame in range(1, 121):
        for name, x in (("left", -0.4), ("right", 0.4)):
            sim.set_handle_pose(name, (x, 0.5 * frame / 60, 0))
        sim.step()
        forces += [sim.handle_wrench(name)[0] / 120 for name in hands]
    c = brentq(lambda c: 2 * c * np.sinh(span / 2 / c) - length, 0.05, 10)
    pull = weight / length * c
    np.testing.assert_allclose(forces, [[pull, 0, -weight / 2], [-pull, 0, -weight / 2]], rtol=0.01, atol=0.01 * pull)


def test_a_thousand_grasps_lose_and_move_nothing(device):
    sim = Simulation(towel(**corners()), fixed(), device)
    sim.step(30)
    place = {name: np.array(hand.position) for name, hand in sim.scene.handles.items()}
    for _ in range(1000):
        for name in place:
            sim.release(name)
            assert sim.held(name) == 0 and sim.attach(name) == 1
        sim.step()
    x = sim.positions("towel")
    assert all(np.linalg.norm(x - where, axis=1).min() < 1e-4 for where in place.values())
    assert sim.report()["towel"]["recoveries"] == 0


def test_one_hand_ties_a_rope_to_a_cloth_and_another_takes_only_its_own(device):
    cloth = Cloth(resolution=(5, 5), pins="none")
    rope = Rope(segments=4, start=(-0.5, -0.5, 0), end=(-0.5, -0.5, -1), pins="none")
    hands = {"both": Handle(position=(-0.5, -0.5, 0), reach=0.01), "one": Handle(reach=9.0, object="rope")}
    sim = Simulation(Scene({"cloth": cloth, "rope": rope}, handles=hands), device=device)
    assert sim.attach("both") == 2 and sim.attach("one") == 4, "what another hand holds stays there"
    sim.release("one")
    sim.step(240)
    np.testing.assert_allclose(sim.positions("rope")[0], (-0.5, -0.5, 0), atol=1e-4)


@pytest.mark.long
def test_what_is_held_goes_with_the_hand_through_a_collider(device):
    cloth = Cloth(resolution=(12, 12), pins="none", damping=0.002, bending="dihedral", bend_compliance=1e3)
    ball = Sphere(radius=0.1, position=(-0.5, -0.5, 0.3))
    scene = Scene({"towel": cloth}, {"ball": ball}, Wind(), handles=corners(), spare_colliders=1)
    sim = Simulation(scene, device=device)
    for frame in range(1, 41):
        sim.set_handle_pose("left", (-0.5, -0.5, 0.0075 * frame))
        sim.step()
    assert np.linalg.norm(sim.positions("towel") - (-0.5, -0.5, 0.3), axis=1).min() < 1e-4


@pytest.mark.long
def test_hands_that_wring_a_sheet_on_itself_never_fling_it(device):
    """Its parts keep what is held from following: the force that was not given has to be forgotten."""
    sheet = Cloth(resolution=(8, 8), size=(0.4, 0.4), damping=1e-3, pins="none", thickness=0.003, self_contact=True)
    ends = {"left": -0.2, "right": 0.2}
    hands = {name: Handle(position=(x, 0, 0), reach=(0.01, 0.5, 0.01), attached=True) for name, x in ends.items()}
    sim = Simulation(Scene({"sheet": sheet}, handles=hands), Settings(global_damping=1.0), device)
    given = 0.5 * sheet.mass * (0.2 * 2.5 * np.pi) ** 2
    for frame in range(121):
        for name, x in ends.items():
            half = np.sign(x) * 2.5 * np.pi * frame / 120
            sim.set_handle_pose(name, (x, 0, 0), (np.sin(half), 0, 0, np.cos(half)))
        sim.step()
        assert sim.report()["sheet"]["kinetic_energy"] < 2.0 * given, f"in frame {frame}"


def test_worlds_have_their_own_hands(device):
    sim = Simulation(towel(**corners(attached=False)), fixed(), device, worlds=3)
    np.testing.assert_array_equal(sim.attach("left"), [1, 1, 1])
    assert sim.attach("right", world=1) == 1
    np.testing.assert_array_equal(sim.held("right"), [0, 1, 0])
    sim.set_handle_pose("left", (-0.5, -0.5, 0.2), world=2)
    sim.step()
    alone = Simulation(towel(**corners(attached=False)), fixed(), device)
    alone.attach("left")
    alone.set_handle_pose("left", (-0.5, -0.5, 0.2))
    alone.step()
    np.testing.assert_array_equal(sim.positions("towel", 2), alone.positions("towel"))
    sim.reset(1)
    np.testing.assert_array_equal(sim.held("right"), [0, 0, 0])


def test_a_reset_puts_hands_back_to_what_the_scene_says(device):
    sim = Simulation(towel(**corners()), fixed(), device)
    sim.set_handle_pose("left", (0, 0, 0.5))
    sim.step(5)
    sim.release("right")
    sim.reset()
    assert sim.held("left") == sim.held("right") == 1
    sim.step(60)
    assert np.linalg.norm(sim.positions("towel") - (-0.5, -0.5, 0), axis=1).min() < 1e-4


@pytest.mark.parametrize(
    ("act", "words"),
    [
        (lambda sim: sim.attach("hand"), "there is no handle 'hand'; allowed is left, right"),
        (lambda sim: sim.set("left.reach", (1, 2)), "left.reach has 2 numbers; allowed is 1, a radius, or 3"),
        (lambda sim: sim.set("left.compliance", -1), "left.compliance is -1; allowed is a finite number from 0"),
        (lambda sim: sim.set("left.object", "sock"), "left.object is 'sock'; allowed is '' or one of towel"),
        (lambda sim: sim.set("left.position", (0, 0, 0)), "left.position is not set while running; allowed is"),
        (lambda sim: sim.set("left.grip", 1), "there is no parameter 'left.grip'; allowed is one of reach"),
        (lambda sim: Handle(object="sock") and Scene(handles={"x": Handle(object="sock")}), "grasps 'sock'"),
    ],
)
def test_what_cannot_be_is_told(act, words):
    sim = Simulation(towel(**corners()), fixed(), "cpu")
    with pytest.raises(ValueError, match=words.replace("(", "\\(")):
        act(sim)
