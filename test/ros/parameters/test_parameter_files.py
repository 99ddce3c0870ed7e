# SPDX-License-Identifier: Apache-2.0
"""Parameter files reach the node, or it says what was lost: namespaces, pipes, odd numbers, copies left behind."""

import os
import threading
from pathlib import Path

import pytest
import yaml
from client import fields
from node_process import SMALL
from sensor_msgs.msg import PointCloud2

from cloth_sim_ros.ros.parameters.file import is_for, readable_arguments


@pytest.mark.long
@pytest.mark.parametrize(
    ("key", "node", "matches"),
    [
        ("/cloth_sim", "/cloth_sim", True),
        ("/cloth_sim", "/robot/cloth_sim", False),
        ("/robot/cloth_sim", "/robot/cloth_sim", True),
        ("/**", "/a/b/cloth_sim", True),
        ("/**/cloth_sim", "/a/b/cloth_sim", True),
        ("/*/cloth_sim", "/a/cloth_sim", True),
        ("/*/cloth_sim", "/a/b/cloth_sim", False),
        ("/*", "/cloth_sim", True),
    ],
)
def test_keys_match_as_in_the_middleware(start, key, node, matches):
    assert is_for(key, node) == matches
    namespace = node.removesuffix("/cloth_sim") or "/"
    text = f"{key}:\n  ros__parameters:\n    objects: [rope]\n    rope: {{type: rope, segments: 3}}\n"
    process = start(text, "-r", f"__ns:={namespace}").ready()
    assert ("rope (4 particles)" in process.log) == matches
    assert (f"is for {key} and none of it reaches this node; key it with {node} or /**" in process.log) != matches


def test_shipped_files_work_in_a_namespace(start, client):
    node = start("config/winch.yaml", "-r", "__ns:=/robot").ready()
    assert "cable (65 particles)" in node.log and "none of it reaches" not in node.log
    clouds = client.listen(PointCloud2, "/robot/cloth_sim/cable/particles", 1)
    client.until(lambda: clouds)
    assert len(fields(clouds[0])) == 65


def test_without_a_file_it_says_how_to_give_one(start):
    node = start(None).ready()
    (line,) = [line for line in node.log.splitlines() if "the scene is empty" in line]
    assert line.endswith("as no parameters were given; start with --ros-args --params-file FILE")


def test_a_file_from_a_pipe_is_read_and_no_copy_is_left(start, client, tmp_path, monkeypatch):
    copies = tmp_path / "copies"
    copies.mkdir()
    monkeypatch.setenv("TMPDIR", str(copies))
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    threading.Thread(target=lambda: pipe.write_text(SMALL), daemon=True).start()
    node = start(str(pipe)).ready()
    assert "cloth (30 particles), rope (8 particles)" in node.log
    assert list(client.get("gravity")) == [0.0, 0.0, -9.81]
    assert not list(copies.glob("cloth_sim_*"))


def test_numbers_that_no_list_can_hold_are_named_with_file_and_line(start, client, tmp_path):
    text = SMALL.replace("[0, 0, -9.81]", "[0, 0, .inf]").replace("position: [0, 0, 2]", "position: [.nan, 0.0, 2.0]")
    text = text.replace("dimensions: [0.1]", "dimensions: [0x10]")
    node = start(text).ready()
    wrong = {6: "gravity holds .inf", 7: "cloth.position holds .nan", 9: "ball.dimensions holds 0x10"}
    for line, words in wrong.items():
        sentence = (
            f"parameters.yaml, line {line}: {words}, but numbers in a list must be finite decimals, and is ignored"
        )
        assert node.log.count(sentence) == 1, node.log
    assert list(client.get("gravity")) == [0.0, 0.0, -9.81] and "Traceback" not in node.log


def test_small_numbers_empty_mappings_and_what_is_left_of_a_mapping_stop_no_node(start, client):
    """The middleware's parser stops at an empty mapping, and at 1e-05 that is written without a point."""
    text = SMALL.replace("[0, 0, -9.81]", "[0, 1e-5, -9.81]").replace("pins: start", "winch: {acceleration: [1, up]}")
    start(text + "    solver: {}\n    wind: {velocity: [0, strong]}\n").ready()
    assert list(client.get("gravity")) == [0.0, 1e-5, -9.81] and client.get("rope.winch.acceleration") == 1.0


def readable(text, folder):
    """What reaches the middleware of a file with this text, as YAML, and what is complained of."""
    file, said = folder / "scene.yaml", []
    file.write_text(text)
    (_, path), _ = readable_arguments(["--params-file", str(file)], folder, said.append)
    return yaml.safe_load(Path(path).read_text()), [sentence.removeprefix(f"{file}, ") for sentence in said]


def test_of_a_name_with_two_values_the_last_counts_and_that_is_told(tmp_path):
    text = (
        "/**:\n  ros__parameters:\n    towel: {mass: 1, mass: 2.0, type: rope}\n    towel.type: cloth\n    towel: {}\n"
    )
    root, said = readable(text + "/other:\n  ros__parameters: {towel: {mass: 3.0}}\n", tmp_path)
    assert root["/**"]["ros__parameters"] == {"towel": {"mass": 2.0}, "towel.type": "cloth"}
    sentences = ["line 3: towel.mass stands in line 3 too; this one counts", "line 4: towel.type stands in line 3 too"]
    assert len(said) == 2 and said[0] == sentences[0] and said[1].startswith(sentences[1])


def test_lists_as_text_act_as_in_a_file(start, client):
    """`ros2 param set gravity '[0, 0, -2.5]'` sends text, as the numbers are not all of one type."""
    start(SMALL).ready()
    clouds = client.listen(PointCloud2, "/cloth_sim/rope/particles", 1)
    assert client.set("gravity", "[0, 0, 2.5]").successful
    assert list(client.get("gravity")) == [0.0, 0.0, 2.5]
    client.until(lambda: clouds and fields(clouds[-1])[-1, 2] > 1.5, timeout=10.0)
    assert client.set("gravity", ["1e-3", "0", "2"]).successful
    assert list(client.get("gravity")) == [1e-3, 0.0, 2.0]
    for wrong in ("[0, 0, down]", "[0, 0", "[0, 0, .inf]"):
        refused = client.set("gravity", wrong)
        assert not refused.successful and refused.reason.startswith("gravity is ")
    assert client.set("cloth.resolution", "[4, 5.0]").successful
    assert list(client.get("cloth.resolution")) == [4, 5]
