# SPDX-License-Identifier: Apache-2.0
"""The launch file: run by the real launch package where there is one, and read as source elsewhere."""

import ast
import re
import signal
import subprocess
import sys

import pytest
from client import fields
from node_process import ROOT
from patience import tries
from sensor_msgs.msg import PointCloud2

from cloth_sim_ros import programs

FILE = ROOT / "launch" / "cloth_sim.launch.py"
PROGRAMS = dict(re.findall(r'"(\w+) = cloth_sim_ros.programs:(\w+)"', (ROOT / "setup.py").read_text()))

LAUNCH = """
import signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)  # which a shell has its background jobs ignore
from launch import LaunchDescription, LaunchService
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
given = [word.split(":=") for word in sys.argv[2:]]
service = LaunchService()
source = PythonLaunchDescriptionSource(sys.argv[1])
service.include_launch_description(LaunchDescription([IncludeLaunchDescription(source, launch_arguments=given)]))
sys.exit(service.run())
"""


def test_its_arguments_have_defaults_and_its_programs_exist():
    tree = ast.parse(FILE.read_text())
    (table,) = [node.value for node in tree.body if isinstance(node, ast.Assign) and node.targets[0].id == "ARGUMENTS"]
    arguments = ast.literal_eval(table)
    assert {"scene", "params_file", "namespace", "name", "device", "use_sim_time", "viewer", "rviz"} <= set(arguments)
    assert arguments["viewer"][0] == arguments["rviz"][0] == "false"
    assert (ROOT / f"config/{arguments['scene'][0]}.yaml").is_file()
    words = {node.value for node in ast.walk(tree) if isinstance(node, ast.Constant) and isinstance(node.value, str)}
    started = {word for word in words if re.fullmatch("cloth_sim_(?!ros)\\w+", word)}
    assert started == {"cloth_sim_node", "cloth_sim_viewer", "cloth_sim_driver"} and started <= set(PROGRAMS)
    assert all(callable(getattr(programs, PROGRAMS[program])) for program in started)


@pytest.fixture
def installed(tmp_path, monkeypatch):
    """An installation such as colcon makes, of links to this source."""
    share, programs = tmp_path / "share", tmp_path / "lib" / "cloth_sim_ros"
    index = share / "ament_index" / "resource_index" / "packages"
    for folder in (index, programs, share / "cloth_sim_ros"):
        folder.mkdir(parents=True)
    (index / "cloth_sim_ros").touch()
    (share / "cloth_sim_ros" / "config").symlink_to(ROOT / "config")
    for name, function in PROGRAMS.items():
        program = programs / name
        program.write_text(
            f"#!{sys.executable}\nimport sys\nfrom cloth_sim_ros.programs import {function}\nsys.exit({function}())\n"
        )
        program.chmod(0o755)
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path))
    monkeypatch.setenv("PYTHONPATH", ":".join([str(ROOT), *sys.path]))


@pytest.fixture
def launched(installed, tmp_path):
    """launched(*arguments) -> the process of a launch, as `ros2 launch` runs it, and the file of what it prints."""
    pytest.importorskip("launch")
    pytest.importorskip("launch_ros")
    processes = []

    def launch(*arguments):
        with (tmp_path / "log.txt").open("w") as log:
            command = [sys.executable, "-c", LAUNCH, str(FILE), *arguments]
            processes.append(subprocess.Popen(command, stdout=log, stderr=subprocess.STDOUT))
        return processes[-1], tmp_path / "log.txt"

    yield launch
    for process in processes:
        process.send_signal(signal.SIGINT)
        process.wait(60.0)


def test_a_scene_starts_in_a_namespace_with_its_driver_and_viewer(launched, client):
    _, log = launched("scene:=towel", "namespace:=robot", "name:=sheets", "viewer:=True")
    clouds = client.listen(PointCloud2, "/robot/sheets/towel/particles", 1)
    client.until(lambda: clouds and fields(clouds[-1])[:, 2].max() > 0.1, timeout=90.0)  # the driver folds it
    client.until(lambda: "The page is at http://localhost:" in log.read_text())
    assert "Traceback" not in log.read_text()


def test_rviz_shows_the_node_as_it_is_named(launched, installed, tmp_path):
    """A stand-in for rviz2 tells with which words it is started."""
    (tmp_path / "share" / "ament_index" / "resource_index" / "packages" / "rviz2").touch()
    (tmp_path / "share" / "rviz2").mkdir()
    program = tmp_path / "lib" / "rviz2" / "rviz2"
    program.parent.mkdir()
    program.write_text(f'#!/bin/sh\necho "$@" > {tmp_path}/part\nmv {tmp_path}/part {tmp_path}/words\n')
    program.chmod(0o755)
    launched("scene:=towel", "namespace:=/robot", "name:=sheets", "rviz:=true", "use_sim_time:=true")
    for _ in tries(60.0, pause=0.1):
        if (tmp_path / "words").is_file():
            break
    words = (tmp_path / "words").read_text()
    assert "towel.rviz" in words and "--params-file" in words, "a file that has use_sim_time"
    for topic in ("colliders", "towel/mesh", "towel/particles"):
        assert f"/cloth_sim/{topic}:=/robot/sheets/{topic}" in words


def test_what_is_neither_true_nor_false_is_refused(launched):
    process, log = launched("viewer:=maybe")
    assert process.wait(30.0) == 1
    assert 'Argument "viewer" provided value "maybe" is not valid' in log.read_text()


def test_a_missing_scene_is_told_what_there_is(launched):
    process, log = launched("scene:=sock")
    assert process.wait(30.0) == 1
    assert re.search("there is no .*/sock.yaml; the scenes are .*curtain, .*towel", log.read_text())
