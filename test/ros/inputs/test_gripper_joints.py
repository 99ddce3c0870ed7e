# SPDX-License-Identifier: Apache-2.0
"""A gripper as a joint of ros2_control: commands, trajectories and states, of which none is lost."""

import math

import pytest
from builtin_interfaces.msg import Duration
from client import seconds
from rclpy.qos import QoSProfile, ReliabilityPolicy, qos_profile_sensor_data
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64
from std_srvs.srv import SetBool
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from cloth_sim_ros.ros.joints import Joint

# As of a gripper whose joint turns by 0.8 rad while it closes from 0.08 m.
JAW = """
/**:
  ros__parameters:
    objects: [swatch]
    grippers: [jaw]
    swatch: {type: cloth, resolution: [4, 4], size: [0.03, 0.03], position: [0, 0, 5], pins: corners,
             bending: dihedral, bend_compliance: 1000.0}
    jaw: {joint: knuckle, joint_commands: /jaw_commands, joint_states: /jaw_states, joint_trajectory: /jaw/trajectory,
          joint_closed: 0.8, joint_open: 0.0, speed: 1.0}
"""
QUOTE = "'"
RELIABLE = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE)


@pytest.fixture
def jaw(start, client):
    """A node with that gripper, what it tells, and how to send a message once, as topic_based_ros2_control does."""
    node = start(JAW)
    node.states = client.listen(JointState, "/jaw_states", qos_profile_sensor_data)
    senders = {
        topic: client.node.create_publisher(kind, topic, RELIABLE)
        for topic, kind in (("/jaw_commands", JointState), ("/jaw/trajectory", JointTrajectory))
    }
    client.until(lambda: all(sender.get_subscription_count() for sender in senders.values()))
    node.send = lambda **fields: senders["/jaw_commands"].publish(JointState(name=["knuckle"], **fields))
    node.go = senders["/jaw/trajectory"].publish
    node.at = lambda position: bool(node.states) and node.states[-1].position[0] == pytest.approx(position, abs=1e-6)
    return node


def trajectory(*points, names=("lift", "knuckle"), **header):
    """Positions of the second of two joints, and when [s]."""
    message = JointTrajectory(joint_names=list(names))
    for time, position in points:
        after = Duration(sec=int(time), nanosec=round(1e9 * (time % 1.0)))
        message.points.append(JointTrajectoryPoint(positions=[9.0, float(position)], time_from_start=after))
    return message


def test_a_command_moves_it_once_and_its_state_is_told(jaw, client):
    jaw.ready()
    client.until(lambda: jaw.at(0.0))
    jaw.send(position=[0.4])
    client.until(lambda: jaw.at(0.4))
    state = jaw.states[-1]
    assert state.name == ["knuckle"] and state.header.frame_id == "world" and seconds(state.header.stamp) > 0.0
    moving = [each for each in jaw.states if 0.01 < each.position[0] < 0.39]
    assert moving and all(each.velocity[0] == pytest.approx(10.0, rel=1e-3) for each in moving), "1 m/s is 10 rad/s"
    jaw.send(position=[math.nan], effort=[0.3])  # closes on nothing, as a force does
    client.until(lambda: jaw.states[-1].position[0] > 0.75)
    opened = client.listen(JointState, "/cloth_sim/grippers/jaw/state", 1)
    jaw.send(position=[-0.1])
    client.until(lambda: jaw.at(0.0) and opened and opened[-1].position[0] == pytest.approx(0.08))
    jaw.wait_for("a message on /jaw_commands is cut: the position -0.1 of knuckle is not between 0.8 and 0")


