# SPDX-License-Identifier: Apache-2.0
"""Parallel grippers: they press as hard as they are told, lift what their friction holds, and drop what it does not."""

import numpy as np
import pytest
from fixed_settings import fixed

from cloth_sim_ros.sim import Cloth, Gripper, GripperDriver, Scene, Simulation

GRAVITY, MASS, MU = 9.81, 0.05, 0.8
NEEDED = MASS * GRAVITY / (2.0 * MU)  # [N] of each of two fingers, by Coulomb's law
UPRIGHT = (np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5))
WAYS = [
    {"substeps": 5},
    {"substeps": 20, "order": 2},
    {"substeps": 80, "order": 1},
    {"method": "verlet", "substeps": 120},
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
    with pytest.raises(ValueError, match="hand.force is nan"):
        driver.press(float("nan"))
