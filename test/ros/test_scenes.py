# SPDX-License-Identifier: Apache-2.0
"""Every scene of config/ runs, and does what its name says when it is driven as its driver does."""

import dataclasses
import math

import numpy as np
import pytest
from node_process import ROOT

from cloth_sim_ros.demo import (
    bag,
    driver,
    flag,
    garment,
    gripper,
    harness,
    hose,
    knot,
    rope_swing,
    sheet_over_ball,
    tablecloth,
)
from cloth_sim_ros.sim import GripperDriver, Settings, Simulation
from cloth_sim_ros.study.scene_file import read_plan

FRAME = 1.0 / 60.0  # [s]
SCENES = sorted(file.stem for file in ROOT.glob("config/*.yaml"))


def simulation(scene):
    plan = read_plan(ROOT / f"config/{scene}.yaml")
    return Simulation(plan.scene, plan.settings, device="cpu")


def run(sim, until, drive):
    """Simulates up to time `until` [s]; drive(t) comes before each frame, which ends at t."""
    while sim.time < until - 0.5 * FRAME:
        drive(sim.time + FRAME)
        sim.step()


def drive_hands(sim, module, place):
    """What a driver with hands does: place(name, t) is a hand's position."""

    def drive(t):
        for name in getattr(module, "HANDS", ["hand"]):
            sim.set_handle_pose(name, place(name, t))
            if not module.holds(t) and sim.held(name):
                sim.release(name)

    return drive


@pytest.mark.long
@pytest.mark.parametrize("scene", SCENES)
def test_every_scene_is_commented_runs_and_stays_sound(scene):
    text = (ROOT / f"config/{scene}.yaml").read_text()
    assert text.startswith("# ") and "\n/**:\n" in text and (ROOT / f"config/{scene}.rviz").is_file()
    sim = simulation(scene)
    sim.step(30)
    for name, each in sim.report().items():
        assert each["recoveries"] == 0 and each["bending_share"] == 1.0
        assert each["max_penetration"] < 0.01 and np.isfinite(sim.positions(name)).all()
        # The first half second holds the hits and the frames before the substeps have grown.
        assert each["expected_error"] <= 10.0 * sim.settings.error, f"{name} misses solver.error"


def test_scenes_that_move_have_drivers_and_the_others_none():
    moved = {
        "arm",
        "bag",
        "curtain",
        "flag",
        "garment",
        "gripper",
        "harness",
        "hose",
        "knot",
        "rope_swing",
        "sheet_over_ball",
        "tablecloth",
        "towel",
        "winch",
    }
    assert {scene for scene in SCENES if driver.has_driver(scene)} == moved


@pytest.mark.long
def test_the_wind_lifts_the_flag():
    heights = {}
    for name, wind in (("calm", lambda t: (0.0, 0.0, 0.0)), ("gusts", flag.gust)):
        sim = simulation("flag")
        run(sim, 3.0, lambda t, sim=sim, wind=wind: sim.set_wind(wind(t)))
        free_end = sim.positions("flag")[:17].mean(axis=0)  # 1.2 m from the pole
        heights[name] = free_end[2]
        if name == "gusts":
            assert math.hypot(*free_end[:2]) > 0.6, "it streams away from the pole"
    assert heights["calm"] < 0.9 < 1.2 < heights["gusts"]