def test_a_command_while_paused_or_after_another_topic_is_kept(jaw, client):
    jaw.ready()
    client.until(lambda: jaw.at(0.0))
    client.call(SetBool, "/cloth_sim/pause", SetBool.Request(data=True))
    jaw.send(position=[0.6])
    client.spin(0.3)
    assert jaw.at(0.0)
    client.call(SetBool, "/cloth_sim/pause", SetBool.Request(data=False))
    client.until(lambda: jaw.at(0.6))
    client.until(
        lambda: jaw.at(0.2), meanwhile=lambda: client.publish("/cloth_sim/grippers/jaw/opening", Float64(data=0.06))
    )
    assert client.set("swatch.resolution", [5, 4]).successful  # builds anew
    jaw.send(position=[0.5])
    client.until(lambda: jaw.at(0.5))
    assert client.set("swatch.resolution", [4, 4]).successful
    client.spin(0.5)
    client.until(lambda: jaw.at(0.5))


@pytest.mark.long
def test_a_command_while_kernels_are_compiled_for_the_first_time_is_kept(start, client, tmp_path, monkeypatch, request):
    monkeypatch.setenv("WARP_CACHE_PATH", str(tmp_path / "empty"))
    jaw = request.getfixturevalue("jaw")
    jaw.send(position=[0.3])
    assert "simulating" not in jaw.log
    jaw.wait_for("simulating", timeout=300.0)
    client.until(lambda: jaw.at(0.3), timeout=120.0)


def test_a_trajectory_is_gone_through_at_its_times(jaw, client):
    jaw.ready()
    client.until(lambda: jaw.at(0.0))
    jaw.states.clear()
    jaw.go(trajectory((1.0, 0.2), (1.5, 0.8)))
    client.until(lambda: jaw.at(0.8))
    frames = [each.position[0] for each in jaw.states if 0.0 < each.position[0] < 0.8]
    slow, quick = (sum(low < each < high for each in frames) for low, high in ((0.02, 0.18), (0.23, 0.77)))
    assert slow == pytest.approx(48, abs=3) and quick == pytest.approx(27, abs=3), "0.2 and 1.2 rad/s at 60 Hz"
    jaw.go(trajectory((5.0, 0.0)))
    client.until(lambda: 0.5 < jaw.states[-1].position[0] < 0.75)
    jaw.go(trajectory())
    client.spin(0.3)
    stopped = jaw.states[-1].position[0]
    client.spin(0.3)
    assert jaw.at(stopped) and 0.4 < stopped < 0.75
    message = trajectory((0.1, 0.8), (0.2, 0.1))
    message.header.stamp.sec = 1  # long ago: it is where it ends
    jaw.go(message)
    client.until(lambda: jaw.at(0.1))


def test_a_trajectory_is_stamped_by_the_clock_that_the_node_gives(start, client):
    start(JAW, "-p", "publish_clock:=true").ready()
    states = client.listen(JointState, "/jaw_states", qos_profile_sensor_data)
    sender = client.node.create_publisher(JointTrajectory, "/jaw/trajectory", RELIABLE)
    client.until(lambda: sender.get_subscription_count() and states)
    message = trajectory((1.0, 0.1), (1.5, 0.8))
    message.header.stamp = states[-1].header.stamp
    sender.publish(message)
    client.until(lambda: states[-1].position[0] > 0.75)
    assert sum(0.02 < each.position[0] < 0.09 for each in states) > 20, "it takes its time"


def test_grippers_share_topics_and_follow_another_widest_opening(start, client):
    """A hardware interface reads the newest message of its topic alone."""
    second = "claw: {joint_commands: /jaw_commands, joint_states: /jaw_states, position: [0, 1, 0], speed: 1.0}"
    start(f"{JAW.replace('[jaw]', '[jaw, claw]')}    {second}\n").ready()
    states = client.listen(JointState, "/jaw_states", qos_profile_sensor_data)
    client.until(lambda: states)
    assert {tuple(each.name) for each in states} == {("knuckle", "claw")}
    command = JointState(name=["claw", "knuckle"], position=[0.02, 0.6])
    sender = client.node.create_publisher(JointState, "/jaw_commands", RELIABLE)
    client.until(lambda: sender.get_subscription_count())
    sender.publish(command)
    client.until(lambda: states[-1].position.tolist() == pytest.approx([0.6, 0.02], abs=1e-6))
    assert client.set("jaw.max_opening", 0.1).successful
    sender.publish(command)
    client.until(lambda: states[-1].position.tolist() == pytest.approx([0.6, 0.02], abs=1e-6))


