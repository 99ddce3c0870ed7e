# SPDX-License-Identifier: Apache-2.0
"""Files that are no mesh get one sentence, the other objects go on, and no request waits for a reader."""

import os
import subprocess

import numpy as np
import pytest
from client import fields, finite
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from sensor_msgs.msg import PointCloud2
from std_srvs.srv import Trigger

trimesh = pytest.importorskip("trimesh")

SQUARE = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\n"
PLY = """ply
format ascii 1.0
element vertex 4
property float x
property float y
property float z
element face 2
property list uchar {kind} vertex_indices
end_header
0 0 0
1 0 0
0 1 0
1 1 0
3 0 1 {index}
3 1 3 2
"""
BROKEN = {
    "flat.obj": (SQUARE + "v 0.5 0 0\nf 1 1 2\nf 1 5 2\n", "has no triangle with an area"),
    "crossed.obj": (
        SQUARE + "v 2 0 0\nf 1 4 2 5 3\n",
        "has a polygon of 5 corners that crosses or overlaps itself; allowed",
    ),
    "negative.ply": (PLY.format(kind="int", index=-2), "has face 0 of vertices [0, 1, -2]; allowed are 0 to 3"),
    "fraction.ply": (PLY.format(kind="float", index=1.5), "names its vertices by decimals; allowed are whole numbers"),
    "fraction.obj": (SQUARE + "f 1.5 2 3\n", "cannot be read as a triangle mesh"),
    "beyond.obj": (SQUARE + "f 1 2 9\n", "has face 0 of vertices [0, 1, 8]; allowed are 0 to 3"),
    "far.obj": (SQUARE.replace("1 1 0", "1e9 1 0") + "f 1 2 3\nf 2 4 3\n", "has vertex 3 at [1000000000.0, 1.0, 0.0]"),
    "nan.obj": (SQUARE.replace("1 1 0", "nan 1 0") + "f 1 2 3\nf 2 4 3\n", "has vertex 3 at [nan, 1.0, 0.0]"),
    "picture.png": ("\x89PNG", "cannot be read as a triangle mesh"),
    "words": ("hello", "cannot be read as a triangle mesh"),
    "fins.obj": (SQUARE + "v 0 0 1\nf 1 2 3\nf 1 2 4\nf 1 2 5\n", "has 3 triangles at edge 0-1"),
}
SPECIAL = {
    "folder": "cannot be read: a folder is there, and no regular file",
    "fifo.obj": "cannot be read: a FIFO is there, and no regular file",
    "large.obj": "has 67 MB; allowed are at most 67 MB",
    "n" * 5000 + ".obj": "cannot be read: File name too long",
    "nowhere.obj": "no such file is in",
}


def test_each_gets_its_sentence_and_the_others_fall(start, client, tmp_path):
    files = {}
    for name, (text, sentence) in BROKEN.items():
        files[name] = sentence
        (tmp_path / name).write_text(text, encoding="latin-1")
    (tmp_path / "folder").mkdir()
    os.mkfifo(tmp_path / "fifo.obj")
    with (tmp_path / "large.obj").open("wb") as file:
        file.truncate((64 << 20) + 1)
    names = {f"bad{chr(97 + k)}": (name, sentence) for k, (name, sentence) in enumerate({**files, **SPECIAL}.items())}
    text = f"/**:\n  ros__parameters:\n    objects: [rope, {', '.join(names)}]\n    rope: {{type: rope, segments: 8}}\n"
    text += "".join(f"    {name}: {{mesh: '{tmp_path / path}'}}\n" for name, (path, _) in names.items())
    node = start(text).ready()
    assert "simulating rope (9 particles) on" in node.log and "Traceback" not in node.log
    lines = node.log.splitlines()
    for name, (path, sentence) in names.items():
        said = [line for line in lines if f" {name}" in line and "it is left out until that is mended" in line]
        assert len(said) == 1 and sentence in said[0] and len(said[0]) < 400, (path, said)
    clouds = client.listen(PointCloud2, "/cloth_sim/rope/particles", 1)
    client.until(lambda: clouds and fields(clouds[-1])[-1, 2] < 0.5)
    assert finite(clouds[-1])


GARMENTS = """
/**:
  ros__parameters:
    objects: [towel, sheet, apron]
    towel: {{mesh: '{folder}/towel.obj', material: cotton}}
    sheet: {{mesh: '{folder}/large.obj'}}
    apron: {{mesh: '{folder}/large.obj', scale: 0.001}}
"""


