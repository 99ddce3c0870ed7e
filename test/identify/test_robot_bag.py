# SPDX-License-Identifier: Apache-2.0
"""A material found in the bag of a robot: a depth camera and a hand, each in a frame of its own, and clocks apart."""

import sys

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation, Slerp

pytest.importorskip("rosbags")

from robot_messages import cloud, pose, transforms, write

from cloth_sim_ros.identify import __main__ as program
from cloth_sim_ros.identify.recording import Recording
from cloth_sim_ros.identify.robot import robot_recording
from cloth_sim_ros.identify.transforms import Transforms
from cloth_sim_ros.record.topics import Topics
from cloth_sim_ros.sim import Simulation
from cloth_sim_ros.study.scene_file import read_plan

SCENE = """
/**:
  ros__parameters:
    frame_id: map
    objects: [cloth]
    cloth: {type: cloth, resolution: [10, 10], size: [0.6, 0.6], mass: 0.3, bending: dihedral,
            stretch_compliance: 0.02, shear_compliance: 0.06, bend_compliance: 100.0, damping: 0.003}
    handles: [hand]
    hand: {position: [0.0, 0.3, 0.0], reach: [0.7, 0.02, 0.02], attached: true}
    wind: {enabled: true, velocity: [0.5, 0.2, 0.0]}
    solver: {method: xpbd, order: 2, substeps: 13, iterations: 1}
"""
TRUTH = {"cloth.stretch_compliance": 0.031, "cloth.shear_compliance": 0.04, "wind.drag_coefficient": 0.9}
DELAY = 0.03  # [s] of the camera
START = 1_700_000_000.0  # [s], when the scene starts
FRAMES = 44
CAMERA = Rotation.from_euler("xyz", [2.0, 0.3, -0.7]), np.array([0.4, -1.2, 0.8])  # in the frame "base"
BASE = Rotation.from_euler("xyz", [0.1, -0.2, 1.1]), np.array([2.0, 1.0, 0.5])  # in the frame "map"


def hand(time):
    """Where the hand is: it swings and turns."""
    x, z = 0.08 * (1.0 - np.cos(9.0 * time)), 0.05 * np.sin(7.0 * time) ** 2
    return np.array([x, 0.3, z]), Rotation.from_rotvec([0.3 * np.sin(4.0 * time) ** 2, 0.0, 0.0])


