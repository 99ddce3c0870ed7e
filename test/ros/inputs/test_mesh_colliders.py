# SPDX-License-Identifier: Apache-2.0
"""Colliders from files on a real node: cloth lies on them, viewers are told their file, and bad files are refused."""

import numpy as np
import pytest
from client import LATCHED, fields
from geometry_msgs.msg import WrenchStamped
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from sensor_msgs.msg import PointCloud2
from visualization_msgs.msg import Marker, MarkerArray

trimesh = pytest.importorskip("trimesh")

SCENE = """
/**:
  ros__parameters:
    objects: [sheet]
    colliders: [table, volume, broken]
    sheet: {{resolution: [8, 8], size: [0.4, 0.4], pins: none, position: [0, 0, 0.06], thickness: 0.01}}
    solver: {{global_damping: 2.0}}
    table: {{shape: mesh, mesh: '{folder}/table.stl', scale: 0.001}}
    volume: {{shape: signed_distance, mesh: 'file://{folder}/ball.npz', position: [3, 0, 0]}}
    broken: {{shape: mesh, mesh: '{folder}/open.stl'}}
"""


@pytest.fixture
def room(start, tmp_path):
    trimesh.creation.box((600, 600, 100)).export(tmp_path / "table.stl")
    trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]]).export(tmp_path / "open.stl")
    ball = np.linalg.norm(np.indices((9, 9, 9)) - 4.0, axis=0) - 2.5
    np.savez(tmp_path / "ball.npz", values=0.1 * ball, origin=(-0.4, -0.4, -0.4), spacing=0.1)
    return start(SCENE.format(folder=tmp_path)).ready()


@pytest.mark.long
def test_cloth_lies_on_a_file_and_bad_ones_are_refused(room, client, tmp_path):
    assert "broken: Mesh of '" in room.log and "is open at 3 edges" in room.log
    assert "it is left out until that is mended" in room.log
    clouds = client.listen(PointCloud2, "/cloth_sim/sheet/particles", 1)
    wrenches = client.listen(WrenchStamped, "/cloth_sim/colliders/table/wrench", 1)
    client.until(lambda: clouds and np.ptp(fields(clouds[-1])[:, 2]) < 1e-3 and fields(clouds[-1])[0, 2] < 0.0601)
    assert fields(clouds[-1])[:, 2].min() == pytest.approx(0.06, abs=1e-4)
    client.until(lambda: wrenches and abs(wrenches[-1].wrench.force.z + 0.2 * 9.81) < 0.005 * 0.2 * 9.81)
    shown = client.listen(MarkerArray, "/cloth_sim/colliders", LATCHED)
    client.until(lambda: shown)
    drawn = {each.ns: each for each in shown[-1].markers[1:]}
    assert drawn["table"].type == Marker.MESH_RESOURCE and drawn["volume"].type == Marker.CUBE_LIST
    assert drawn["table"].mesh_resource == f"file://{tmp_path}/table.stl" and len(drawn["volume"].points) > 50

    def set_parameter(name, value):
        request = SetParameters.Request(parameters=[Parameter(name, value=value).to_parameter_msg()])
        return client.call(SetParameters, "/cloth_sim/set_parameters", request).results[0]

    refused = set_parameter("table.mesh", "/nowhere.stl")
    assert not refused.successful
    assert refused.reason.startswith("table.mesh is '/nowhere.stl'; no such file is in '/'; allowed are .obj, ")
    assert "table.dimensions has no effect on a mesh" in set_parameter("table.dimensions", [1.0]).reason
    assert set_parameter("table.scale", 0.002).successful  # its top rises by 5 cm, through the sheet
    client.until(lambda: fields(clouds[-1])[:, 2].min() > 0.109, 60.0)
    assert room.alive() and "Traceback" not in room.log
