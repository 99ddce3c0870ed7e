# SPDX-License-Identifier: Apache-2.0
"""A gripper by topic, seen from another process: it presses, lifts, tells its state, and drops."""

import math
import time

import pytest
from client import fields
from geometry_msgs.msg import PoseStamped
from sensor_msgs.msg import JointState, PointCloud2
from std_msgs.msg import Float64
from visualization_msgs.msg import MarkerArray

SWATCH = """
/**:
  ros__parameters:
    objects: [swatch]
    grippers: [hand]
    gravity: [0.0, 0.0, 0.0]
    swatch: {type: cloth, resolution: [4, 4], size: [0.03, 0.03], mass: 0.05, thickness: 0.002, pins: none,
             orientation: [0.7071068, 0, 0, 0.7071068], static_friction: 0.8, kinetic_friction: 0.8,
             bending: dihedral, bend_compliance: 1000.0}
    hand: {finger_size: [0.1, 0.02, 0.1], opening: 0.03, compliance: 0.02, position: [0.0, 0.0, 0.0]}
    solver: {substeps: 20, method: xpbd}
"""
NEEDED = 0.05 * 9.81 / (2 * 0.8)  # [N] of each finger


@pytest.fixture
def hand(start, client):
    """A node whose gripper is open around a swatch of 50 g, and what it sends."""
    node = start(SWATCH).wait_for("all kernels are compiled")
    node.clouds = client.listen(PointCloud2, "/cloth_sim/swatch/particles", 1)
    node.states = client.listen(JointState, "/cloth_sim/grippers/hand/state", 1)
    client.until(lambda: node.clouds and node.states)
    node.height = lambda: float(fields(node.clouds[-1])[:, 2].mean())
    node.send = lambda what, value: client.publish(f"/cloth_sim/grippers/hand/{what}", Float64(data=float(value)))
    return node


def goes(client, z):
    """Sends the gripper to a height [m]."""
    message = PoseStamped()
    message.header.stamp, message.header.frame_id = client.node.get_clock().now().to_msg(), "world"
    message.pose.position.z, message.pose.orientation.w = float(z), 1.0
    client.publish("/cloth_sim/grippers/hand/pose", message)


@pytest.mark.long
def test_it_lifts_at_its_force_and_drops_at_half_of_it(hand, client):
    assert hand.states[-1].position[0] == pytest.approx(0.03) and hand.states[-1].name == ["hand"]
    pressed = lambda: hand.states[-1].effort[0] == pytest.approx(1.4 * NEEDED, rel=0.02)  # noqa: E731
    client.until(pressed, meanwhile=lambda: hand.send("force", 1.4 * NEEDED))  # best effort: one message may get lost
    client.spin(0.3)
    assert client.set("gravity", [0.0, 0.0, -9.81]).successful
    client.spin(0.3)
    begin = time.monotonic()

    def lift():
        share = min((time.monotonic() - begin) / 1.5, 1.0)
        goes(client, 0.1 * (0.5 - 0.5 * math.cos(math.pi * share)))

    client.until(lambda: hand.height() > 0.095, meanwhile=lift)
    client.spin(0.5)
    assert hand.height() == pytest.approx(0.1, abs=5e-3)
    assert hand.states[-1].effort[0] == pytest.approx(1.4 * NEEDED, rel=0.05)
    assert client.set("hand.speed", 0.2).successful
    assert client.set("swatch.self_contact", True).successful  # all is built anew around it: it holds on
    hand.wait_for("simulating swatch")
    client.spin(1.0)
    assert hand.height() == pytest.approx(0.1, abs=5e-3)
    client.until(lambda: hand.height() < -0.1, 90.0, lambda: hand.send("force", 0.7 * NEEDED))


def test_openings_by_topic_and_parameter_act_and_bad_ones_are_told(hand, client):
    reached = lambda: hand.states[-1].position[0] == pytest.approx(0.08)  # noqa: E731
    client.until(reached, meanwhile=lambda: hand.send("opening", 0.08))  # best effort: one message may get lost
    client.spin(0.2)
    assert client.set("hand.opening", 0.05).successful
    client.until(lambda: hand.states[-1].position[0] == pytest.approx(0.05))
    bad = (
        ("opening", 0.5, "its opening 0.5 is not from 0 to 0.08"),
        ("force", math.nan, "its force nan is not finite"),
    )
    for what, value, why in bad:
        text = f"a message on grippers/hand/{what} is refused: {why}"
        client.until(lambda: text in hand.log, meanwhile=lambda: hand.send(what, value))  # noqa: B023
    refused = client.set("hand.opening", 0.2)
    assert "hand.opening is 0.2; allowed is at most max_opening, 0.08 m" in refused.reason
    shown = client.listen(MarkerArray, "/cloth_sim/colliders", 1)
    goes(client, 0.3)
    is_there = lambda: any(m.pose.position.z == pytest.approx(0.3) for each in shown for m in each.markers)  # noqa: E731
    client.until(is_there, meanwhile=lambda: goes(client, 0.3))
    names = {marker.ns for marker in shown[-1].markers if marker.ns}
    assert names == {"hand_left", "hand_right"} and hand.alive()
