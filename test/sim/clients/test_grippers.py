# SPDX-License-Identifier: Apache-2.0
"""Parallel grippers: they press as hard as they are told, lift what their friction holds, and drop what it does not."""

import numpy as np
import pytest
from fixed_settings import fixed

from cloth_sim_ros.sim import Box, Cloth, Gripper, GripperDriver, Scene, Simulation

GRAVITY, MASS, MU = 9.81, 0.05, 0.8
NEEDED = MASS * GRAVITY / (2.0 * MU)  # [N] of each of two fingers, by Coulomb's law
UPRIGHT = (np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5))
WAYS = [
    {"substeps": 5},
    {"substeps": 20},
    pytest.param({"substeps": 80, "order": 1}, marks=pytest.mark.long),
    pytest.param({"method": "verlet", "substeps": 120}, marks=pytest.mark.long),
]


def hand(device, settings, compliance=0.02, **fields):
    """A swatch of 50 g that stands between the open fingers of a gripper, without weight as yet."""
    swatch = Cloth(
        resolution=(4, 4),
        size=(0.03, 0.03),
        mass=MASS,
        thickness=0.002,
        pins=None,
        orientation=UPRIGHT,
        stretch_compliance=1e-3,
        bending="dihedral",
        bend_compliance=1e3,
        static_friction=MU,
        kinetic_friction=MU,
    )
    gripper = Gripper(finger_size=(0.1, 0.02, 0.1), opening=0.03, compliance=compliance, **fields)
    scene = Scene({"it": swatch}, gripper.fingers("hand"), gravity=(0, 0, 0))
    return Simulation(scene, fixed(**settings), device), GripperDriver("hand", gripper)


def run(sim, driver, frames, then=lambda frame: None):
    for frame in range(frames):
        then(frame)
        driver.advance(sim)
        sim.step()


@pytest.mark.parametrize("settings", WAYS)
def test_it_lifts_at_its_force_and_drops_at_half_of_it(device, settings):
    sim, driver = hand(device, settings)
    wanted = 1.4 * NEEDED
    driver.press(wanted)
    run(sim, driver, 90)
    assert driver.measure(sim) == pytest.approx(wanted, rel=0.02)
    sim.set("gravity", (0, 0, -GRAVITY))
    run(sim, driver, 30)
    lift = lambda frame: driver.move((0, 0, 0.1 * (0.5 - 0.5 * np.cos(np.pi * (frame + 1) / 90))))  # noqa: E731
    run(sim, driver, 90, lift)
    run(sim, driver, 30)
    assert sim.positions("it")[:, 2].mean() == pytest.approx(0.1, abs=3e-3)
    held = sum(sim.wrench(f"hand_{side}")[0][2] for side in ("left", "right"))
    assert held == pytest.approx(-MASS * GRAVITY, rel=0.03)
    assert driver.measure(sim) == pytest.approx(wanted, rel=0.05)
    driver.press(0.5 * wanted)
    run(sim, driver, 60)
    assert sim.positions("it")[:, 2].max() < 0.0


@pytest.mark.parametrize("compliance", [1e-3, 0.02])
def test_it_presses_as_hard_as_it_is_told_whatever_gives_way(device, compliance):
    sim, driver = hand(device, {"substeps": 20}, compliance)
    for force in (0.3, 1.0, 0.1):
        driver.press(force)
        run(sim, driver, 60)
        assert driver.measure(sim) == pytest.approx(force, rel=0.02)
    assert np.abs(sim.positions("it")).max() < 0.03


def test_it_opens_to_where_it_is_told_at_its_speed(device):
    sim, driver = hand(device, {"substeps": 5}, speed=0.06)
    driver.open_to(0.08)
    run(sim, driver, 10)
    assert driver.opening == pytest.approx(0.03 + 10 * 0.06 / 60) and driver.speed == pytest.approx(0.06)
    run(sim, driver, 60)
    assert driver.opening == 0.08 and driver.speed == 0.0
    driver.move((1, 2, 3), (0, 0, np.sqrt(0.5), np.sqrt(0.5)))  # its y axis lies along -x now
    run(sim, driver, 2)
    left, right = (np.array(sim.get(f"hand_{side}.position")) for side in ("left", "right"))
    assert left == pytest.approx((1 - 0.05, 2, 3), abs=1e-6) and right == pytest.approx((1 + 0.05, 2, 3), abs=1e-6)


def test_what_a_gripper_cannot_be_is_told():
    for fields, why in (
        ({"opening": 0.2}, "Gripper.opening is 0.2; allowed is at most max_opening, 0.08 m"),
        ({"compliance": 0.0}, "Gripper.compliance is 0.0; allowed is a finite number from 1e-09"),
        ({"finger_size": (0.1, 0.1)}, "Gripper.finger_size is"),
        ({"force": -1.0}, "Gripper.force is -1.0; allowed is"),
    ):
        with pytest.raises(ValueError, match=why):
            Gripper(**fields)
    driver = GripperDriver("hand", Gripper())
    with pytest.raises(ValueError, match="hand.opening is 1; allowed is at most max_opening, 0.08 m"):
        driver.open_to(1.0)
    with pytest.raises(ValueError, match="hand.position is None; allowed is 3 finite numbers"):
        driver.move(None)
    with pytest.raises(ValueError, match="hand.force is nan"):
        driver.press(float("nan"))


def hanging(device, material, count, force, compliance=0.01, **settings):
    """A cloth of 0.3 m that hangs by its upper row, of which the open fingers of a gripper have a part between them."""
    cloth = Cloth.of(
        material,
        resolution=(count, count),
        size=(0.3, 0.3),
        position=(0.003, 0.0, -0.138),
        orientation=UPRIGHT,
        pins="top",
        static_friction=MU,
        kinetic_friction=MU,
    )
    gripper = Gripper(opening=0.01, force=force, compliance=compliance)
    sim = Simulation(Scene({"it": cloth}, gripper.fingers("hand")), fixed(**settings), device)
    return sim, GripperDriver("hand", gripper), cloth.mass * GRAVITY


