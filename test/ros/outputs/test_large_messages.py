# SPDX-License-Identifier: Apache-2.0
"""Messages far beyond half a megabyte arrive whole, also at a best-effort subscriber with default settings."""

import numpy as np
import pytest
from client import NEWEST_ONLY
from rclpy.serialization import deserialize_message
from std_srvs.srv import SetBool
from visualization_msgs.msg import Marker

SIDE = 128  # 97k corners of triangles, 2.3 MB

LARGE = f"""
cloth_sim:
  ros__parameters:
    objects: [cloth]
    rate: 20.0
    cloth: {{resolution: [{SIDE}, {SIDE}]}}
"""


@pytest.mark.long
def test_a_large_mesh_arrives(start, client):
    start(LARGE).ready()
    client.call(SetBool, "/cloth_sim/pause", SetBool.Request(data=True))  # sends without simulating
    received: list[bytes] = []
    client.node.create_subscription(Marker, "/cloth_sim/cloth/mesh", received.append, NEWEST_ONLY, raw=True)
    client.until(lambda: len(received) >= 20, timeout=30.0)
    stamps = [np.frombuffer(message, "<i4", 2, 4) for message in received]
    times = np.array([sec + 1e-9 * nanosec for sec, nanosec in stamps])
    assert np.median(np.diff(times)) < 0.06  # none is missing as a rule: 0.05 s apart
    marker = deserialize_message(received[-1], Marker)
    assert len(marker.points) == 6 * (SIDE - 1) ** 2
    assert all(np.isfinite((p.x, p.y, p.z)).all() for p in marker.points[::997])
