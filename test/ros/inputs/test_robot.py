# SPDX-License-Identifier: Apache-2.0
"""A robot from one line: its links are where its joints say, on a real node and beside another reader's kinematics."""

import io
import logging
import re
import subprocess
import sys
from functools import partial

import numpy as np
import pytest
from arm import LENGTH, arm, chain
from client import LATCHED, fields
from geometry_msgs.msg import TransformStamped
from node_process import ROOT
from rclpy.time import Time
from scene_values import values
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import JointState, PointCloud2
from std_msgs.msg import String
from visualization_msgs.msg import MarkerArray

from cloth_sim_ros.ros.inputs.frames import Frames
from cloth_sim_ros.ros.inputs.pose_track import Pose
from cloth_sim_ros.ros.inputs.robot import read_robot
from cloth_sim_ros.ros.parameters.plan import make_plan
from cloth_sim_ros.ros.world import World

trimesh = pytest.importorskip("trimesh")
yourdfpy = pytest.importorskip("yourdfpy")

BASE = Pose((0.3, -0.2, 0.1), tuple(Rotation.from_rotvec([0.2, 0.1, -0.4]).as_quat().tolist()))
JOINTS = {"pan": 2.5, "lift": -0.7, "bend": 1.1, "grip": 0.03}
SCENE = """
/**:
  ros__parameters:
    objects: [sheet]
    handles: [hand]
    sheet: {{resolution: [6, 6], size: [0.3, 0.3], pins: corners, position: [5, 0, 1]}}
    hand: {{follow_frame: wrist, object: sheet}}
    robot:
      description: /robot_description
      joint_states: /joint_states
      position: [0.3, -0.2, 0.1]
      orientation: {orientation}
"""


def matrix(position, orientation):
    found = np.eye(4)
    found[:3, :3], found[:3, 3] = Rotation.from_quat(orientation).as_matrix(), position
    return found


def expected(text, joints):
    """robot/<link>/0 -> where it is (4, 4), by the kinematics of yourdfpy."""
    model = yourdfpy.URDF.load(io.BytesIO(text.encode()), load_meshes=False)
    model.update_cfg(joints)
    base = matrix(BASE.position, BASE.orientation)
    return {
        f"robot/{name}/{k}": base @ model.get_transform(name, model.base_link) @ collision.origin
        for name, link in model.link_map.items()
        for k, collision in enumerate(link.collisions)
    }


@pytest.fixture
def mesh(tmp_path):
    trimesh.creation.box((60, 40, 100)).export(tmp_path / "wrist.stl")
    return tmp_path / "wrist.stl"


def test_links_of_a_chain_are_on_an_arc():
    """All joints at one angle: link k begins at the sum of LENGTH (sin, cos) of the angles before it."""
    robot, angle = read_robot(chain(20)), 0.11
    places = robot.places({f"joint_{k}": angle for k in range(20)}, Pose((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)))
    for k in range(20):
        before = angle * np.arange(1, k + 1)
        wanted = LENGTH * np.array([np.sin(before).sum(), 0.0, np.cos(before).sum()])
        np.testing.assert_allclose(places[f"link_{k}"].position, wanted, atol=1e-12)
        half = 0.5 * angle * (k + 1)
        turn = np.array(places[f"link_{k}"].orientation)
        assert abs(turn @ [0.0, np.sin(half), 0.0, np.cos(half)]) == pytest.approx(1.0, abs=1e-12)


def test_colliders_are_where_another_reader_has_them(mesh):
    robot = read_robot(arm(mesh))
    assert robot.joints == {"pan", "lift", "bend", "grip", "other"}
    plan = make_plan(values(robot__urdf=arm(mesh), robot__links=("*er", "wrist"), robot__static_friction=0.9))
    assert set(plan.mounts) == {f"robot/{name}/0" for name in ("shoulder", "wrist", "left_finger", "right_finger")}
    assert plan.scene.colliders["robot/shoulder/0"].static_friction == 0.9 and not plan.problems
    np.testing.assert_allclose(np.ptp(plan.scene.colliders["robot/wrist/0"].points(), axis=0), (0.06, 0.04, 0.1))
    wanted, places = expected(arm(mesh), JOINTS), robot.places(JOINTS, BASE)
    for name, part in robot.parts.items():
        found = matrix(**vars(places[part.link])) @ matrix(**vars(part.pose))
        np.testing.assert_allclose(found, wanted[name], atol=1e-9)