@pytest.mark.parametrize("force", [0.5, 5.0, 20.0])
@pytest.mark.parametrize(
    "material, count, compliance",
    [
        ("cotton", 13, 0.01),
        ("cotton", 13, 1e-6),
        ("silk", 10, 0.01),
        pytest.param("denim", 40, 1e-4, marks=pytest.mark.long),
    ],
)
def test_it_presses_as_hard_on_thin_cloth(device, material, count, compliance, force):
    sim, driver, _ = hanging(device, material, count, force, compliance, substeps=20)
    run(sim, driver, 30)
    assert driver.measure(sim) == pytest.approx(force, rel=0.05) and driver.shortfall == ""
    left, right = (sim.wrench(f"hand_{side}")[0] for side in ("left", "right"))
    assert left[1] == pytest.approx(force, rel=0.05) and right[1] == pytest.approx(-force, rel=0.05)


@pytest.mark.parametrize("substeps, compliance", [(5, 0.01), (20, 0.01), (80, 0.01), (80, 1e-4)])
def test_a_pinch_holds_a_hanging_cloth_by_coulombs_law(device, substeps, compliance):
    sim, driver, weight = hanging(device, "cotton", 13, 1.0, compliance, substeps=substeps)
    needed = weight / (2.0 * MU)
    run(sim, driver, 20)
    driver.press(5.0 * needed)
    sim.set("it.pins", "none")
    sim.set("solver.global_damping", 3.0)
    run(sim, driver, 120)
    felt = sum(sim.wrench(f"hand_{side}")[0][2] for side in ("left", "right"))
    assert felt == pytest.approx(-weight, rel=0.1)
    for share in (3.0, 2.0, 1.5, 1.3):
        driver.press(share * needed)
        run(sim, driver, 15)
    before = sim.positions("it")[:, 2].mean()
    driver.press(1.1 * needed)
    run(sim, driver, 30)
    assert sim.positions("it")[:, 2].mean() > before - 2e-3
    driver.press(0.5 * needed)
    run(sim, driver, 60)
    assert sim.positions("it")[:, 2].mean() < before - 0.05


def test_it_says_why_it_cannot_press(device, caplog):
    sim, driver, _ = hanging(device, "cotton", 10, 5.0, substeps=5)
    driver.move((0.0, 0.0, 0.2))
    run(sim, driver, 60)
    said = "hand is closed and presses with 0 of 5 N: too little is between its fingers"
    assert driver.shortfall == said and caplog.messages.count(said) == 1
    driver.press(0.0)
    run(sim, driver, 1)
    assert driver.shortfall == ""


def test_what_cannot_be_squeezed_is_told(device):
    sim, _ = hand(device, {"substeps": 5})
    with pytest.raises(ValueError, match="'it' pinches nothing; allowed is one of hand_left, hand_right"):
        sim.squeeze("it", 1.0, 0.0)
    with pytest.raises(ValueError, match="the load of hand_left is -1"):
        sim.squeeze("hand_left", -1.0, 0.0)


def test_it_may_be_as_far_away_as_anything_may(device):
    sim, driver = hand(device, WAYS[0], position=(0.0, 1e4, 0.0))
    driver.move((0.0, -1e4, 0.0))
    driver.advance(sim)
    sim.step()
    assert (sim.get("hand_left.position")[1], sim.get("hand_right.position")[1]) == (-1e4 + 0.025, -1e4)


@pytest.mark.parametrize(
    ("material", "settings", "force"),
    [
        ("cotton", {}, 1.0),
        pytest.param("cotton", {"order": 1}, 1.0, marks=pytest.mark.long),
        pytest.param("towel", {"order": 1}, 2.0, marks=pytest.mark.long),  # with 1 N its stiff hem holds them apart
    ],
)
def test_it_closes_on_an_edge_that_hangs_over_a_table_and_lifts_it(device, material, settings, force):
    cloth = Cloth.of(material, resolution=(13, 13), size=(0.2, 0.2), position=(0.13, 0, 0.004), pins="none")
    ahead = (0.5, 0.5, 0.5, 0.5)  # the fingers point along x and open along z
    gripper = Gripper((0.045, 0, -0.015), ahead, (0.1, 0.012, 0.03), max_opening=0.05, opening=0.05)
    table = {"table": Box(half_extents=(0.2, 0.2, 0.1), position=(0.27, 0, -0.1))}
    scene = Scene({"it": cloth}, {**table, **gripper.fingers("hand")})
    sim, driver = Simulation(scene, fixed(**settings), device), GripperDriver("hand", gripper)
    run(sim, driver, 60)
    driver.press(force)
    for _ in range(90):
        run(sim, driver, 1)
        assert driver.opening <= 2.0 * cloth.thickness or not driver.squeezes, "one finger alone squeezes nothing"
    assert driver.opening <= 2.0 * cloth.thickness and driver.measure(sim) == pytest.approx(force, rel=0.05)
    before = sim.positions("it")
    held = (np.abs(before - (0.045, 0, -0.015)) < (0.01, 0.045, 0.003)).all(axis=1)
    assert held.any()
    run(sim, driver, 60, lambda frame: driver.move((0.045, 0, -0.015 + 0.1 * (frame + 1) / 60), ahead))
    assert (sim.positions("it") - before)[held].mean(axis=0) == pytest.approx([0, 0, 0.1], abs=0.002)
