# SPDX-License-Identifier: Apache-2.0
"""Outgoing messages as serialised bytes, of which only the stamp and the payload change from frame to frame.

Building a message of 60,000 points in Python takes 170 ms; overwriting the points in bytes serialised once takes under
2 ms. Middleware bytes are CDR, little-endian: 4 bytes of encapsulation, then the fields, a header's stamp first.
"""

from __future__ import annotations

import array
import struct

import numpy as np
from builtin_interfaces.msg import Duration
from geometry_msgs.msg import Point, Vector3
from rclpy.serialization import serialize_message
from sensor_msgs.msg import PointCloud2, PointField
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker

ENCAPSULATION = b"\x00\x01\x00\x00"
STAMP_AT = 4
_SENTINEL = -1.2345678901234567e-89  # a coordinate that no other field of a message holds


class PatchedBytes:
    """One serialised message; `payload` is a writable view of its numbers, `stamped` returns the bytes to publish."""

    def __init__(self, serialised: bytes | bytearray, offset: int, shape: tuple[int, int], dtype: str):
        self._buffer = bytearray(serialised)
        count = shape[0] * shape[1]
        self.payload = np.frombuffer(self._buffer, dtype, count, offset).reshape(shape)

    def stamped(self, stamp: tuple[int, int]) -> bytes:
        """Return the message as bytes with the header's stamp (seconds, nanoseconds)."""
        struct.pack_into("<iI", self._buffer, STAMP_AT, *stamp)
        return bytes(self._buffer)


def cloud_fields(normals: bool, velocities: bool, tensions: bool = False) -> list[str]:
    """Return the names of the float32 fields of a particle, in order."""
    names = ["x", "y", "z"]
    if normals:
        names += ["normal_x", "normal_y", "normal_z"]
    if velocities:
        names += ["vx", "vy", "vz"]
    if tensions:
        names += ["tension"]
    return names


def particle_cloud(frame_id: str, count: int, fields: list[str]) -> PatchedBytes:
    """Return an unordered PointCloud2 of `count` particles; its payload is (count, len(fields)) float32."""
    message = PointCloud2(header=Header(frame_id=frame_id), height=1, width=count, is_dense=True)
    message.fields = [
        PointField(name=name, offset=4 * k, datatype=PointField.FLOAT32, count=1) for k, name in enumerate(fields)
    ]
    message.point_step = 4 * len(fields)
    message.row_step = message.point_step * count
    message.data = array.array("B", bytes(message.row_step))
    message.data[:4] = array.array("B", b"\xa5\x5a\xc3\x3c")
    serialised = serialize_message(message)
    return PatchedBytes(serialised, serialised.rindex(b"\xa5\x5a\xc3\x3c"), (count, len(fields)), "<f4")


def mesh_marker(frame_id: str, name: str, rope_width: float | None, count: int) -> PatchedBytes:
    """Return a Marker named `name` of `count` points, payload (count, 3) float64 [m].

    Without a `rope_width` the points are the corners of triangles, else they are a strip of that width [m]. The message
    is grown from one of a single point: a point is 24 bytes, a multiple of the strictest alignment, so the fields
    behind the points keep their alignment.
    """
    marker = Marker(header=Header(frame_id=frame_id), ns=name, id=0, action=Marker.ADD, lifetime=Duration())
    if rope_width is None:
        marker.type, marker.scale = Marker.TRIANGLE_LIST, Vector3(x=1.0, y=1.0, z=1.0)
        marker.color = ColorRGBA(r=0.25, g=0.55, b=0.85, a=1.0)
    else:
        marker.type, marker.scale = Marker.LINE_STRIP, Vector3(x=rope_width)
        marker.color = ColorRGBA(r=0.85, g=0.6, b=0.25, a=1.0)
    marker.pose.orientation.w = 1.0
    serialised = []
    for points in range(1, 4):
        marker.points = [Point(x=_SENTINEL, y=_SENTINEL, z=_SENTINEL)] * points
        serialised.append(serialize_message(marker))
    one = serialised[0]
    points_at = one.index(struct.pack("<d", _SENTINEL))
    # The number of points comes right before them, or before 4 bytes of padding, whose content is arbitrary.
    count_at = next(
        at
        for at in (points_at - 4, points_at - 8)
        if all(struct.unpack_from("<I", each, at)[0] == k for k, each in enumerate(serialised, 1))
    )
    grown = bytearray(one[:points_at]) + bytes(24 * count) + one[points_at + 24 :]
    struct.pack_into("<I", grown, count_at, count)
    return PatchedBytes(grown, points_at, (count, 3), "<f8")


def topology_mesh(triangles: np.ndarray, vertices: np.ndarray) -> bytes:
    """Return a serialised shape_msgs/Mesh of `triangles` (T, 3) and rest `vertices` (N, 3) [m].

    Its layout is simple enough to write down: two sequences of uint32[3] and float64[3].
    """
    body = struct.pack("<I", len(triangles)) + np.ascontiguousarray(triangles, "<u4").tobytes()
    body += struct.pack("<I", len(vertices))
    body += bytes(-len(body) % 8) + np.ascontiguousarray(vertices, "<f8").tobytes()
    return ENCAPSULATION + body
