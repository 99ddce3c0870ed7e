# SPDX-License-Identifier: Apache-2.0
"""Readers of meshes get regular files of bounded size alone, and of what those name only buffers of .gltf."""

import base64
import json
import os
import struct
import subprocess
import sys
import zipfile

import numpy as np
import pytest
from patience import patience

from cloth_sim_ros.parameters import shown
from cloth_sim_ros.sim import SignedDistance
from cloth_sim_ros.sim.mesh_file import load_mesh

trimesh = pytest.importorskip("trimesh")

SQUARE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3\nf 1 3 4\n"
CORNERS = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], "<f4").tobytes()
FACES = np.array([0, 1, 2, 0, 2, 3], "<u2").tobytes()


def refusal(path):
    with pytest.raises(ValueError) as error:
        load_mesh(str(path), "it.mesh")
    assert "\n" not in str(error.value) and len(str(error.value)) < 400
    return str(error.value)


def test_a_file_that_is_not_there_is_told_with_its_folder_and_the_formats(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    ends = "allowed are .obj, .off, .ply, .stl, .glb and what else trimesh reads"
    assert refusal("shrit.obj") == f"it.mesh is 'shrit.obj'; no such file is in {shown(str(tmp_path))}; {ends}"
    (tmp_path / "shirt.obj").write_text(SQUARE)
    for folder in ("meshs", "shirt.obj"):
        told = f"no such file is in {shown(str(tmp_path / folder))}, which is no folder; {ends}"
        assert refusal(f"{folder}/shirt.obj") == f"it.mesh is '{folder}/shirt.obj'; {told}"


def gltf(buffer, count=4):
    """A scene of one square, whose numbers are in `buffer`."""
    views = [{"buffer": 0, "byteOffset": k, "byteLength": n} for k, n in ((0, 48), (48, 12))]
    points = {"bufferView": 0, "componentType": 5126, "count": count, "type": "VEC3"}
    if buffer is None:  # what is not said is 0
        del points["bufferView"]
        views = []
    faces = {"bufferView": 1, "componentType": 5123, "count": 6, "type": "SCALAR"}
    primitive = {"attributes": {"POSITION": 0}, **({"indices": 1} if views else {})}
    return {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [primitive]}],
        "accessors": [points, faces] if views else [points],
        "bufferViews": views,
        "buffers": [{"byteLength": 60, **buffer}] if buffer else [{"byteLength": 4}],
    }


def printed(code, file):
    """What `code` prints about a file, in a process of its own: it might wait for ever."""
    head = (
        "import sys; from cloth_sim_ros.sim import SignedDistance\nfrom cloth_sim_ros.sim.mesh_file import load_mesh\n"
    )
    command = [sys.executable, "-c", head + code, str(file)]
    return subprocess.run(command, timeout=patience(120), capture_output=True, text=True).stdout


def test_no_fifo_holds_a_reader_up(tmp_path):
    (tmp_path / "it.obj").write_text("mtllib it.mtl\nusemtl a\n" + SQUARE)
    for name in ("it.mtl", "fifo.npz"):
        os.mkfifo(tmp_path / name)
    assert printed("print(len(load_mesh(sys.argv[1], 'it')[1]))", tmp_path / "it.obj") == "2\n"
    told = printed(
        "try: SignedDistance.from_file(sys.argv[1])\nexcept ValueError as error: print(error)", tmp_path / "fifo.npz"
    )
    assert "fifo.npz', which cannot be read: a FIFO is there, and no regular file" in told


def test_what_is_no_regular_file_is_refused(tmp_path):
    os.mkfifo(tmp_path / "fifo.obj")
    (tmp_path / "folder.obj").mkdir()
    assert "cannot be read: a FIFO is there, and no regular file" in refusal(tmp_path / "fifo.obj")
    assert "cannot be read: a folder is there, and no regular file" in refusal(tmp_path / "folder.obj")
    try:
        os.mknod(tmp_path / "device.obj", 0o020666, os.makedev(1, 3))
    except PermissionError:
        return  # it takes root
    assert "cannot be read: a device is there, and no regular file" in refusal(tmp_path / "device.obj")


