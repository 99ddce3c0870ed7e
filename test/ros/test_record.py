# SPDX-License-Identifier: Apache-2.0
"""A real node is recorded while all kinds of inputs come, and its bag replayed: the same bits, or where they differ."""

import shutil
import signal
import struct
import subprocess
import sys
import time

import all_inputs
import numpy as np
import pytest
from geometry_msgs.msg import Vector3Stamped
from node_process import ROOT
from recorder_process import Recording
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Float64
from std_srvs.srv import SetBool, Trigger
from visualization_msgs.msg import Marker, MarkerArray

rosbag2 = pytest.importorskip("rosbags.rosbag2")

SCENE = f"""{all_inputs.SCENE}    publish: {{velocities: true, tensions: true}}
    hand: {{position: [-0.3, -0.25, 1.0], reach: [0.4], object: cloth}}
"""
SAID = ("colliders/ball/pose", "wind", "cable/winch", "scene")  # topics to which the node and its recorder listen


def replayed(bag, status=0):
    """What cloth_sim_replay prints of a bag, and says as an error."""
    command = [sys.executable, "-m", "cloth_sim_ros.record.replay", str(bag)]
    result = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=300, check=False)
    assert result.returncode == status and "Traceback" not in result.stderr, result.stdout + result.stderr
    return result.stdout, result.stderr


def say_everything(client):
    """All kinds of inputs there are, to a node that runs, then paused, with a reset and a rebuild among them."""
    scene = client.node.create_publisher(MarkerArray, "/cloth_sim/scene", 10)
    client.until(lambda: all(client.node.count_subscribers(f"/cloth_sim/{topic}") > 1 for topic in SAID))
    wind = Vector3Stamped()
    wind.vector.y = 3.0
    begin = time.monotonic()

    def swing():
        client.move("ball", (0.1 * np.sin(5.0 * (time.monotonic() - begin)), 0.0, 0.85))
        client.publish("/cloth_sim/wind", wind)
        client.publish("/cloth_sim/cable/winch", Float64(data=0.5))

    client.spin(0.7, meanwhile=swing)
    assert client.call(SetBool, "/cloth_sim/handles/hand/attach", SetBool.Request(data=True)).success
    assert client.set("cloth.stretch_compliance", 2e-3).successful and client.set("cloth.pins", [35, 39]).successful
    scene.publish(all_inputs.box(Marker.ADD))
    client.spin(0.5, meanwhile=swing)
    clouds = client.listen(PointCloud2, "/cloth_sim/cloth/particles", 1)
    client.until(lambda: len(clouds) > 4, timeout=90.0)  # what was set may need kernels that are compiled first
    assert client.call(Trigger, "/cloth_sim/reset").success
    client.spin(0.3)
    assert client.call(SetBool, "/cloth_sim/pause", SetBool.Request(data=True)).success
    for _ in range(3):
        assert client.call(Trigger, "/cloth_sim/step").success
    assert client.call(Trigger, "/cloth_sim/reset").success
    assert client.call(SetBool, "/cloth_sim/pause", SetBool.Request(data=False)).success
    assert client.set("ball.dimensions", [0.14]).successful  # the simulation is built anew
    client.spin(0.5, meanwhile=swing)
    scene.publish(all_inputs.box(Marker.DELETE))
    seen = len(clouds)
    client.until(lambda: len(clouds) > seen + 4, timeout=90.0)


@pytest.fixture(scope="module")
def bag(tmp_path_factory, ros):
    """A recording of all that, from a node that was recorded once before, and by another recorder meanwhile."""
    from client import Client
    from node_process import NodeProcess

    folder = tmp_path_factory.mktemp("record")
    node, client = NodeProcess(SCENE, (), folder / "node"), Client()
    recordings = []

    def record(name):
        recordings.append(Recording(folder / name))
        recordings[-1].wait_for("Recording into ")
        return recordings[-1]

    try:
        node.ready()
        before = record("before")
        client.spin(0.3)
        before.end()
        client.spin(0.3)
        recording = record("bag")
        say_everything(client)
        other = record("other")
        client.spin(0.3)
        other.end()
        recording.end()
    finally:
        client.destroy()
        for each in recordings:
            each.process.kill()
        ended = node.end()
    assert ended == 0 and "[ERROR]" not in node.log
    return folder / "bag"


