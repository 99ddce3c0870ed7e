# SPDX-License-Identifier: Apache-2.0
"""Cuts by topic, seen from another process: cloud, mesh and topology follow, and what is no cut is told."""

import math

import numpy as np
import pytest
from client import LATCHED, fields
from geometry_msgs.msg import Point32, PolygonStamped
from sensor_msgs.msg import PointCloud2
from shape_msgs.msg import Mesh
from std_srvs.srv import Trigger
from visualization_msgs.msg import Marker

SHEET = """
/**:
  ros__parameters:
    objects: [sheet, whole]
    sheet: {type: cloth, resolution: [8, 9], size: [0.7, 0.8], position: [0, 0, 2],
            orientation: [0.7071068, 0, 0, 0.7071068], pins: top, tear_strain: 0.5, damping: 0.01}
    whole: {type: cloth, resolution: [4, 4], position: [3, 0, 2]}
    solver: {substeps: 10}
"""


def across(height, width=1.0, frame="world"):
    """A level cut through all that hangs."""
    message = PolygonStamped()
    message.header.frame_id = frame
    corners = ((-width, -1), (width, -1), (width, 1), (-width, 1))
    message.polygon.points = [Point32(x=float(x), y=float(y), z=float(height)) for x, y in corners]
    return message


@pytest.fixture
def hung(start, client):
    """A node whose sheet hangs by its upper edge, and what it sends."""
    node = start(SHEET).wait_for("all kernels are compiled")
    node.clouds = client.listen(PointCloud2, "/cloth_sim/sheet/particles", 1)
    node.meshes = client.listen(Marker, "/cloth_sim/sheet/mesh", 1)
    node.topologies = client.listen(Mesh, "/cloth_sim/sheet/topology", LATCHED)
    node.knife = client.node.create_publisher(PolygonStamped, "/cloth_sim/cut", 10)  # a cut must not be lost
    client.until(lambda: node.clouds and node.meshes and node.topologies and node.knife.get_subscription_count())
    node.cut = node.knife.publish
    return node


@pytest.mark.long
def test_a_cut_drops_what_is_below_it_and_reset_mends(hung, client):
    assert len(hung.topologies[-1].triangles) == 2 * 7 * 8
    hung.cut(across(1.95))
    hung.wait_for("a cut goes through 22 springs of sheet", 5.0)  # 8 across it, and 14 diagonals
    lowest = lambda: fields(hung.clouds[-1])[:32, 2]  # noqa: E731 four rows of eight
    client.until(lambda: lowest().max() < 1.0)
    upper = fields(hung.clouds[-1])[32:, 2]
    assert upper.min() > 1.9 and np.ptp(fields(hung.clouds[-1])[:32, 2]) == pytest.approx(0.3, abs=0.02)
    client.until(lambda: len(hung.topologies[-1].triangles) == 2 * 7 * 7)
    client.until(lambda: len(hung.meshes[-1].points) == 3 * 2 * 7 * 7)
    heights = np.array([p.z for p in hung.meshes[-1].points]).reshape(-1, 3)
    assert np.ptp(heights, axis=1).max() < 0.15, "a triangle goes from one part to the other"
    assert client.set("sheet.bending", "dihedral").successful  # what is built anew is torn as before
    hung.wait_for("of its bending rigidity acts")  # once the kernels of plates are compiled
    client.spin(0.5)
    assert lowest().max() < 1.0 and len(hung.topologies[-1].triangles) == 2 * 7 * 7
    assert client.call(Trigger, "/cloth_sim/reset").success
    client.until(lambda: len(hung.topologies[-1].triangles) == 2 * 7 * 8)
    client.spin(0.5)
    assert lowest().min() > 1.5


def test_what_is_no_cut_is_told_and_cuts_nothing(hung, client):
    hung.cut(across(math.nan))
    hung.wait_for("a message on cut is refused: its corner (-1, -1, nan) is not finite", 5.0)
    hung.cut(across(1.95, frame="arm"))
    hung.wait_for("a message on cut is refused: its frame_id is 'arm'", 5.0)
    hung.cut(across(1.95, width=0.0))
    hung.wait_for("a message on cut is refused: the polygon of a cut has an area of 0 m^2", 5.0)
    hung.cut(PolygonStamped())
    hung.wait_for("a message on cut is refused: its polygon has 0 corners; allowed are 3 or more", 5.0)
    hung.cut(across(0.5))
    hung.wait_for("a cut goes through nothing", 5.0)
    client.spin(0.3)
    assert len(hung.topologies[-1].triangles) == 2 * 7 * 8
    refused = client.set("solver.method", "verlet")
    assert "solver.method is 'verlet' with tear_strain of sheet; allowed is 'auto' or 'xpbd'" in refused.reason
    assert client.set("sheet.tear_strain", 0.0).successful
    hung.wait_for("sheet is computed by")
    client.spin(0.5)
    hung.cut(across(1.95))
    hung.wait_for("no object tears; set the parameter tear_strain of a cloth to more than 0", 5.0)
    assert hung.alive()