def test_buffers_of_gltf_are_found_and_bounded(tmp_path):
    file = tmp_path / "it.gltf"
    text = base64.b64encode(CORNERS + FACES).decode()
    for uri in ("it.bin", f"data:application/octet-stream;base64,{text}"):
        (tmp_path / "it.bin").write_bytes(CORNERS + FACES)
        file.write_text(json.dumps(gltf({"uri": uri})))
        vertices, triangles = load_mesh(str(file), "it.mesh")
        assert len(vertices) == 4 and len(triangles) == 2
    (tmp_path / "it.bin").unlink()
    os.mkfifo(tmp_path / "it.bin")
    file.write_text(json.dumps(gltf({"uri": "it.bin"})))
    assert "cannot be read as a triangle mesh: " in refusal(file)
    (tmp_path / "it.bin").unlink()
    with (tmp_path / "it.bin").open("wb") as large:
        large.truncate((64 << 20) + 1)
    file.write_text(json.dumps(gltf({"uri": "it.bin"}), indent=1))
    assert "it.bin has more than 67 MB" in refusal(file)


def test_a_few_bytes_do_not_ask_for_all_memory(tmp_path):
    text = json.dumps(gltf(None, 10**9)).encode()
    text += b" " * (-len(text) % 4)
    parts = struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", 4, 0x004E4942) + b"\0" * 4
    (tmp_path / "it.glb").write_bytes(b"glTF" + struct.pack("<II", 2, 12 + len(parts)) + parts)
    assert "cannot be read as a triangle mesh: 'Unable to allocate 11.2 GiB" in refusal(tmp_path / "it.glb")


def test_what_unpacks_to_more_is_refused_before_it_is_unpacked(tmp_path):
    with zipfile.ZipFile(tmp_path / "it.3mf", "w", zipfile.ZIP_DEFLATED) as box:
        box.writestr("3D/3dmodel.model", bytes((64 << 20) + 1))
    assert (tmp_path / "it.3mf").stat().st_size < 100_000
    assert "unpacks to 67 MB; allowed are at most 67 MB" in refusal(tmp_path / "it.3mf")
    (tmp_path / "it.tar.gz").write_bytes(b"\x1f\x8b")
    assert "is packed; allowed are meshes as they are, not .binvox, .bz2, .gz" in refusal(tmp_path / "it.tar.gz")
    np.savez_compressed(tmp_path / "it.npz", values=np.zeros((1 << 24) + (1 << 16)), origin=np.zeros(3), spacing=1.0)
    with pytest.raises(ValueError, match="which cannot be read: it has arrays of more than 16777216 values"):
        SignedDistance.from_file(str(tmp_path / "it.npz"))


def test_robots_that_never_end_are_refused(tmp_path):
    pytest.importorskip("yourdfpy")
    file = tmp_path / "it.urdf"
    collision = '<collision><geometry><mesh filename="it.urdf#a"/></geometry></collision>'
    file.write_text(f'<robot name="r"><link name="a">{collision}</link></robot>')
    assert "which has a robot as a mesh of its link 'a'; allowed are files of meshes" in refusal(f"{file}#a")
    laughs = "".join(f'<!ENTITY l{k + 1} "{10 * f"&l{k};"}">' for k in range(9))
    file.write_text(f'<!DOCTYPE r [<!ENTITY l0 "ha">{laughs}]><robot name="&l9;"><link name="a"/></robot>')
    assert "cannot be read as a triangle mesh: " in refusal(f"{file}#a")
    file.unlink()
    os.mkfifo(file)
    assert "cannot be read: a FIFO is there, and no regular file" in refusal(f"{file}#a")


BOM = b"\xef\xbb\xbf"


def ends_of(folder, name, content):
    """What a refusal says of a file of `content`, after its name."""
    (folder / name).write_bytes(content)
    return refusal(folder / name).split(", which ", 1)[1]