@pytest.fixture(scope="module")
def topics(tmp_path_factory):
    """What a robot records of SCENE with the values of TRUTH: a third of it is hidden, and there are 2 mm of noise."""
    path = tmp_path_factory.mktemp("truth") / "scene.yaml"
    path.write_text(SCENE)
    plan, random = read_plan(path), np.random.default_rng(5)
    sim = Simulation(plan.scene, plan.settings, "cpu")
    for name, value in TRUTH.items():
        sim.set(name, value)
    triangles, clouds = sim.triangles("cloth")[: 2 * len(sim.triangles("cloth")) // 3], []
    camera_turn, camera_place = BASE[0] * CAMERA[0], BASE[1] + BASE[0].apply(CAMERA[1])
    for frame in range(1, FRAMES + 1):
        time = frame * plan.settings.frame_dt
        place, turn = hand(time)
        sim.set_handle_pose("hand", place, turn.as_quat())
        sim.step()
        if frame % 2:
            continue  # a camera of 30 Hz
        corners = sim.positions("cloth")[random.choice(triangles, 250)]
        seen = np.einsum("nk,nkd->nd", random.dirichlet(np.ones(3), 250), corners)
        seen = camera_turn.inv().apply(seen + 0.002 * random.standard_normal(seen.shape) - camera_place)
        clouds.append(cloud(START + time + DELAY, "camera", seen))
    # the hand is told in a base that drives, of which the bag has where it is now and then
    stamps = START + np.arange(-0.1, 1.2, 0.01)
    drive = {stamp: BASE[1] + [0.5 * (stamp - START), 0.0, 0.0] for stamp in stamps}
    turns = Slerp([stamps[0], stamps[-1]], Rotation.concatenate([BASE[0], BASE[0] * Rotation.from_rotvec([0, 0, 1])]))
    poses = []
    for stamp in START + np.arange(0.0, 1.1, 1 / 150):
        place, turn = hand(stamp - START)
        base, at = turns(stamp), BASE[1] + [0.5 * (stamp - START), 0.0, 0.0]
        poses.append(pose(stamp, "rover", base.inv().apply(place - at), base.inv() * turn))
    return {
        "/tf_static": [transforms(0, "map", "base", *BASE), transforms(0, "base", "camera", *CAMERA)],
        "/tf": [transforms(stamp, "map", "rover", turns(stamp), place) for stamp, place in drive.items()],
        "/camera/points": clouds,
        "/hand": poses,
    }


SEEN = ["--points", "cloth=/camera/points", "--poses", "hand=/hand"]


@pytest.fixture
def identified(topics, tmp_path, monkeypatch, capsys):
    """identified(*arguments, fit=names, changed=topics): exit status, what was said, and the values that were found."""

    def run(*arguments, fit=tuple(TRUTH), changed=None):
        (tmp_path / "scene.yaml").write_text(SCENE)
        write(tmp_path / "bag", topics | (changed or {}))
        line = ["identify", str(tmp_path / "bag"), "--scene", str(tmp_path / "scene.yaml"), "--device", "cpu"]
        line += ["--output", str(tmp_path / "found.yaml"), "--worlds", str(16 if len(fit) > 1 else 4)]
        monkeypatch.setattr(sys, "argv", [*line, "--fit", *(f"{name}=0.003:3" for name in fit), *arguments])
        status, told = program.main(), capsys.readouterr()
        if status:
            return status, told.err, {}
        found = yaml.safe_load((tmp_path / "found.yaml").read_text())["/**"]["ros__parameters"]
        values = [found[group][name] for group, name in (each.split(".") for each in fit)]
        return status, told.out, dict(zip(fit, values, strict=True))

    return run


def number(told, before):
    """The number behind these words."""
    return float(told.split(before)[1].split()[0])


@pytest.mark.long
def test_material_and_delay_are_found(identified):
    status, told, values = identified(*SEEN, "--delay=-0.02:0.1")
    assert status == 0, told
    assert values == pytest.approx(TRUTH, rel=0.05)
    assert number(told, "What was seen is late by ") == pytest.approx(DELAY, abs=0.005)
    assert "/camera/points: 22 of 22 messages, from 0.0633 to 0.763 s after the start, show cloth" in told
    assert "clocks" not in told and number(told, "The motion with these numbers is ") < 0.004


@pytest.mark.long
def test_what_clocks_apart_do_is_told(identified):
    status, told, values = identified(*SEEN, fit=list(TRUTH)[:1])
    assert status == 0, told
    assert abs(values["cloth.stretch_compliance"] / TRUTH["cloth.stretch_compliance"] - 1.0) > 0.1
    assert "The clocks of camera and poses are taken to agree; --delay LOW:HIGH finds" in told
    assert number(told, "The motion with these numbers is ") > 0.004


@pytest.mark.parametrize("begin", [0.0, 0.21])
def test_all_is_brought_into_the_scenes_frame_and_time(topics, tmp_path, begin):
    """The hand is told in a base that drives and turns, and was as the closed form of its motion says."""
    write(tmp_path / "bag", topics)
    (tmp_path / "scene.yaml").write_text(SCENE)
    names = {"cloth": "/camera/points"}, {"hand": "/hand"}
    recording = robot_recording(tmp_path / "bag", read_plan(tmp_path / "scene.yaml"), *names, begin)[0]
    clouds = np.arange(2, FRAMES + 1, 2) / 60 + DELAY - begin
    assert np.allclose(recording.times, clouds[clouds >= 0], atol=1e-6)
    assert recording.pose_times[0] == 0 and recording.pose_times[-1] >= recording.times[-1]
    held = [hand(min(begin + time, 164 / 150)) for time in recording.pose_times]
    assert np.allclose(recording.pose["hand"][:, :3], [place for place, _ in held], atol=1e-4)
    off = Rotation.from_quat(recording.pose["hand"][:, 3:]) * Rotation.concatenate([turn for _, turn in held]).inv()
    assert off.magnitude().max() < 1e-3
    if not begin:  # level at first, fallen little
        first = recording.points["cloth"][0]
        assert np.isfinite(first[:250]).all() and np.abs(first[:250] * [1, 1, 0]).max() < 0.32


def test_places_of_points_and_frames_between_stamps(tmp_path):
    """A camera turns about z on an arm that drives along x, seen from a frame beside: all by hand."""
    still = Rotation.identity()
    moving = [transforms(START + k, "arm", "camera", Rotation.from_rotvec([0, 0, 1.2 * k]), [0, 0, 1]) for k in (0, 1)]
    moving += [transforms(START + k, "root", "arm", still, [2.0 * k, 0, 0]) for k in (0, 2)]
    write(
        tmp_path / "bag",
        {
            "/tf": moving,
            "/tf_static": [transforms(0, "root", "map", Rotation.from_rotvec([0, 0, np.pi / 2]), [0, 5, 0])],
        },
    )
    stamps = np.array([-0.1, 0.25, 1.0, 1.5])
    tree = Transforms(Topics(tmp_path / "bag"))
    known, place = tree.place("camera", "map", np.rint((START + stamps) * 1e9).astype(np.int64))
    assert known.tolist() == [False, True, True, False], "between the first and the last of each transform alone"
    assert np.allclose(place.positions, [[-5, -0.5, 1], [-5, -2, 1]], atol=1e-6)
    assert np.allclose(place.turns.as_rotvec(), [[0, 0, 0.3 - np.pi / 2], [0, 0, 1.2 - np.pi / 2]], atol=1e-6)


@pytest.mark.parametrize("layout", ["<f4", ">f8"])
def test_large_clouds_are_thinned_evenly(topics, tmp_path, layout):
    line = np.linspace([0, 0, 1], [1, 2, 3], 5000)
    large = [cloud(START + k, "map", line, layout) for k in range(2)]
    write(tmp_path / "bag", {"/line": large})
    (tmp_path / "scene.yaml").write_text(SCENE)
    plan = read_plan(tmp_path / "scene.yaml")
    recording, said = robot_recording(tmp_path / "bag", plan, {"cloth": "/line"}, {}, 0.0)
    assert recording.points["cloth"].shape == (2, 2000, 3) and recording.times.tolist() == [0.0, 1.0]
    assert np.allclose(recording.points["cloth"][1], np.linspace([0, 0, 1], [1, 2, 3], 2000), atol=1e-3)
    assert "show cloth, with at most 2000 points each." in said[0]


LATER = 10.0  # [s] after all that the bag has
NOWHERE = np.full((4, 3), np.nan)
STILL = Rotation.identity()


@pytest.mark.parametrize(
    ("arguments", "changed", "words"),
    [
        (
            ["--points", "cloth=/dots"],
            {},
            "/dots is not there in BAG; allowed is a topic of sensor_msgs/msg/PointCloud2: /camera/points",
        ),
        (
            ["--points", "cloth=/hand"],
            {},
            "/hand is geometry_msgs/msg/PoseStamped in BAG; allowed is a topic of sensor",
        ),
        (["--points", "flag=/camera/points"], {}, "--points names flag; allowed of this scene is cloth"),
        ([*SEEN[:2], "--poses", "ball=/hand"], {}, "--poses names ball; allowed of this scene is hand"),
        (["--points", "cloth:/dots"], {}, "--points cloth:/dots is given; allowed is NAME=/topic, once for each name"),
        ([*SEEN, *SEEN[:2]], {}, "--points cloth=/camera/points is given; allowed is NAME=/topic, once for each name"),
        (SEEN[2:], {}, "--poses and --begin are of the bag of a robot; allowed are they with --points OBJECT=/topic"),
        ([*SEEN, "--begin", "nan"], {}, "--begin is nan; allowed is a number of seconds"),
        ([*SEEN, "--begin", "60"], {}, "--begin is 60, and BAG has no cloud after that; allowed is an earlier time"),
        ([*SEEN, "--delay", "0.1"], {}, "--delay is looked for within '0.1'; allowed are two numbers, LOW:HIGH"),
        ([*SEEN, "--delay", "0.2:0.1"], {}, "is looked for from 0.2 to 0.1 s; allowed is LOW:HIGH that rises"),
        ([*SEEN, "--delay", "0:9"], {}, "the recording ends at 0.763 s; allowed is a delay below that, not 9 s"),
        (SEEN, {"/hand": []}, "/hand has no messages in BAG; allowed are messages in one frame"),
        (
            SEEN,
            {"/hand": [pose(START + k, frame, [0, 0, 0], STILL) for k, frame in enumerate("ab")]},
            "/hand has messages in the frames a, b in BAG; allowed are messages in one frame",
        ),
        (SEEN, {"/hand": [pose(START, "map", [0, 0, 0], STILL)] * 2}, "all 2 messages of /hand have one stamp in BAG"),
        (
            SEEN,
            {"/hand": [pose(START, "map", [0, np.nan, 0], STILL)]},
            "the position of /hand is not finite everywhere",
        ),
        (
            SEEN,
            {"/tf_static": []},
            "BAG has no transform between 'camera' of its messages and 'map' of the scene; it has 'rover' in 'map'",
        ),
        (
            SEEN,
            {"/hand": [pose(START + LATER + k, "rover", [0, 0, 0], STILL) for k in range(2)]},
            "BAG has transforms between 'rover' of /hand and 'map' at other times only; allowed are",
        ),
        (
            SEEN,
            {"/hand": [pose(k, "map", [0, 0, 0], STILL) for k in range(2)]},
            "stamps of /camera/points, /hand are 1700000001 s apart in BAG; allowed are those of one clock",
        ),
        (SEEN[:2], {"/camera/points": [cloud(START, "map", NOWHERE)]}, "the recording shows no object; allowed are"),
        (
            SEEN[:2],
            {"/camera/points": [cloud(START, "map", NOWHERE, names="xyw")]},
            "/camera/points has clouds of x, rgb, y, w; allowed are x, y and z of 32 or 64 bits",
        ),
        (
            SEEN[:2],
            {"/camera/points": [cloud(START, "map", NOWHERE, lost=1)]},
            "/camera/points has a cloud of 95 bytes that are not 2 rows of 3 points; allowed are 48 bytes a row and 16",
        ),
    ],
)
def test_what_cannot_be_read_is_refused_in_one_sentence(identified, tmp_path, arguments, changed, words):
    status, told, _ = identified(*arguments, changed=changed)
    assert status == 2 and told.startswith("error: ") and told.count("\n") == 1
    assert words.replace("BAG", str(tmp_path / "bag")) in told


def test_poses_have_times_of_their_own_in_an_array_file_too(tmp_path):
    poses = np.tile((0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0), (5, 1))
    given = Recording([0.1, 0.2, 0.3], {"cloth": np.ones((3, 4, 3))}, pose={"hand": poses}, pose_times=np.arange(5) / 9)
    given.write(tmp_path / "recording.npz")
    late = Recording.read(tmp_path / "recording.npz").delayed(-0.1, 0.2)
    assert late.times.tolist() == [0.2, 0.3] and late.positions["cloth"].shape == (2, 4, 3)
    assert np.array_equal(late.pose_times, np.arange(5) / 9) and late.pose["hand"].shape == (5, 7)


def test_topics_of_an_array_file_are_refused(identified, tmp_path, monkeypatch, capsys):
    line = ["identify", "recording.npz", "--scene", str(tmp_path / "scene.yaml"), "--fit", "cloth.damping", *SEEN]
    (tmp_path / "scene.yaml").write_text(SCENE)
    monkeypatch.setattr(sys, "argv", line)
    assert program.main() == 2
    assert capsys.readouterr().err == (
        "error: --points names topics, and recording.npz is no bag; allowed is the folder of one\n"
    )
