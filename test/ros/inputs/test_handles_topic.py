# SPDX-License-Identifier: Apache-2.0
"""Handles by topic and service, as a driver in another process moves them: the node is a process of its own."""

import numpy as np
import pytest
from client import fields
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, WrenchStamped
from sensor_msgs.msg import PointCloud2
from std_srvs.srv import SetBool, Trigger

TOWEL = """
/**:
  ros__parameters:
    objects: [towel]
    handles: [left, right]
    towel: {type: cloth, resolution: [9, 9], size: [0.5, 0.5], mass: 0.1, pins: none, damping: 0.002}
    left: {position: [-0.25, -0.25, 0.0], reach: [0.02], attached: true}
    right: {position: [0.25, -0.25, 0.0], reach: [0.02], attached: true}
    solver: {global_damping: 2.0}
"""
WEIGHT = 0.1 * 9.81


@pytest.fixture
def towel(start, client):
    """The node, and its clouds."""
    node = start(TOWEL).wait_for("all kernels are compiled")
    node.clouds = client.listen(PointCloud2, "/cloth_sim/towel/particles", 1)
    return node


def move(client, handle, position):
    message = PoseStamped()
    message.header.stamp = client.node.get_clock().now().to_msg()
    p = message.pose.position
    p.x, p.y, p.z = map(float, position)
    message.pose.orientation.w = 1.0
    client.publish(f"/cloth_sim/handles/{handle}/pose", message)


def corner(node, place):
    return np.linalg.norm(fields(node.clouds[-1])[:, :3] - place, axis=1).min()


def hold(client, handle, on):
    return client.call(SetBool, f"/cloth_sim/handles/{handle}/attach", SetBool.Request(data=on))


@pytest.mark.long
def test_two_hands_lift_fold_and_lay_down_a_towel(towel, client):
    wrenches = {
        side: client.listen(WrenchStamped, f"/cloth_sim/handles/{side}/wrench", 1) for side in ("left", "right")
    }
    path = [(-0.25, 0.0), (-0.25, 0.4), (0.25, 0.4), (0.25, 0.3)]  # y and z of both hands
    for (y0, z0), (y1, z1) in zip(path[:-1], path[1:], strict=True):
        for k in range(1, 31):
            y, z = y0 + (y1 - y0) * k / 30, z0 + (z1 - z0) * k / 30
            for side, x in (("left", -0.25), ("right", 0.25)):
                move(client, side, (x, y, z))
            client.spin(0.02)
    client.until(lambda: all(corner(towel, (x, 0.25, 0.3)) < 1e-4 for x in (-0.25, 0.25)))

    def load():
        return sum(np.mean([message.wrench.force.z for message in each[-60:]]) for each in wrenches.values())

    client.spin(1.0)
    client.until(lambda: load() == pytest.approx(-WEIGHT, rel=0.01))  # it swings at first
    client.spin(1.0)
    assert load() == pytest.approx(-WEIGHT, rel=0.01)
    assert hold(client, "left", False).success and hold(client, "right", False).success
    assert client.get("left.attached") is False
    client.until(lambda: fields(towel.clouds[-1])[:, 2].max() < -0.2)  # it falls


@pytest.mark.long
def test_an_answer_tells_what_is_held_and_what_is_not(towel, client):
    assert hold(client, "left", True).message == "left holds 1 particle"
    assert client.set("left.attached", False).successful
    move(client, "left", (0, 0, 3))
    client.spin(0.3)
    answer = hold(client, "left", True)
    assert not answer.success and "left holds nothing: the nearest particle is of towel" in answer.message
    assert answer.message.endswith("m away, and lies beyond its reach")
    assert client.get("left.attached") is False
    diagnostics = client.listen(DiagnosticArray, "/diagnostics")
    told = {}
    while "left.held" not in told:
        client.until(lambda: diagnostics)
        told = {each.key: each.value for each in diagnostics.pop().status[0].values}
    assert (told["left.held"], told["right.held"]) == ("0", "1")


def test_a_hand_lets_go_of_too_much_and_says_so(towel, client):
    client.until(lambda: towel.clouds)
    assert client.set("left.break_force", 0.25 * WEIGHT).successful
    towel.wait_for("left let go: its load was larger than left.break_force", 10.0)
    client.until(lambda: client.get("left.attached") is False)
    assert client.get("right.attached") is True
    for side, words in (("left", "it holds nothing, so nothing goes with it"), ("right", "its pose is the first")):
        move(client, side, (0.0, -0.25, 0.3))
        towel.wait_for(f"handles/{side}/pose goes 0.391 m in one frame: {words}", 10.0)


@pytest.mark.long
def test_hands_keep_their_hold_through_a_rebuild_and_are_back_after_a_reset(towel, client):
    for k in range(30):
        for side, x in (("left", -0.25), ("right", 0.25)):
            move(client, side, (x, -0.25, 0.01 * k))
        client.spin(0.02)
    client.spin(0.5)
    built = towel.log.count("simulating ")
    assert client.set("towel.mass", 0.2).successful and client.set("device", "cpu").successful
    client.until(lambda: towel.log.count("simulating ") > built)
    client.spin(1.0)
    client.until(lambda: corner(towel, (-0.25, -0.25, 0.29)) < 1e-4)  # a heavier towel hangs where the lighter did
    assert client.set("towel.pins", [0]).successful
    assert hold(client, "left", False).success
    client.spin(1.0)
    assert corner(towel, (-0.25, -0.25, 0.29)) < 1e-3, "a pin holds what the hand let go"
    client.call(Trigger, "/cloth_sim/reset")
    client.spin(0.5)
    assert towel.alive() and "accepted but not applied" not in towel.log