def test_what_cannot_be_is_refused(jaw, client):
    jaw.ready()
    for fields, why in (
        ({"position": [math.inf]}, "its position inf is not finite"),
        ({"position": [0.1, 0.2]}, "it has 1 names, and 2 numbers as position"),
        ({}, "it has neither a position nor an effort of its joint knuckle"),
        ({"effort": [-1.0]}, "its effort -1 is a force of -10 N, not from 0 to 10000"),
    ):
        jaw.send(**fields)
        jaw.wait_for(f"a message on /jaw_commands is refused: {why}")
    jaw.go(trajectory((1.0, 0.2), (0.5, 0.1)))
    jaw.wait_for("a message on /jaw/trajectory is refused: a point at 0.5 s follows one at 1 s")
    jaw.go(trajectory((1.0, 0.2), names=("lift", "elbow")))  # of other joints: nothing is said
    jaw.send(position=[0.8])
    client.until(lambda: jaw.at(0.8))
    assert jaw.log.count("is refused") == 5 and "has no effect" not in jaw.log and "Traceback" not in jaw.log


def test_a_joint_of_another_name_is_told_once(jaw, client):
    jaw.ready()
    sender = client.node.create_publisher(JointState, "/jaw_commands", RELIABLE)
    client.until(lambda: sender.get_subscription_count() > 0)
    told = "a message on /jaw_commands has no effect: jaw is the joint 'knuckle', and it has ['knukle']"
    sender.publish(JointState(name=["knukle"], position=[0.4]))
    jaw.wait_for(told)
    sender.publish(JointState(name=["lift"], position=[0.4]))
    sender.publish(JointState(name=["knuckle"], position=[0.4]))
    client.until(lambda: jaw.at(0.4))
    assert jaw.log.count("has no effect") == 1


def test_names_that_no_topic_has_and_equal_ends_are_told(start):
    names = {
        "first": ("'my jaw'", "must not contain characters other than"),
        "second": ("/jaw//commands", "must not contain repeated '/'"),
        "third": ("'{side}/jaw'", "unknown substitution"),
        "fourth": ("/jaw_states", "this node sends on it, and would hear itself"),
    }
    rows = {name: f"joint_commands: {commands}, joint_states: /jaw_states" for name, (commands, _) in names.items()}
    rows["fifth"] = "joint_commands: /jaw_commands, joint_trajectory: /jaw_commands"
    rows["sixth"] = "joint_closed: 0.8, joint_open: 0.8"
    text = "".join(f"    {name}: {{{row}}}\n" for name, row in rows.items())
    node = start(f"/**:\n  ros__parameters:\n    grippers: [{', '.join(rows)}]\n{text}").ready()
    for name, (commands, why) in names.items():
        told = f"{name}.joint_commands is {commands if commands[0] == QUOTE else QUOTE + commands + QUOTE}, left out: "
        assert told in node.log and why in node.log
    assert "fifth.joint_trajectory is '/jaw_commands', left out: this node takes JointState from it" in node.log
    assert "sixth.joint_open is 0.8, as is joint_closed; they must differ" in node.log and "Traceback" not in node.log


def test_work_is_the_same_of_joint_and_fingers():
    joint = Joint("knuckle", 0.8, 0.0, 0.08)
    assert joint.opening(0.8) == 0.0 and joint.opening(0.0) == pytest.approx(0.08)
    assert joint.position(joint.opening(0.3)) == pytest.approx(0.3)
    assert abs(joint.slope) == pytest.approx(0.1), "each finger's force over the torque [1/m]"
