# SPDX-License-Identifier: Apache-2.0
"""A recording of a real node, exported and read back: the vertices of the bag, and pictures that show them."""

import json
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from node_process import ROOT
from patience import patience
from std_srvs.srv import Trigger
from visualization_msgs.msg import Marker, MarkerArray

from cloth_sim_ros.drawing.tube import SIDES
from cloth_sim_ros.record.bag import Bag

for needed in ("rosbags", "pygltflib", "imageio_ffmpeg"):
    pytest.importorskip(needed)

SCENE = """
/**:
  ros__parameters:
    objects: [cloth, cable]
    colliders: [ball, floor]
    publish: {velocities: true}
    spare_colliders: 2
    cloth: {type: cloth, resolution: [7, 6], size: [0.6, 0.5], pins: corners, position: [0, 0, 1]}
    cable: {type: rope, segments: 8, start: [1, 0, 2], end: [1, 0.1, 1.6], radius: 0.02}
    ball: {shape: sphere, dimensions: [0.15], position: [0, 0, 0.7]}
    floor: {shape: plane}
"""


def crate(number):
    """A box far away from all else."""
    marker = Marker(ns="crate", id=number, type=Marker.CUBE, action=Marker.ADD)
    marker.header.frame_id = "world"
    marker.pose.position.x, marker.pose.orientation.w = -5.0 * number, 1.0
    marker.scale.x = marker.scale.y = marker.scale.z = 0.1
    return marker


@pytest.fixture(scope="module")
def bag(tmp_path_factory, ros):
    """A second of a node whose ball goes up, from its start on."""
    from client import LATCHED, Client
    from node_process import NodeProcess

    folder = tmp_path_factory.mktemp("export")
    node, client = NodeProcess(SCENE, (), folder / "node"), Client()
    try:
        node.ready()
        scene = client.node.create_publisher(MarkerArray, "/cloth_sim/scene", 10)
        client.until(lambda: scene.get_subscription_count() > 0)
        scene.publish(MarkerArray(markers=[crate(1)]))
        markers = client.listen(MarkerArray, "/cloth_sim/colliders", LATCHED)
        client.until(lambda: any(each.ns.startswith("crate") for array in markers for each in array.markers))
        command = [sys.executable, "-m", "cloth_sim_ros.record.recorder", str(folder / "bag")]
        recorder = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True)
        while "Recording into" not in recorder.stdout.readline():
            assert recorder.poll() is None
        assert client.call(Trigger, "/cloth_sim/reset").success
        scene.publish(MarkerArray(markers=[crate(2)]))
        height = [0.7]

        def rise():
            height[0] += 0.001
            client.move("ball", (0.0, 0.0, height[0]))

        end = time.monotonic() + 1.5
        client.until(lambda: height[0] > 0.75 and time.monotonic() > end, timeout=60.0, meanwhile=rise)
        recorder.send_signal(signal.SIGINT)
        recorder.communicate(timeout=patience(60.0))
    finally:
        client.destroy()
        assert node.end() == 0
    assert recorder.returncode == 0
    return folder / "bag"


def export(bag, out, *options, status=0):
    command = [sys.executable, "-m", "cloth_sim_ros.record.export", str(bag), str(out), *options]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == status and "Traceback" not in done.stderr, done.stderr
    return done.stdout + done.stderr


def clouds(bag, name):
    """The positions (N, 3) of an object in each of its clouds."""
    found = [cloud for _, cloud in Bag(bag).clouds(name)]
    return [np.frombuffer(bytes(cloud.data), "<f4").reshape(-1, len(cloud.fields))[:, :3] for cloud in found]


def array(file, accessor):
    """The numbers of an accessor of a glTF file."""
    import pygltflib

    accessor = file.accessors[accessor]
    view = file.bufferViews[accessor.bufferView]
    width = {pygltflib.SCALAR: 1, pygltflib.VEC3: 3, pygltflib.VEC4: 4}[accessor.type]
    kind = np.uint32 if accessor.componentType == pygltflib.UNSIGNED_INT else np.float32
    found = np.frombuffer(file.binary_blob(), kind, accessor.count * width, view.byteOffset)
    return found.reshape(accessor.count, width).squeeze()


def channels(file, node):
    """Path -> values of the keyframes of a node, and the times."""
    motion = file.animations[0]
    found = {each.target.path: motion.samplers[each.sampler] for each in motion.channels if each.target.node == node}
    times = array(file, next(iter(found.values())).input)
    return {path: array(file, sampler.output) for path, sampler in found.items()}, times


