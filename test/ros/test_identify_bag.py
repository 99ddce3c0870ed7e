# SPDX-License-Identifier: Apache-2.0
"""A bag of a real node is enough to find its material."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml
from geometry_msgs.msg import WrenchStamped
from node_process import ROOT
from patience import patience
from recorder_process import Recording
from std_srvs.srv import Trigger

pytest.importorskip("rosbags")

from cloth_sim_ros.identify.bag import frames_of
from cloth_sim_ros.identify.cable_bag import CableTopics
from cloth_sim_ros.identify.markers import Markers
from cloth_sim_ros.record.topics import WRENCH, Topics

SCENE = """
/**:
  ros__parameters:
    objects: [cloth]
    colliders: [ball]
    cloth:
      {type: cloth, resolution: [8, 6], pins: corners, position: [0, 0, 2], stretch_compliance: 0.004, damping: 0.01}
    ball: {shape: sphere, dimensions: [0.15], position: [0, 0, 1]}
    solver: {global_damping: 5.0, substeps: 40}
"""


@pytest.fixture
def bag(start, client, tmp_path):
    """A recording of SCENE in which a ball was moved, everything reset, and the ball pushed into the cloth."""
    node = start(SCENE).ready()
    recording = Recording(tmp_path / "bag")
    try:
        recording.wait_for("Recording into ")
        client.spin(0.3, meanwhile=lambda: client.move("ball", (0.1, 0.0, 1.3)))
        assert client.call(Trigger, "/cloth_sim/reset").success
        heights = iter(np.linspace(1.3, 1.8, 200))
        client.spin(1.0, meanwhile=lambda: client.move("ball", (0.1, 0.0, next(heights, 1.8))))
        recording.end()
    finally:
        recording.process.kill()
        node.end()
    return tmp_path / "bag"


WEIGHT = [0.0, 0.0, -0.1 * 9.81]  # [N] of a cable that a hand holds at one end
HELD = """
/**:
  ros__parameters:
    objects: [cable]
    handles: [hand]
    cable: {type: rope, start: [0, 0, 1], end: [0.5, 0, 1], segments: 10, mass: 0.1, pins: none, bend_compliance: 200.0}
    hand: {position: [0, 0, 1], reach: [0.06], attached: true}
    solver: {global_damping: 20.0}
"""


def test_the_recorder_keeps_what_a_hand_feels(start, client, tmp_path):
    """In the end it carries the whole cable, whose particles are markers in their order."""
    node = start(HELD).ready()
    felt = client.listen(WrenchStamped, "/cloth_sim/handles/hand/wrench")
    recording = Recording(tmp_path / "bag")
    try:
        recording.wait_for("Recording into ")
        client.until(lambda: felt and felt[-1].wrench.force.z == pytest.approx(WEIGHT[2], rel=0.01))
        client.spin(0.5)
        recording.end()
    finally:
        recording.process.kill()
        node.end()
    topics = CableTopics(["/cloth_sim/cable/particles"], ["/cloth_sim/handles/hand/wrench"])
    markers = Markers.read([tmp_path / "bag"], topics)
    assert markers.count == 11 and markers.forces[0][-5:] == pytest.approx(np.array(5 * [WEIGHT]), abs=0.02)
    types = Topics(tmp_path / "bag").types
    assert types["/cloth_sim/cable/start/wrench"] == WRENCH


def identified(bag, scene, *arguments):
    command = [sys.executable, "-m", "cloth_sim_ros.identify", str(bag), "--scene", str(scene), "--worlds", "8"]
    command += ["--fit", "cloth.stretch_compliance", *arguments]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=patience(300), check=False)


@pytest.mark.long
def test_the_stiffness_of_a_nodes_cloth_is_found_in_its_bag(bag, tmp_path):
    scene, found = tmp_path / "guess.yaml", tmp_path / "found.yaml"
    scene.write_text(SCENE.replace("0.004", "0.02"))
    result = identified(bag, scene, "--output", str(found))
    assert result.returncode == 0, result.stderr
    values = yaml.safe_load(found.read_text())["/**"]["ros__parameters"]
    assert values["cloth"]["stretch_compliance"] == pytest.approx(0.004, rel=0.005)
    scene.write_text(SCENE + "    rate: 100.0\n")
    result = identified(bag, scene)
    assert result.returncode == 2
    assert result.stderr == f"error: {bag} has 60 frames a second; allowed are the 100 of the scene\n"


@pytest.mark.parametrize(
    ("acts", "sentence"),
    [
        ([["advance"]], "has no frame after a reset; call ~/reset while it is recorded, to start from rest"),
        ([["reset"], ["set_wind", [1.0, 0.0, 0.0]], ["advance"]], "has the input set_wind; allowed are bags in which"),
    ],
)
def test_what_cannot_be_compared_is_said(acts, sentence):
    with pytest.raises(ValueError, match=sentence):
        frames_of(Path("bag"), [((1, 0), acts)], {})
