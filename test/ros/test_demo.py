# SPDX-License-Identifier: Apache-2.0
"""The demonstration starts the node, feeds it, prints status lines and ends."""

import os
import re
import subprocess
import sys

import pytest
import rclpy
import yaml
from diagnostic_msgs.msg import DiagnosticArray
from node_process import ROOT
from patience import patience

from cloth_sim_ros.demo.audience import Audience
from cloth_sim_ros.ros.outputs.diagnostics import busy

LINE = re.compile(
    r"real-time factor \d\.\d\d, \d+\.\d\d ms per frame, max strain \d+\.\d %, "
    r"messages out: (\d+) particles/s, (\d+) meshes/s"
)


def test_demo_runs_and_ends_by_itself():
    """Of the scene that compiles least; test_scenes.py has all of them."""
    command = [sys.executable, "-m", "cloth_sim_ros.demo", "winch", "--seconds", "4"]
    result = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=patience(120), check=False)
    assert result.returncode == 0, result.stderr
    lines = LINE.findall(result.stdout)
    assert len(lines) >= 3, result.stdout
    assert all(int(rate) > 0 for rate in lines[-1])
    assert "Ctrl-C ends it. Another scene: make demo SCENE=towel" in result.stdout
    assert "Traceback" not in result.stderr and "[WARN]" not in result.stdout + result.stderr


@pytest.mark.long
def test_demo_tells_that_it_compiles_and_runs_then(tmp_path):
    command = [sys.executable, "-m", "cloth_sim_ros.demo", "winch", "--headless", "--seconds", "2"]
    nothing_compiled = {**os.environ, "WARP_CACHE_PATH": str(tmp_path)}
    result = subprocess.run(
        command, cwd=ROOT, env=nothing_compiled, capture_output=True, text=True, timeout=patience(300), check=False
    )
    assert result.returncode == 0 and "Traceback" not in result.stderr, result.stdout + result.stderr
    told = re.findall(r"^compiling kernels, which later starts find ready: (\d+) modules? done", result.stdout, re.M)
    assert len(told) >= 2 and int(told[-1]) > 0, result.stdout
    assert LINE.search(result.stdout) and "[INFO]" in result.stderr and "]: compiling kernels" in result.stderr


def test_a_status_without_numbers_is_told_as_it_is(client, capsys):
    audience = Audience(["cloth"])
    publisher = client.node.create_publisher(DiagnosticArray, "/diagnostics", 10)
    client.until(lambda: publisher.get_subscription_count() > 0)
    publisher.publish(busy("/cloth_sim", "building has taken 61 s so far"))
    printed = ""

    def said() -> bool:
        nonlocal printed
        rclpy.spin_once(audience, timeout_sec=0.02)
        printed += capsys.readouterr().out
        return bool(printed)

    client.until(said)
    audience.destroy_node()
    assert printed == "building has taken 61 s so far\n"


@pytest.mark.parametrize("scene", [file.stem for file in ROOT.glob("config/*.yaml")])
def test_the_view_of_a_scene_names_its_topics_and_no_others(scene):
    (parameters,) = yaml.safe_load((ROOT / f"config/{scene}.yaml").read_text()).values()
    topics = {"/cloth_sim/colliders"}
    for name in parameters["ros__parameters"]["objects"]:
        topics |= {f"/cloth_sim/{name}/mesh", f"/cloth_sim/{name}/particles"}
    view = yaml.safe_load((ROOT / f"config/{scene}.rviz").read_text())
    displays = view["Visualization Manager"]["Displays"]
    assert {display["Topic"]["Value"] for display in displays if "Topic" in display} == topics


def test_an_unknown_scene_is_told_what_there_is():
    command = [sys.executable, "-m", "cloth_sim_ros.demo", "sock"]
    result = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=patience(60), check=False)
    assert result.returncode == 2 and "towel" in result.stderr
    assert "cloth_sim_demo: error: argument scene: invalid choice: 'sock'" in result.stderr