@pytest.mark.parametrize(
    ("urdf", "sentence"),
    [
        ("<robot", "is no description of a robot: "),
        ("<robot name='it'/>", "its links hang on the roots none; allowed is one tree"),
        ("<robot name='it'><link name='a'/><link name='b'/></robot>", "hang on the roots a, b; allowed is one tree"),
        ("<robot name='it'><link name='a'/></robot>", "which no link matches; there are none, as no link collides"),
        (chain(2).replace('child link="link_1"', 'child link="no"'), "joint joint_1 names a link no, which is not the"),
        (chain(2).replace('"0 1 0"', '"0 0 0"'), "joint joint_0 has the axis 0"),
        (chain(2).replace('"0 0 0.075"', '"0 0 nan"'), "an origin is not finite"),
        ("/nowhere/robot.urdf", "robot.urdf is '/nowhere/robot.urdf', which cannot be read: No such file"),
        ("package://none/robot.urdf", "robot.urdf is 'package://none/robot.urdf', and no package 'none' is installed"),
        ("/dev/zero", "cannot be read: a device is there"),
    ],
)
def test_a_bad_description_is_refused_in_a_sentence(urdf, sentence):
    plan = make_plan(values(robot__urdf=urdf))
    assert sentence in plan.problems["robot"] and not plan.mounts
    assert "\n" not in plan.problems["robot"]


def test_one_bad_geometry_leaves_the_others():
    plan = make_plan(values(robot__urdf=arm("/nowhere.stl")))
    assert set(plan.problems) == {"robot/wrist/0"} and len(plan.mounts) == 5
    assert "is '/nowhere.stl'; no such file is in '/'; allowed are .obj, " in plan.problems["robot/wrist/0"]


class Buffer:
    """What tf2_ros would know of a robot; it does not come from the Python registry, see test_frames.py."""

    def __init__(self, robot):
        self.robot, self.joints, self.stamp = robot, {}, 1.0

    def lookup_transform(self, target, source, at):
        pose, message = self.robot.places(self.joints, BASE)[source], TransformStamped()
        message.header.stamp = Time(nanoseconds=round(1e9 * self.stamp)).to_msg()
        p, q = message.transform.translation, message.transform.rotation
        (p.x, p.y, p.z), (q.x, q.y, q.z, q.w) = pose.position, pose.orientation
        return message


def test_links_go_by_tf_appear_where_they_are_and_rest_when_it_does():
    buffer = Buffer(read_robot(chain(3)))
    told = values(device="cpu", objects=(), colliders=(), robot__urdf=chain(3))
    world = World(told, logging.getLogger("test"), Frames("world", buffer=buffer))
    assert world.build(told)
    buffer.joints = {"joint_0": 0.5, "joint_2": -1.0}
    world.advance()
    assert world.sim._bodies.colliders.are_still, "no link sweeps from where nobody saw it"
    for angle in (0.5, 0.6, 0.7, 0.7, 0.7, 0.7):
        buffer.joints["joint_0"], buffer.stamp = angle, buffer.stamp + 1 / 60
        world.advance()
    wanted = expected(chain(3), buffer.joints)
    for name in wanted:
        found = matrix(world.sim.get(f"{name}.position"), world.sim.get(f"{name}.orientation"))
        np.testing.assert_allclose(found, wanted[name], atol=1e-6)
    assert len(wanted) == 3 and world.sim._bodies.colliders.are_still, "the same place again is no motion"


def drawn(message):
    """Name -> where a collider or handle is drawn (4, 4)."""
    found = {}
    for marker in message.markers[1:]:
        p, q = marker.pose.position, marker.pose.orientation
        found[marker.ns] = matrix((p.x, p.y, p.z), (q.x, q.y, q.z, q.w))
    return found


