# SPDX-License-Identifier: Apache-2.0
"""Patched bytes decode to the very messages that the ordinary way of building them gives."""

import numpy as np
import pytest
from geometry_msgs.msg import Point
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import PointCloud2, PointField
from shape_msgs.msg import Mesh
from visualization_msgs.msg import Marker

from cloth_sim_ros.ros.outputs import cdr

FRAMES = ["", "w", "world", "a_longer_frame"]  # of every alignment
RANDOM = np.random.default_rng(1)


@pytest.mark.parametrize("frame", FRAMES)
@pytest.mark.parametrize(("normals", "velocities"), [(False, False), (True, False), (False, True), (True, True)])
def test_particle_cloud(frame, normals, velocities):
    names = cdr.cloud_fields(normals, velocities)
    values = RANDOM.normal(size=(37, len(names))).astype(np.float32)
    patched = cdr.particle_cloud(frame, 37, names)
    patched.payload[:] = values
    message = deserialize_message(patched.stamped((12, 345)), PointCloud2)
    assert (message.header.frame_id, message.header.stamp.sec, message.header.stamp.nanosec) == (frame, 12, 345)
    assert (message.height, message.width, message.point_step, message.row_step) == (
        1,
        37,
        4 * len(names),
        148 * len(names),
    )
    assert message.is_dense and not message.is_bigendian
    assert [(f.name, f.offset, f.datatype, f.count) for f in message.fields] == [
        (name, 4 * k, PointField.FLOAT32, 1) for k, name in enumerate(names)
    ]
    assert bytes(message.data) == values.tobytes()


@pytest.mark.parametrize("frame", FRAMES)
@pytest.mark.parametrize(("name", "width"), [("cloth", None), ("rope_1", 0.01), ("a", None)])
def test_marker(frame, name, width):
    points = RANDOM.normal(size=(33, 3))
    patched = cdr.mesh_marker(frame, name, width, 33)
    patched.payload[:] = points
    message = deserialize_message(patched.stamped((7, 8)), Marker)
    assert (message.header.frame_id, message.ns, message.header.stamp.sec) == (frame, name, 7)
    assert message.type == (Marker.TRIANGLE_LIST if width is None else Marker.LINE_STRIP)
    assert message.scale.x == (1.0 if width is None else width)
    assert message.pose.orientation.w == 1.0 and message.color.a == 1.0
    assert [(p.x, p.y, p.z) for p in message.points] == [tuple(p) for p in points.tolist()]
    again = deserialize_message(patched.stamped((7, 8)), Marker)
    again.points = [Point(x=p[0], y=p[1], z=p[2]) for p in points.tolist()]
    assert again == message  # nothing after the points has shifted


@pytest.mark.parametrize("count", [0, 1, 2, 3, 4])
def test_topology(count):
    triangles = RANDOM.integers(0, 5, (count, 3))
    vertices = RANDOM.normal(size=(5, 3))
    message = deserialize_message(cdr.topology_mesh(triangles, vertices), Mesh)
    assert [list(t.vertex_indices) for t in message.triangles] == triangles.tolist()
    assert [[v.x, v.y, v.z] for v in message.vertices] == vertices.tolist()