@pytest.mark.long
def test_gltf_has_the_vertices_of_the_bag(bag, tmp_path):
    import pygltflib
    import trimesh

    out = tmp_path / "cloth.glb"
    told = export(bag, out, "--rate", "20")
    assert "frames" in told
    assert "colliders that came on ~/scene are left out: crate/1, crate/2\n" in told, "before the recording and in it"
    file = pygltflib.GLTF2().load(str(out))
    nodes = {node.name: at for at, node in enumerate(file.nodes)}
    assert {"cloth", "cable", "ball", "floor", "world"} == set(nodes)
    part = file.meshes[file.nodes[nodes["cloth"]].mesh].primitives[0]
    base = array(file, part.attributes.POSITION)
    frames = np.stack([base, *(base + array(file, target["POSITION"]) for target in part.targets)])
    values, times = channels(file, nodes["cloth"])
    weights = values["weights"].reshape(len(times), -1)
    assert len(frames) == len(times) == weights.shape[1] + 1 and np.allclose(np.diff(times), 0.05, atol=1e-4)
    shown = base + np.einsum("tk,kij->tij", weights, frames[1:] - base)  # as glTF defines it
    recorded = clouds(bag, "cloth")
    far = [min(np.abs(frame - each).max() for each in recorded) for frame in shown]
    assert max(far) < 1e-6 and np.abs(shown[-1] - shown[0]).max() > 0.01, "each frame is one of the bag, and it moves"

    ball, times = channels(file, nodes["ball"])
    heights = ball["translation"][:, 2]
    assert (np.diff(heights) >= 0.0).all() and heights[-1] > 0.72 and np.allclose(ball["rotation"], (0, 0, 0, 1))
    scene = trimesh.load(out)  # another reader, of the first frame: y is up
    assert len(scene.geometry["cloth"].faces) == 2 * 6 * 5
    assert scene.bounds[0][1] == pytest.approx(-0.01, abs=1e-5), "the floor's lower side"
    assert 2.0 - 1e-5 <= scene.bounds[1][1] <= 2.02 + 1e-5, "the rope's upper end"
    assert scene.geometry["cable"].is_watertight
    tube = array(file, file.meshes[file.nodes[nodes["cable"]].mesh].primitives[0].attributes.POSITION)
    rings = tube[: 9 * SIDES].reshape(9, SIDES, 3)
    middles = rings.mean(axis=1)
    assert np.allclose(np.linalg.norm(rings - middles[:, None], axis=2), 0.02, atol=1e-5), "of the rope's radius"
    assert min(np.abs(middles - each).max() for each in clouds(bag, "cable")) < 1e-5, "around its particles"


@pytest.mark.long
def test_movies_show_what_moves(bag, tmp_path):
    from PIL import Image

    assert "frames" in export(bag, tmp_path / "pictures", "--rate", "4")
    pictures = sorted((tmp_path / "pictures").glob("*.png"))
    first, last = (np.asarray(Image.open(each).convert("RGB"), float) for each in (pictures[0], pictures[-1]))
    assert first.shape == (480, 640, 3) and (first != 255).any(axis=2).mean() > 0.02, "something is drawn"
    assert (np.abs(first - last).max(axis=2) > 60).sum() > 100, "and it moves"
    export(bag, tmp_path / "cloth.gif", "--rate", "4")
    assert 1 < Image.open(tmp_path / "cloth.gif").n_frames <= len(pictures), "equal frames are one, shown longer"
    export(bag, tmp_path / "cloth.mp4", "--rate", "4")
    assert b"ftyp" in (tmp_path / "cloth.mp4").read_bytes()[:12]


@pytest.mark.long
def test_what_cannot_be_exported_is_told_in_a_sentence(bag, tmp_path):
    assert "ends in .obj; allowed are .glb, .mp4, .gif" in export(bag, tmp_path / "cloth.obj", status=1)
    assert "is not there" in export(tmp_path / "none", tmp_path / "cloth.glb", status=1)
    assert "--rate is 0; allowed is" in export(bag, tmp_path / "cloth.glb", "--rate", "0", status=1)
    (tmp_path / "file").touch()
    for name, why in {
        "folder.glb": "Is a directory",
        "folder.mp4": "ffmpeg ends with status",
        "file": "File exists",
        "file/cloth.glb": "File exists",
    }.items():
        if name.startswith("folder"):
            (tmp_path / name).mkdir()
        told = export(bag, tmp_path / name, "--rate", "4", status=1)
        assert told.splitlines()[-1].startswith(f"cloth_sim_export: {tmp_path / name} cannot be written: {why}"), told


@pytest.mark.long
def test_the_folder_of_a_file_is_made(bag, tmp_path):
    export(bag, tmp_path / "a/b/cloth.glb", "--rate", "4")
    assert (tmp_path / "a/b/cloth.glb").stat().st_size > 0


@pytest.mark.long
def test_a_bag_of_another_version_is_told_in_a_sentence(bag, tmp_path):
    """One whose parameters lack what there is now, as one recorded before has it."""
    import rosbags.rosbag2 as rosbag2
    from rosbags.typesys import Stores, get_typestore

    types, older = get_typestore(Stores.ROS2_JAZZY), tmp_path / "older"
    plugin = rosbag2.StoragePlugin.MCAP
    with rosbag2.Reader(bag) as reader, rosbag2.Writer(older, version=9, storage_plugin=plugin) as writer:
        to = {each.id: writer.add_connection(each.topic, each.msgtype, typestore=types) for each in reader.connections}
        for connection, time, data in reader.messages():
            if connection.topic.endswith("/journal"):
                message = types.deserialize_cdr(data, connection.msgtype)
                entry = json.loads(message.data)
                if "start" in entry:
                    del entry["start"]["parameters"]["cloth.thickness"]
                data = types.serialize_cdr(type(message)(data=json.dumps(entry)), connection.msgtype)
            writer.write(to[connection.id], time, data)
    told = "older was recorded by another version of cloth_sim_ros, as it lacks the parameter cloth.thickness"
    assert told in export(older, tmp_path / "cloth.glb", status=1)