def say(client, joints):
    """What moves the joints to these positions, by two senders, of which one is behind."""
    topic = "/joint_states"
    publisher = client.node.create_publisher(JointState, topic, 10)
    client.until(lambda: publisher.get_subscription_count() > 0)

    def send():
        for names in (list(joints)[:2], list(joints)[2:]):
            message = JointState(name=names, position=[joints[name] for name in names])
            message.header.stamp = client.node.get_clock().now().to_msg()
            publisher.publish(message)

    return send


def are_at(shown, wanted):
    """Whether all that is wanted is drawn there, within 1e-6 m and rad."""
    found = drawn(shown[-1]) if shown else {}
    return wanted.keys() <= found.keys() and all(np.abs(found[name] - wanted[name]).max() < 1e-6 for name in wanted)


@pytest.mark.long
def test_a_robot_of_a_topic_goes_by_its_joints_on_a_real_node(start, client, mesh):
    node = start(SCENE.format(orientation=list(BASE.orientation))).ready()
    described = client.node.create_publisher(String, "/robot_description", LATCHED)
    described.publish(String(data="no robot"))
    node.wait_for("a message on /robot_description is refused: robot.urdf is no description of a robot: ")
    shown = client.listen(MarkerArray, "/cloth_sim/colliders", LATCHED)
    described.publish(String(data=arm(mesh)))
    in_wrist = read_robot(arm(mesh)).parts["robot/wrist/0"].pose
    for joints in (JOINTS, {"pan": -1.5, "lift": 0.4, "bend": -2.0, "grip": 0.0}):
        wanted, send = expected(arm(mesh), joints), say(client, joints)
        assert len(wanted) == 6
        wanted["hand"] = wanted["robot/wrist/0"] @ np.linalg.inv(matrix(**vars(in_wrist)))
        client.until(partial(are_at, shown, wanted), timeout=120.0, meanwhile=send)
    send = client.node.create_publisher(JointState, "/joint_states", 10)
    client.until(lambda: send.get_subscription_count() > 0)
    send.publish(JointState(name=["pan"], position=[float("nan")]))
    send.publish(JointState(name=["pan"], position=[]))
    node.wait_for("a message on /joint_states is refused: the position of its joint 'pan' is nan")
    node.wait_for("a message on /joint_states is refused: it has 1 names and 0 positions")
    assert client.set("robot.links", ["*finger"]).successful
    client.until(lambda: len(drawn(shown[-1])) == 3)
    assert not client.set("robot.links", ["*toe"]).successful
    assert client.set("robot.urdf", "").successful
    client.until(lambda: set(drawn(shown[-1])) == {"hand"})
    assert "Traceback" not in node.log


def test_topics_that_cannot_be_are_told(start):
    scene = SCENE.format(orientation="[0.0, 0.0, 0.0, 1.0]")
    node = start(scene.replace("/robot_description", "'the robot'").replace("/joint_states", "/joint//states")).ready()
    assert "robot.description is 'the robot', left out: " in node.log
    assert "robot.joint_states is '/joint//states', left out: " in node.log and "Traceback" not in node.log


@pytest.mark.long
def test_the_arm_of_the_guide_picks_a_towel_up(start, client, tmp_path):
    page = (ROOT / "docs/how-to/robot.md").read_text()
    kinds = ("xml\n", r"yaml\n(?=/\*\*:)", "python\n")  # what stands above the guide's own scene is an excerpt
    urdf, scene, drive = (re.search(rf"```{kind}(.*?)```", page, re.DOTALL)[1] for kind in kinds)
    (tmp_path / "arm.urdf").write_text(urdf)
    (tmp_path / "drive.py").write_text(drive)
    start(scene.replace("arm.urdf", str(tmp_path / "arm.urdf"))).ready()
    clouds = client.listen(PointCloud2, "/cloth_sim/towel/particles", 1)
    client.until(lambda: clouds)
    command = [sys.executable, str(tmp_path / "drive.py")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True)
    assert "hand" in done.stdout
    client.until(lambda: fields(clouds[-1])[:, 2].max() > 0.3, timeout=10.0)
    assert fields(clouds[-1])[:, 1].mean() > 0.3, "the arm has turned"