def test_what_a_garment_lacks_is_told_and_its_unit_can_be_set(start, client, tmp_path, monkeypatch):
    monkeypatch.setenv("ROS_HOME", str(tmp_path / "home"))
    (tmp_path / "towel.obj").write_text(SQUARE + "v 0 0 0\nf 1 2 4 3\nf 1 5 2\n")
    (tmp_path / "large.obj").write_text(SQUARE.replace("1", "884") + "f 1 2 4 3\n")
    node = start(GARMENTS.format(folder=tmp_path)).ready()
    (told,) = (line for line in node.log.splitlines() if "towel.mesh is" in line)
    assert told.startswith("[WARN]") and "/towel.obj', which has 1 of 3 triangles without an area, which are" in told
    assert node.log.count("sheet is 884 m across; a mesh in millimetres takes a scale of 0.001") == 1
    assert "apron is 884" not in node.log
    assert client.get("towel.mass") == pytest.approx(0.13)
    clouds = client.listen(PointCloud2, "/cloth_sim/apron/particles", 1)
    client.until(lambda: clouds)
    assert np.ptp(fields(clouds[-1])[:, 0]) == pytest.approx(0.884, rel=1e-3)
    assert "acts only where sheet.mesh names a file" not in client.set("sheet.scale", 0.001).reason
    client.until(lambda: node.log.count("simulating ") == 2)
    for service in ("save", "load"):
        answer = client.call(Trigger, f"/cloth_sim/{service}")
        assert answer.success, answer.message
    assert client.get("apron.scale") == 0.001, "a state has no unit"
    assert "Traceback" not in node.log


@pytest.fixture
def large(tmp_path):
    """large(n) -> the path of a mesh of n x n vertices in a text format, which takes long to read."""

    def write(n):
        grid = np.arange(n * n).reshape(n, n)
        a, b, c, d = (part.ravel() for part in (grid[:-1, :-1], grid[:-1, 1:], grid[1:, :-1], grid[1:, 1:]))
        x, y = np.meshgrid(np.linspace(0, 1, n), np.linspace(0, 1, n))
        points = np.column_stack([x.ravel(), y.ravel(), 0 * x.ravel()])
        triangles = np.concatenate([np.column_stack([a, b, c]), np.column_stack([b, d, c])])
        file = tmp_path / "large.off"
        trimesh.Trimesh(points, triangles, process=False).export(file)
        assert file.stat().st_size > 4 << 20
        return str(file)

    return write


MESH_AND_ROPE = """
/**:
  ros__parameters:
    objects: [sheet, rope]
    rope: {type: rope, segments: 8}
    sheet: {pins: none}
"""


def ask_for_mesh(client, path):
    """The answer to come of a request that sets the sheet's mesh."""
    service = client.service(SetParameters, "/cloth_sim/set_parameters")
    return service.call_async(
        SetParameters.Request(parameters=[Parameter("sheet.mesh", value=path).to_parameter_msg()])
    )


@pytest.mark.long
def test_no_request_waits_for_a_mesh_to_be_read(start, client, large):
    start(MESH_AND_ROPE).ready()
    clouds = client.listen(PointCloud2, "/cloth_sim/rope/particles", 10)
    assert client.get("rate") == 60.0
    read, answered = ask_for_mesh(client, large(330)), 0
    for _ in range(3):
        assert client.get("rate") == 60.0
        answered += not read.done()
    client.until(read.done, timeout=60.0)
    assert read.result().results[0].successful, read.result().results[0].reason
    assert answered == 3, "questions were answered while the mesh was read"
    assert len(clouds) > 10, "the rope went on"
    sheet = client.listen(PointCloud2, "/cloth_sim/sheet/particles", 1)
    client.until(lambda: sheet and sheet[-1].width == 330 * 330, timeout=90.0)


def test_a_node_that_ends_leaves_no_reader_behind(start, client, large, tmp_path):
    node = start(MESH_AND_ROPE).ready()
    path = large(600)
    read = ask_for_mesh(client, path)

    def readers():
        lines = subprocess.run(
            ["ps", "-eww", "-o", "args"], capture_output=True, text=True, check=True
        ).stdout.splitlines()
        return [line for line in lines if "mesh_file" in line and path in line]

    client.until(lambda: readers() or read.done())
    assert readers()
    assert node.end() == 0 and "Traceback" not in node.log
    assert not readers()


@pytest.mark.long
def test_places_far_away_are_refused_and_the_farthest_is_simulated(start, client):
    start("/**:\n  ros__parameters:\n    objects: [rope]\n    colliders: [ball]\n    rope: {type: rope}\n").ready()
    refused = client.set("rope.position", [1e6, 0.0, 0.0])
    allowed = "allowed is 3 finite numbers from -10000 to 10000 [m]"
    assert (refused.successful, refused.reason) == (False, f"rope.position is [1000000.0, 0.0, 0.0]; {allowed}")
    assert client.set("ball.position", [0.0, 0.0, -20000.0]).reason.endswith(allowed)
    assert client.set("rope.position", [1e4, 1e4, -1e4]).successful
    clouds = client.listen(PointCloud2, "/cloth_sim/rope/particles", 1)
    client.until(lambda: clouds and fields(clouds[-1])[0, 0] > 9e3)
    client.until(lambda: fields(clouds[-1])[-1, 2] < -1e4 + 0.5)  # it swings from the height of its start, 1 m
    assert fields(clouds[-1])[0, :3] == pytest.approx((1e4, 1e4, -1e4 + 1.0), abs=1e-2)