def copied(bag, to, change=lambda topic, data: data, only="", **writing):
    """A copy of a bag; change(topic, data) gives what is written, None to leave a message out. only: the end of the
    topics that are in it."""
    from rosbags.typesys import Stores, get_typestore

    types = get_typestore(Stores.ROS2_JAZZY)
    writer = rosbag2.Writer(to, **{"version": 9, "storage_plugin": rosbag2.StoragePlugin.MCAP, **writing})
    with rosbag2.Reader(bag) as reader, writer:
        chosen = [each for each in reader.connections if each.topic.endswith(only)]
        into = {each.id: writer.add_connection(each.topic, each.msgtype, typestore=types) for each in chosen}
        for connection, stamp, data in reader.messages(chosen):
            data = change(connection.topic, data)
            if data is not None:
                writer.write(into[connection.id], stamp, data)
    return to


@pytest.mark.long
def test_a_recorded_node_is_replayed_to_the_same_bits(bag):
    said, _ = replayed(bag)
    assert " not" in said and said.splitlines()[-1].endswith(", 0 not") and " differ" not in said
    assert int(said.splitlines()[-1].split()[0]) > 200, "two clouds a frame"
    with rosbag2.Reader(bag) as reader:
        counts = {each.topic: each.msgcount for each in reader.connections}
        (journal,) = [each for each in reader.connections if each.topic == "/cloth_sim/journal/acts"]
        text = " ".join(data.decode("latin-1") for _, _, data in reader.messages([journal]))
    for topic in (*SAID, "cloth/particles", "cable/particles"):
        assert counts[f"/cloth_sim/{topic}"] > 0
    for act in ("advance", "attach", "move", "put", "reset", "set_live", "set_pay_out", "set_wind", "take_away"):
        assert f'["{act}"' in text


@pytest.mark.long
def test_the_frame_of_one_changed_number_is_told(bag, tmp_path):
    from cloth_sim_ros.record.bag import Bag
    from cloth_sim_ros.record.replay import SAME, compared

    rows = [row for row in compared(Bag(bag)) if row[1] == "cloth"]
    assert {sentence for *_, sentence in rows} == {SAME}
    clouds = [stamp for stamp, _ in Bag(bag).clouds("cloth")]
    first = clouds.index(Bag(bag).journal[0]["stamp"])  # the cloud of the first row
    changed, seen = first + 40, iter(range(len(clouds)))

    def change(topic, data):
        if topic != "/cloth_sim/cloth/particles" or next(seen) != changed:
            return data
        at = len(data) - 4 - 4 * 6 * 5  # is_dense and its padding, then five particles of six numbers
        (number,) = struct.unpack_from("<f", data, at - at % 4)
        return (
            data[: at - at % 4]
            + struct.pack("<f", np.nextafter(np.float32(number), np.float32(9)))
            + data[at - at % 4 + 4 :]
        )

    said, _ = replayed(copied(bag, tmp_path / "changed", change), status=1)
    (line,) = [line for line in said.splitlines() if "differ" in line]
    assert line.startswith(f"frame {rows[40][0]}: cloth: 1 of 42 particles differ")
    assert said.splitlines()[-1].endswith(", 1 not")


def journal_of(bag):
    from cloth_sim_ros.record.bag import Bag

    return Bag(bag).journal