@pytest.mark.long
def test_the_draw_string_closes_the_bag_around_the_ball():
    sim = simulation("bag")
    run(sim, 0.1, lambda t: None)
    strains = []

    def pull(t):
        for name in bag.HANDS:
            sim.set_handle_pose(name, bag.hand(name, t))
        if t > 0.5:  # the cloth has fallen on the ball
            strains.append(max(each["max_strain"] for each in sim.report().values()))

    run(sim, 4.0, pull)
    assert max(strains) < 0.15, "the hands pull hardly farther than the string is long"
    mouth = sim.positions("bag")[:48:2]  # at the eyelets
    apart = np.linalg.norm(mouth - (0.0, 0.0, 0.5), axis=1)
    assert np.linalg.norm(mouth[:, :2], axis=1).mean() < 0.153, "it is 0.159 m wide where no hand pulls"
    assert apart.min() > 0.119, "the ball is in the bag"
    assert mouth[:, 2].mean() < 0.48, "it lies below the middle of the ball"
    assert not bag.holds(bag.END), "or the next round begins with empty hands"
    assert all(bag.hand(name, bag.END) == sim.scene.handles[name].position for name in bag.HANDS)
    gaps, _, broken = sim.stitches("hem")
    assert np.linalg.norm(gaps, axis=1).max() < 1e-4 and not broken.any()


@pytest.mark.long
def test_the_panels_of_the_shirt_sew_themselves_together():
    sim = simulation("shirt")
    sim.step(60)
    for seam in sim.scene.seams:
        gaps, _, broken = sim.stitches(seam)
        assert np.linalg.norm(gaps, axis=1).max() < 1e-4 and not broken.any(), seam
    assert sim.positions("front")[:, 2].max() > 1.4, "it hangs on the shoulders"
    assert sim.report()["front"]["max_penetration"] < 1e-3


@pytest.mark.long
def test_the_ball_stays_under_its_sheet():
    sim = simulation("sheet_over_ball")
    for until in (2.0, 3.5, 5.0):
        run(sim, until, lambda t: sim.set_collider_pose("ball", sheet_over_ball.ball(t)))
        ball, sheet = np.array(sheet_over_ball.ball(until)), sim.positions("sheet")
        apart = np.linalg.norm(sheet - ball, axis=1)
        assert apart.min() > 0.22 + 0.008 - 0.002, "it is not inside"
        assert sheet[:, 2].max() == pytest.approx(ball[2] + 0.22 + 0.008, abs=0.005), "the sheet lies on top of it"
        assert np.linalg.norm((sheet.mean(axis=0) - ball)[:2]) < 0.12
    assert np.linalg.norm(ball[:2]) > 0.2, "it has gone away from where it was"


@pytest.mark.long
def test_the_tablecloth_leaves_the_table():
    sim = simulation("tablecloth")

    def place(name, t):
        x, z = tablecloth.hand(t)
        return x, tablecloth.HANDS[name], z

    drive = drive_hands(sim, tablecloth, place)
    run(sim, tablecloth.DRAPE, drive)
    top = 0.7 + 0.006  # of the table and of a cloth on it
    middle = sim.positions("tablecloth").reshape(13, 16, 3)[4:9, 4:12]
    assert np.abs(middle[..., 2] - top).max() < 0.002
    run(sim, tablecloth.DRAPE + 0.4 * tablecloth.PULL, drive)
    assert all(sim.handle_wrench(name)[0][0] < -0.05 for name in tablecloth.HANDS), "the hands feel that it rubs"
    run(sim, tablecloth.END - 0.6 * tablecloth.LIE, drive)
    cloth = sim.positions("tablecloth")
    assert cloth[:, 0].min() > 0.45 and cloth[:, 2].max() < 0.2, "it lies on the floor beside, with folds"


@pytest.mark.long
def test_the_harness_rests_on_its_pegs():
    sim = simulation("harness")
    run(sim, harness.END - harness.AGAIN, drive_hands(sim, harness, lambda name, t: harness.hand(t)))
    cable = sim.positions("cable")
    for peg, side in (("first", 1), ("second", -1), ("third", 1)):
        x, y, _ = sim.get(f"{peg}.position")
        apart = np.linalg.norm(cable[:, :2] - (x, y), axis=1)
        assert 0.05 + 0.008 - 1e-3 < apart.min() < 0.05 + 0.008 + 2e-3, "it touches the peg and does not enter it"
        assert side * (np.interp(x, cable[:, 0], cable[:, 1]) - y) > 0.05, "it goes round the peg's own side"
    assert np.abs(cable[:, 2] - 0.008).max() < 4e-3, "it lies on the board"


