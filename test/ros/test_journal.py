# SPDX-License-Identifier: Apache-2.0
"""Listeners of the journal that come and go, recorders that are killed, and bags that were changed."""

import importlib
import json
import random
import re
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from node_process import ROOT, SMALL
from recorder_process import Recording
from std_msgs.msg import String

pytest.importorskip("rosbags")
PYTHON = [sys.executable, "-m"]


@pytest.fixture(scope="module")
def bag(tmp_path_factory, ros):
    """A short recording, and what was there when its recorder was killed."""
    from client import Client
    from node_process import NodeProcess

    folder = tmp_path_factory.mktemp("journal")
    node, client = NodeProcess(SMALL, (), folder / "node").ready(), Client()
    recording = Recording(folder / "bag")
    try:
        recording.wait_for("Recording into ")
        client.spin(3.0)
        shutil.copytree(folder / "bag", folder / "killed")
    finally:
        recording.end()
        client.destroy()
        node.end()
    return folder / "bag"


@pytest.mark.long
def test_listeners_that_come_and_go_leave_nothing_in_the_node(start, client):
    node = start(SMALL.replace("[6, 5]", "[64, 64]")).ready()
    node.wait_for("all kernels are compiled")

    def come():
        starts = []
        listener = client.node.create_subscription(String, "/cloth_sim/journal", lambda m: starts.append(m.data), 10)
        client.until(lambda: starts)
        client.node.destroy_subscription(listener)
        client.spin(0.3)
        assert "start" in json.loads(starts[-1])
        return len(starts[-1]) / 1e6

    def memory():
        status = Path(f"/proc/{node.process.pid}/status").read_text()
        return int(re.search(r"RssAnon:\s+(\d+)", status)[1]) / 1e3

    for _ in range(8):
        size = come()
    before = memory()
    for _ in range(12):
        come()
    assert size > 1.0 and memory() - before < 4 * size, "MB; a start for each of 12 would be three times that"


def test_a_killed_recording_is_replayed_up_to_there(bag):
    killed = bag.parent / "killed"
    assert not (killed / "metadata.yaml").exists()
    command = [*PYTHON, "cloth_sim_ros.record.replay", str(killed)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    assert f"{killed} was not finished by its recorder; this is what it had written" in done.stdout
    compared = int(re.search(r"(\d+) clouds compared, \1 the same bits", done.stdout)[1])
    assert compared > 120, "of 3 s at 60 Hz of two objects, all but the last second or so"


def test_one_flipped_bit_is_refused_or_changes_nothing(bag, tmp_path):
    from cloth_sim_ros.record.bag import Bag
    from cloth_sim_ros.record.run import clouds_of

    def content(path):
        read = Bag(path)
        return read.journal, {name: [(at, c.tobytes()) for at, c in clouds_of(read, name)] for name in read.objects}

    wanted, (file,) = content(bag), bag.glob("*.mcap")
    whole, chance, refused = file.read_bytes(), random.Random(4), 0
    copy = tmp_path / "flipped"
    shutil.copytree(bag, copy)
    index = len(whole) - 1000  # of the chunks, which MCAP has no checksum for
    for at in [chance.randrange(start, len(whole)) for start in (0, index) for _ in range(40)]:
        flipped = bytearray(whole)
        flipped[at] ^= 1 << chance.randrange(8)
        (copy / file.name).write_bytes(flipped)
        try:
            assert content(copy) == wanted
        except ValueError as error:
            assert str(copy) in str(error) and "\n" not in str(error)
            refused += 1
    assert refused > 20


@pytest.mark.parametrize(
    "entry",
    [
        "[]",
        '{"version": 2}',
        '{"version": 2, "sequence": 0, "stamp": [0, 0]}',
        '{"version": 2, "sequence": "0", "stamp": [0, 0], "acts": []}',
        '{"version": 2, "sequence": 0, "stamp": [1e400, 0], "acts": []}',
        '{"version": 2, "sequence": 0, "stamp": [0, 0], "acts": [7]}',
        '{"version": 2, "sequence": 0, "stamp": [0, 0], "start": {}}',
    ],
)
def test_a_journal_that_no_node_wrote_is_refused(bag, tmp_path, capsys, entry):
    import rclpy.serialization
    from test_record import copied

    from cloth_sim_ros.record import replay

    data = rclpy.serialization.serialize_message(String(data=entry))
    other = copied(bag, tmp_path / "other", lambda topic, old: data if topic.endswith("/journal") else old)
    assert replay.main([str(other)]) == 1
    assert f"{other} has a /cloth_sim/journal that no cloth_sim node wrote" in capsys.readouterr().err


@pytest.mark.parametrize("seconds", ["-1", "0", "nan", "soon"])
@pytest.mark.parametrize("module", ["record.recorder", "demo.__main__"])
def test_a_time_that_is_none_is_refused(tmp_path, capsys, module, seconds):
    program = importlib.import_module(f"cloth_sim_ros.{module}")
    where = [str(tmp_path / "bag")] if module == "record.recorder" else []
    with pytest.raises(SystemExit) as ended:
        program.main([*where, f"--seconds={seconds}"])
    told = f"argument --seconds: '{seconds}' is no time; allowed is a number of seconds above 0"
    assert ended.value.code == 2 and told in capsys.readouterr().err
    assert not (tmp_path / "bag").exists()


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="the device that is always full is Linux's")
def test_a_full_disk_is_told_at_once(start, tmp_path):
    start(SMALL).ready()
    code = (
        "import os, sys, rosbags.rosbag2.storage_mcap as storage; from cloth_sim_ros.record import recorder\n"
        "class Full(storage.McapWriter):\n"
        "    def __init__(self, *arguments):\n"
        "        super().__init__(*arguments)\n"
        "        full = os.open('/dev/full', os.O_WRONLY); self.bio.flush(); os.dup2(full, self.bio.fileno())\n"
        "import rosbags.rosbag2 as bags; bags.Writer.STORAGE_PLUGINS = {each: Full for each in bags.StoragePlugin}\n"
        "sys.exit(recorder.main([sys.argv[1]]))"
    )
    command = [sys.executable, "-c", code, str(tmp_path / "bag")]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 1 and "Traceback" not in done.stderr
    assert "bag cannot be written: " in done.stderr and "No space left on device" in done.stderr


@pytest.mark.parametrize("wait", [0.1, 0.3, 0.6])
def test_ctrl_c_while_a_program_is_imported_ends_it_without_a_traceback(tmp_path, wait):
    code = "import sys; from cloth_sim_ros.programs import record; print('here', flush=True); sys.exit(record())"
    command = [sys.executable, "-c", code, str(tmp_path / "bag")]
    with subprocess.Popen(command, cwd=ROOT, stdout=-1, stderr=-1, text=True) as process:
        try:
            process.stdout.readline()
            with pytest.raises(subprocess.TimeoutExpired):
                process.wait(wait)
            process.send_signal(signal.SIGINT)
            assert process.wait(30.0) in (1, 130)
            assert "Traceback" not in process.stderr.read()
        finally:
            process.kill()