@pytest.mark.long
def test_a_changed_input_is_told_from_its_frame_on(bag, tmp_path):
    frames = 0
    for entry in journal_of(bag):
        acts = entry.get("acts", [])
        frames += sum(act == "advance" for act, *_ in acts)
        if frames > 20 and ["set_wind", [0.0, 3.0, 0.0]] in acts:
            break
    number = b'"sequence": %d,' % entry["sequence"]

    def change(topic, data):
        return data.replace(b"[0.0, 3.0, 0.0]", b"[0.0, 9.0, 0.0]") if number in data else data

    said, _ = replayed(copied(bag, tmp_path / "changed", change), status=1)
    first, second, *_ = said.splitlines()
    assert first == f"frames 0 to {frames - 1}: the same bits"
    assert second.startswith(f"frame {frames}: c") and "particles differ, by up to" in second


@pytest.mark.long
def test_lost_messages_of_the_journal_are_told(bag, tmp_path):
    number = b'"sequence": %d,' % journal_of(bag)[20]["sequence"]
    lossy = copied(bag, tmp_path / "lossy", lambda topic, data: None if number in data else data)
    said, _ = replayed(lossy, status=1)
    assert "messages of the journal are lost; nothing is compared until its next start" in said
    assert " differ" not in said and int(said.splitlines()[-1].split()[0]) > 20, "the rebuild has a start of its own"


def test_bags_of_other_storages_are_read(bag, tmp_path):
    """SQLite, as earlier versions of rosbag2 write by default."""
    said, _ = replayed(copied(bag, tmp_path / "sqlite", storage_plugin=rosbag2.StoragePlugin.SQLITE3))
    assert said.splitlines()[-1].endswith(", 0 not")


@pytest.mark.long
def test_what_cannot_be_replayed_is_refused_in_a_sentence(bag, tmp_path):
    def refused(path):
        said, error = replayed(path, status=1)
        lines = [line for line in error.splitlines() if "CUDA" not in line]
        assert not said and len(lines) == 1 and lines[0].startswith(f"cloth_sim_replay: {path} "), error
        return lines[0]

    assert "is not there" in refused(tmp_path / "nowhere")
    (tmp_path / "empty").mkdir()
    assert "is no bag, or is damaged or cut short: " in refused(tmp_path / "empty")
    (tmp_path / "text").write_text("objects: [cloth]\n")
    assert "is no bag" in refused(tmp_path / "text")
    cut = tmp_path / "cut"
    shutil.copytree(bag, cut)
    (file,) = cut.glob("*.mcap")
    file.write_bytes(file.read_bytes()[:100_000])
    assert "is no bag, or is damaged or cut short: " in refused(cut)
    assert "has no topic /NODE/journal; a replay needs one" in refused(copied(bag, tmp_path / "foreign", only="/wind"))
    assert "/cloth_sim/OBJECT/particles" in refused(copied(bag, tmp_path / "no clouds", only="/journal"))
    no_journal = copied(
        bag, tmp_path / "empty journal", lambda topic, data: None if topic.endswith("/journal") else data
    )
    assert "has no start in /cloth_sim/journal" in refused(no_journal)
    acts = copied(bag, tmp_path / "late", lambda topic, data: None if b'"start": ' in data else data)
    assert "has no start in /cloth_sim/journal" in refused(acts)
    other = copied(bag, tmp_path / "new", lambda topic, data: data.replace(b'{"version": 2,', b'{"version": 7,'))
    assert "has a journal of version 7; allowed is 2" in refused(other)


def test_a_recorder_needs_a_new_folder_and_a_node(tmp_path):
    (tmp_path / "there").mkdir()
    command = [sys.executable, "-m", "cloth_sim_ros.record.recorder"]
    result = subprocess.run([*command, str(tmp_path / "there")], cwd=ROOT, capture_output=True, text=True, check=False)
    assert result.returncode == 1 and "exists already, not overwriting" in result.stderr
    with subprocess.Popen([*command, str(tmp_path / "none")], cwd=ROOT, stdout=-1, stderr=-1, text=True) as process:
        process.stdout.readline()
        process.send_signal(signal.SIGTERM)
        assert process.wait(20.0) == 1
        assert "has no start, as no simulation ran in /cloth_sim" in process.stderr.read()
