# SPDX-License-Identifier: Apache-2.0
"""Colliders that come and go on ~/scene, and what ~/colliders shows."""

import numpy as np
import pytest
from client import LATCHED, fields
from sensor_msgs.msg import PointCloud2
from visualization_msgs.msg import Marker, MarkerArray

ROOM = """
/**:
  ros__parameters:
    objects: [sheet]
    colliders: [rod, floor]
    handles: [hand]
    spare_colliders: 2
    rate: 60.0
    sheet: {type: cloth, resolution: [9, 9], size: [0.4, 0.4], pins: edges, position: [0, 0, 1], damping: 0.002}
    rod: {shape: capsule, dimensions: [0.4, 0.05], position: [5, 0, 0]}
    floor: {shape: plane}
    hand: {position: [0, 3, 0], reach: [0.1]}
"""


@pytest.fixture
def room(start, client):
    """The node and its clouds."""
    node = start(ROOM).wait_for("all kernels are compiled")
    node.clouds = client.listen(PointCloud2, "/cloth_sim/sheet/particles", 1)
    client.until(lambda: node.clouds)
    return node


def marker(number, kind, scale, position=(0, 0, 0), action=Marker.ADD):
    message = Marker(ns="box", id=number, type=kind, action=action)
    message.scale.x, message.scale.y, message.scale.z = map(float, scale)
    p = message.pose.position
    p.x, p.y, p.z = map(float, position)
    message.pose.orientation.w = 1.0
    return message


def send(client, *markers):
    publisher = client.node.create_publisher(MarkerArray, "/cloth_sim/scene", 10)
    client.until(lambda: publisher.get_subscription_count() > 0)
    publisher.publish(MarkerArray(markers=list(markers)))


def reaches(node, client, low, high):
    """Waits until the highest particle lies between two heights [m], and then that it stays there."""
    inside = lambda: low < fields(node.clouds[-1])[:, 2].max() < high  # noqa: E731
    client.until(inside)
    client.spin(0.3)
    return inside()


@pytest.mark.long
def test_a_marker_pushes_the_cloth_moves_and_goes(room, client):
    assert reaches(room, client, 0.99, 1.01)
    send(client, marker(1, Marker.SPHERE, (0.2, 0.2, 0.2), (0, 0, 0.93)))
    assert reaches(room, client, 1.03, 1.045), "its top at 1.03 m, and the thickness"
    send(client, marker(1, Marker.SPHERE, (0.2, 0.2, 0.2), (0, 0, 0.96)))
    assert reaches(room, client, 1.06, 1.075)
    send(client, marker(1, 0, (0, 0, 0), action=Marker.DELETE))
    assert reaches(room, client, 0.99, 1.03)
    send(client, marker(2, Marker.CUBE, (0.1, 0.1, 0.1), (0, 0, 0.8)))
    client.spin(0.5)
    send(client, marker(2, Marker.CUBE, (0.1, 0.1, 0.1), (0, 0, 1.0)))
    assert reaches(room, client, 1.05, 1.065), "it came from below"


@pytest.mark.long
def test_what_cannot_be_added_is_told_and_nothing_changes(room, client):
    send(client, marker(1, Marker.SPHERE, (0.2, 0.1, 0.2)), marker(2, Marker.CUBE, (-1, 1, 1)))
    room.wait_for("box/1 is of type 2 and scale 0.2 0.1 0.2; allowed are cubes", 5.0)
    room.wait_for("has the scale -1 1 1: Box.half_extents is [-0.5, 0.5, 0.5]; allowed is", 5.0)
    send(client, *(marker(k, Marker.CYLINDER, (0.1, 0.1, 0.1), (9, 9, 9)) for k in range(3)))
    room.wait_for("box/2 is one collider too many; allowed are 2 added ones", 5.0)
    send(client, marker(3, Marker.CUBE, (0.1, 0.1, 0.1), (0, 0, 1), action=9))
    room.wait_for("box/3 has the action 9; allowed are ADD 0, DELETE 2 and DELETEALL 3", 5.0)
    assert reaches(room, client, 0.99, 1.01) and room.alive()


@pytest.mark.long
def test_a_lifetime_is_told_to_be_none(room, client):
    brief = marker(1, Marker.SPHERE, (0.2, 0.2, 0.2), (0, 0, 0.93))
    brief.lifetime.sec = 1
    send(client, brief)
    room.wait_for("box/1 has a lifetime, and stays until a marker deletes it", 5.0)
    assert reaches(room, client, 1.03, 1.045)


def test_everything_that_is_there_is_shown(room, client):
    shown = client.listen(MarkerArray, "/cloth_sim/colliders", LATCHED)
    client.until(lambda: shown)
    assert {each.ns for each in shown[-1].markers[1:]} == {"rod", "floor", "hand"}
    rod = [each for each in shown[-1].markers if each.ns == "rod"]
    assert [each.type for each in rod] == [Marker.CYLINDER, Marker.SPHERE, Marker.SPHERE]
    assert sorted(each.pose.position.z for each in rod) == pytest.approx([-0.2, 0.0, 0.2])
    moved = lambda: any(each.ns == "rod" and each.pose.position.x == 1.0 for each in shown[-1].markers)  # noqa: E731
    client.until(moved, meanwhile=lambda: client.move("rod", (1, 2, 3)))  # best effort: one may be lost
    client.spin(0.2)
    send(client, marker(7, Marker.CUBE, (0.1, 0.2, 0.3), (4, 0, 0)))
    client.until(lambda: any(each.ns == "box/7" for each in shown[-1].markers))
    box = shown[-1].markers[[each.ns for each in shown[-1].markers].index("box/7")]
    assert np.allclose([box.scale.x, box.scale.y, box.scale.z, box.pose.position.x], [0.1, 0.2, 0.3, 4.0])
    count = len(shown)
    client.spin(1.0)
    assert len(shown) == count, "nothing is sent while nothing changes"