def test_the_hose_carries_its_torque():
    """GJ twist / length, between the inner ends of its clamps, below the torque at which it would buckle:
    8.99 EI / length (Greenhill 1883, ends clamped), to which its tension adds."""
    sim, length = simulation("hose"), 1.2 * 46 / 48
    run(sim, 4.0, lambda t: sim.set("hose.end_turn", 2.0 * math.pi * min(t, 1.0)))
    torque = 2.0 * math.pi / (120.0 * length)
    assert torque < 8.99 / (80.0 * length)
    assert sim.report()["hose"]["torsion"] == pytest.approx(torque, rel=0.01)
    straight = np.abs(sim.positions("hose")[:, 1]).max()
    run(sim, 4.0 + 0.5 * hose.PERIOD, lambda t: sim.set("hose.end_turn", max(hose.turn(t - 4.0), 2.0 * math.pi)))
    assert np.abs(sim.positions("hose")[:, 1]).max() > 0.02 > 3.0 * straight, "then it winds itself up"


@pytest.mark.long
def test_the_gripper_carries_the_napkin_and_drops_it():
    plan = read_plan(ROOT / "config/gripper.yaml")
    sim, hand = Simulation(plan.scene, plan.settings, device="cpu"), GripperDriver("hand", plan.grippers["hand"])

    def drive(t):
        hand.move(gripper.place(t))
        hand.press(gripper.force(t))
        hand.advance(sim)
        if t > gripper.CLOSE - 0.2 and sim.held("peg"):
            sim.release("peg")

    forces, weights = [], []  # which tremble from frame to frame, so means are judged

    def watch(t):
        drive(t)
        if t > gripper.CLOSE + gripper.CARRY:
            forces.append(hand.measure(sim))
            weights.append(sum(sim.wrench(f"hand_{side}")[0][2] for side in ("left", "right")))

    run(sim, gripper.CLOSE + gripper.CARRY + gripper.HOLD, watch)
    napkin = sim.positions("napkin")
    assert napkin[:, 0].mean() == pytest.approx(gripper.ASIDE, abs=0.03) and napkin[:, 2].max() > 0.65
    assert np.mean(forces) == pytest.approx(gripper.FIRM, rel=0.1)
    assert np.mean(weights) == pytest.approx(-9.81 * sim.masses("napkin").sum(), rel=0.05)
    run(sim, gripper.END, drive)
    assert sim.positions("napkin")[:, 2].max() < 0.3, "it lies on the floor"


@pytest.mark.long
def test_the_load_swings_as_a_pendulum():
    """Load and rope as one stiff pendulum, at its amplitude: the period by the arithmetic-geometric mean (Gauss)."""
    sim, gravity, length, load, rope, amplitude = simulation("rope_swing"), 9.81, 2.0, 3.0, 0.15, math.radians(30.0)
    drive = drive_hands(sim, rope_swing, lambda name, t: rope_swing.HAND)
    run(sim, rope_swing.WAIT - FRAME, drive)
    assert np.abs(sim.positions("rope")[-1] - rope_swing.HAND).max() < 1e-6 and sim.held("hand") == 1
    places = []

    def watch(t):
        places.append(sim.positions("rope")[-1])
        drive(t)

    run(sim, rope_swing.WAIT + rope_swing.SWING, watch)
    assert sim.held("hand") == 0
    x = np.array(places)[:, 0]
    (crossed,) = np.nonzero((x[:-1] < 0.0) & (x[1:] >= 0.0))
    times = FRAME * (crossed + x[crossed] / (x[crossed] - x[crossed + 1]))
    a, b = 1.0, math.cos(0.5 * amplitude)
    for _ in range(10):
        a, b = 0.5 * (a + b), math.sqrt(a * b)
    inertia, moment = (load + rope / 3.0) * length**2, (load + 0.5 * rope) * length
    assert len(times) >= 6 and np.diff(times) == pytest.approx(
        2.0 * math.pi * math.sqrt(inertia / (gravity * moment)) / a, rel=1e-3
    )
    assert np.abs(x[-200:]).max() == pytest.approx(1.0, rel=1e-3), "it swings as far as at first"


