# SPDX-License-Identifier: Apache-2.0
"""What a rope pulls with, seen from another process: the tension along it and the load on its ends."""

import numpy as np
import pytest
from client import fields
from geometry_msgs.msg import WrenchStamped
from sensor_msgs.msg import PointCloud2

G, MASS, SEGMENTS = 9.81, 0.3, 8
HANGING = """
cloth_sim:
  ros__parameters:
    objects: [rope, sheet]
    rope: {type: rope, segments: 8, start: [0, 0, 1], end: [0, 0, 0], mass: 0.3, stretch_compliance: 1.0e-4}
    sheet: {type: cloth, resolution: [3, 3]}
    solver: {substeps: 5, global_damping: 8.0}
    publish: {tensions: true}
"""


def test_tension_of_the_segment_behind_each_particle(start, client):
    start(HANGING).ready()
    clouds = client.listen(PointCloud2, "/cloth_sim/rope/particles", 1)
    sheets = client.listen(PointCloud2, "/cloth_sim/sheet/particles", 1)
    client.until(lambda: clouds and sheets)
    client.spin(2.5)
    assert [field.name for field in clouds[-1].fields] == ["x", "y", "z", "tension"]
    expected = G * MASS * (1.0 - (np.arange(SEGMENTS) + 0.5) / SEGMENTS)
    tension = fields(clouds[-1])[:, 3]
    assert tension[:-1] == pytest.approx(expected, rel=2e-3)
    assert tension[-1] == tension[-2]
    assert [field.name for field in sheets[-1].fields] == ["x", "y", "z"]


def test_wrench_on_what_holds_the_start(start, client):
    start(HANGING).ready()
    starts = client.listen(WrenchStamped, "/cloth_sim/rope/start/wrench", 1)
    ends = client.listen(WrenchStamped, "/cloth_sim/rope/end/wrench", 1)
    client.until(lambda: starts and ends)
    client.spin(2.5)
    wrench, header = starts[-1].wrench, starts[-1].header
    assert wrench.force.z == pytest.approx(-G * MASS, rel=2e-3)
    assert abs(wrench.force.x) + abs(wrench.force.y) + abs(wrench.torque.x) + abs(wrench.torque.y) < 1e-3
    assert header.frame_id == "world" and header.stamp.sec > 0
    assert ends[-1].wrench.force.z == 0.0


CLAMPED = """
cloth_sim:
  ros__parameters:
    objects: [rope]
    gravity: [0.0, 0.0, 0.0]
    rope: {type: rope, segments: 10, pins: [0, 1, 9, 10], bending: angle, twist: true, twist_compliance: 20.0}
"""


def test_a_turned_end_loads_both_clamps(start, client):
    start(CLAMPED).ready()
    ends = client.listen(WrenchStamped, "/cloth_sim/rope/end/wrench", 1)
    assert client.set("rope.end_turn", np.pi / 2).successful
    client.until(lambda: ends and ends[-1].wrench.torque.x != 0.0)
    assert ends[-1].wrench.torque.x == pytest.approx(-np.pi / 2 / 20.0 / 0.8, rel=1e-3)  # GJ angle / free length
