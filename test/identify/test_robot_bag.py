# SPDX-License-Identifier: Apache-2.0
"""A material found in the bag of a robot: a depth camera and a hand, each in a frame of its own, and clocks apart."""

import sys

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation, Slerp

pytest.importorskip("rosbags")

from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from cloth_sim_ros.identify import __main__ as program
from cloth_sim_ros.sim import Simulation
from cloth_sim_ros.study.scene_file import read_plan

TYPES = get_typestore(Stores.ROS2_JAZZY)
KINDS = TYPES.types
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
FRAMES = 60
CAMERA = Rotation.from_euler("xyz", [2.0, 0.3, -0.7]), np.array([0.4, -1.2, 0.8])  # in the frame "base"
BASE = Rotation.from_euler("xyz", [0.1, -0.2, 1.1]), np.array([2.0, 1.0, 0.5])  # in the frame "map"


def hand(time):
    """Where the hand is: it swings and turns."""
    x, z = 0.08 * (1.0 - np.cos(9.0 * time)), 0.05 * np.sin(7.0 * time) ** 2
    return np.array([x, 0.3, z]), Rotation.from_rotvec([0.3 * np.sin(4.0 * time) ** 2, 0.0, 0.0])


def of(kind, **fields):
    return KINDS[kind](**fields)


def header(stamp, frame):
    nanoseconds = round(stamp * 1e9)
    time = of("builtin_interfaces/msg/Time", sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9)
    return of("std_msgs/msg/Header", stamp=time, frame_id=frame)


def vector(kind, values):
    return of(f"geometry_msgs/msg/{kind}", **dict(zip("xyzw", map(float, values), strict=False)))


def transforms(stamp, parent, child, turn, place):
    inner = of(
        "geometry_msgs/msg/Transform",
        translation=vector("Vector3", place),
        rotation=vector("Quaternion", turn.as_quat()),
    )
    stamped = of(
        "geometry_msgs/msg/TransformStamped", header=header(stamp, parent), child_frame_id=child, transform=inner
    )
    return of("tf2_msgs/msg/TFMessage", transforms=[stamped])


def pose(stamp, frame, place, turn):
    inner = of(
        "geometry_msgs/msg/Pose", position=vector("Point", place), orientation=vector("Quaternion", turn.as_quat())
    )
    return of("geometry_msgs/msg/PoseStamped", header=header(stamp, frame), pose=inner)


def cloud(stamp, frame, points):
    """As a driver sends it: in two rows, with colours between, and a point that the camera could not see."""
    points = np.concatenate([points, np.full((2 + len(points) % 2, 3), np.nan)])
    data = np.zeros(len(points), np.dtype("<f4, V4, <f4, <f4"))
    for name, column in zip(("f0", "f2", "f3"), points.T, strict=True):
        data[name] = column
    fields = [
        of("sensor_msgs/msg/PointField", name=name, offset=offset, datatype=7, count=1)
        for name, offset in (("x", 0), ("rgb", 4), ("y", 8), ("z", 12))
    ]
    rest = {"height": 2, "width": len(points) // 2, "is_bigendian": False, "is_dense": False}
    rest |= {"point_step": 16, "row_step": 8 * len(points), "data": np.frombuffer(data.tobytes(), np.uint8)}
    return of("sensor_msgs/msg/PointCloud2", header=header(stamp, frame), fields=fields, **rest)


def write(path, topics):
    """A bag: topic -> messages."""
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        for topic, messages in topics.items():
            kind = messages[0].__msgtype__ if messages else "geometry_msgs/msg/PoseStamped"
            connection = writer.add_connection(topic, kind, typestore=TYPES)
            for k, message in enumerate(messages):
                writer.write(connection, k, TYPES.serialize_cdr(message, kind))


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


@pytest.fixture
def identified(topics, tmp_path, monkeypatch, capsys):
    """identified(*arguments, without=(), **others): exit status, what was said, and what was found."""

    def run(*arguments, others=None):
        (tmp_path / "scene.yaml").write_text(SCENE)
        bag, found = tmp_path / "bag", tmp_path / "found.yaml"
        write(bag, {topic: messages for topic, messages in (topics | (others or {})).items() if messages is not None})
        line = ["identify", str(bag), "--scene", str(tmp_path / "scene.yaml"), "--device", "cpu", "--worlds", "16"]
        line += ["--output", str(found), "--fit", *(f"{name}=0.003:{3.0}" for name in TRUTH), *arguments]
        monkeypatch.setattr(sys, "argv", line)
        status, told = program.main(), capsys.readouterr()
        values = yaml.safe_load(found.read_text())["/**"]["ros__parameters"] if found.exists() else {}
        return (
            status,
            told.out + told.err,
            {name: values[name.split(".")[0]][name.split(".")[1]] for name in TRUTH if values},
        )

    return run


SEEN = ["--points", "cloth=/camera/points", "--poses", "hand=/hand"]


def test_material_and_delay_are_found(identified):
    status, told, values = identified(*SEEN, "--delay=-0.02:0.1")
    print(told)
    assert status == 0, told
    assert values == pytest.approx(TRUTH, rel=0.05)
    (line,) = [line for line in told.splitlines() if line.startswith("What was seen is late by ")]
    assert float(line.split()[6]) == pytest.approx(DELAY, abs=0.005)