def test_a_byte_order_mark_takes_nothing_along(tmp_path):
    files = {"it.obj": SQUARE + "v 0 9 9\n", "it.off": "OFF\n4 1 0\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n4 0 1 2 3\n"}
    uri = f"data:application/octet-stream;base64,{base64.b64encode(CORNERS + FACES).decode()}"
    files["it.gltf"] = json.dumps(gltf({"uri": uri}))
    for name, text in files.items():
        (tmp_path / name).write_bytes(BOM + text.encode())
        vertices, triangles = load_mesh(str(tmp_path / name), "it.mesh")
        assert vertices.tolist() == [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], name
        assert triangles.tolist() == [[0, 1, 2], [0, 2, 3]], name
    box = trimesh.creation.box((1.0, 1.0, 1.0)).export(file_type="stl")
    (tmp_path / "it.stl").write_bytes(BOM + box[3:])  # the first bytes of a binary file are anything
    assert len(load_mesh(str(tmp_path / "it.stl"), "it.mesh")[1]) == 12


@pytest.mark.parametrize("name", ["it.obj", "it.stl", "it.ply", "it.off", "it.glb", "it.gltf"])
def test_an_empty_file_is_told(tmp_path, name):
    assert ends_of(tmp_path, name, b"") == "is empty"


def test_a_file_that_is_cut_off_is_told_with_what_is_missing(tmp_path):
    unread = "cannot be read as a triangle mesh: it is cut off"
    box = trimesh.creation.box((1.0, 1.0, 1.0))
    binary, text = box.export(file_type="stl"), box.export(file_type="stl_ascii").encode()
    size = "as it has 654 bytes, where a binary one of 12 triangles has 684"
    assert ends_of(tmp_path, "it.stl", binary[:-30]) == f"{unread} or no .stl file, {size}"
    assert ends_of(tmp_path, "it.stl", text[: len(text) // 2]) == f"{unread}, as its last solid has no endsolid"
    twice = text + text[: len(text) // 2]
    assert ends_of(tmp_path, "it.stl", twice) == f"{unread}, as its last solid has no endsolid"
    off = box.export(file_type="off").encode()
    ending = f"{unread}, as it has 18 of 20 lines of vertices and faces"
    assert ends_of(tmp_path, "it.off", b"\n".join(off.splitlines()[:-2])) == ending
    ply = box.export(file_type="ply", encoding="ascii")
    lines = ply.splitlines()
    assert ends_of(tmp_path, "it.ply", b"\n".join(lines[:-5]) + b"\n") == f"{unread}, as it has 7 of 12 faces"
    assert ends_of(tmp_path, "it.ply", b"\n".join(lines[:-15]) + b"\n") == f"{unread}, as it has 5 of 8 vertices"
    assert ends_of(tmp_path, "it.glb", box.export(file_type="glb")[:200]).startswith(
        f"{unread}, damaged or no .glb file: 'Unterminated string"
    )
    assert ends_of(tmp_path, "it.gltf", b'{"asset": ').startswith(f"{unread}, damaged or no .gltf file: 'Expecting")


def test_what_a_reader_of_its_own_trips_over_is_not_told_in_its_words(tmp_path):
    points = trimesh.PointCloud(np.eye(3)).export(file_type="ply")
    assert ends_of(tmp_path, "it.ply", points) == "holds no triangles"
    wanted = "cannot be read as a triangle mesh: it is cut off, damaged or no .gltf file"
    assert ends_of(tmp_path, "it.gltf", b"[]") == wanted
    text = SQUARE.encode()
    assert ends_of(tmp_path, "it.obj", text.replace(b" 0\n", b"\n")) == "has vertex 0 of 2 coordinates; allowed are 3"
    assert ends_of(tmp_path, "it.obj", text.replace(b"1 1 0", b"1")) == "has vertex 2 of 1 coordinate; allowed are 3"
    off = b"OFF\n3 1 0\n0 0 0\n1 0\n1 1 0\n3 0 1 2\n"
    assert ends_of(tmp_path, "it.off", off) == "has vertex 1 of 2 coordinates; allowed are 3"