@pytest.mark.long
def test_the_knot_is_pulled_tight():
    """The tightest open trefoil takes 10.1 diameters of rope (Pieranski, Przybyl and Stasiak 2001)."""
    plan = read_plan(ROOT / "config/knot.yaml")
    bare = {"rope": dataclasses.replace(plan.scene.objects["rope"], self_contact=False)}
    through = dataclasses.replace(plan.scene, objects=bare)
    diameter, felt = 0.016, []
    for scene in (plan.scene, through):
        sim = Simulation(scene, plan.settings, device="cpu")
        assert [sim.held(hand) for hand in knot.HANDS] == [1, 1]
        run(sim, knot.WAIT + knot.PULL + 0.5 * knot.STAY, drive_hands(sim, knot, knot.hand))
        rope = sim.positions("rope").astype(float)
        spare = np.linalg.norm(np.diff(rope, axis=0), axis=1).sum() - np.linalg.norm(rope[-1] - rope[0])
        assert 10.1 < spare / diameter < 11.5
        felt.append([sim.handle_wrench(hand)[0] for hand in knot.HANDS])
    left, right = felt[0]
    assert np.linalg.norm(left) > 0.5 and np.linalg.norm(left + right) < 0.1 * np.linalg.norm(left)
    assert np.abs(felt[1]).max() < 0.05, "where the rope comes through itself, there is no knot"


@pytest.mark.long
def test_the_skirt_flares_when_it_turns():
    sim = simulation("garment")

    def drive(t):
        sim.set_handle_pose("waist", garment.WAIST, garment.turned(t))
        sim.set_collider_pose("hips", garment.HIPS, garment.turned(t))

    hem = []
    start = sim.positions("skirt")
    waist, bottom = start[:, 2] > 0.999, start[:, 2] < 0.501
    assert sim.held("waist") == waist.sum() == bottom.sum() == 34
    for until in (0.25 * garment.PERIOD, 0.55 * garment.PERIOD):  # fastest, and turning back slowly
        run(sim, until, drive)
        skirt = sim.positions("skirt")
        hem.append(np.linalg.norm(skirt[bottom, :2], axis=1).mean())
        assert np.linalg.norm(skirt - garment.HIPS, axis=1).min() > 0.16, "the hips stay inside"
        _, _, s, c = garment.turned(until)
        x, y = start[waist, 0], start[waist, 1]
        cosine, sine = c * c - s * s, 2.0 * s * c
        turned = np.stack([cosine * x - sine * y, sine * x + cosine * y], axis=1)
        assert np.abs(skirt[waist, :2] - turned).max() < 1e-4
    assert hem[0] > 0.36 > 1.2 * hem[1]


@pytest.mark.long
def test_the_pile_lies_on_its_stone():
    """The stone and the floor bear the weight of all, also of what touches neither, at the substeps that it takes."""
    plan = read_plan(ROOT / "config/pile.yaml")
    settings = dataclasses.replace(plan.settings, substeps=Settings().substeps, error=0.02)
    sim = Simulation(plan.scene, settings, device="cpu")
    sim.step(150)
    weight = sum(sim.masses(name).sum() for name in sim.scene.objects) * 9.81
    borne = []
    for _ in range(30):
        sim.step()
        borne.append(sum(sim.wrench(collider)[0][2] for collider in ("floor", "stone")))
        assert all(each["crossings"] == 0 for each in sim.report().values())
    assert -np.mean(borne) == pytest.approx(weight, rel=0.02)
    tops = [sim.positions(name)[:, 2].max() for name in ("first", "second", "third")]
    assert 0.14 < tops[0] < tops[1] < tops[2] < 0.2
    assert min(sim.positions("cord")[:, 2]) > 0.004
