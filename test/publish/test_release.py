# SPDX-License-Identifier: Apache-2.0
"""One version everywhere, and the tools of ROS release and build the package: catkin_prepare_release and colcon."""

import os
import re
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


def versions(folder):
    """The versions in package.xml and setup.py, and of the newest sections of CHANGELOG.rst."""
    sections = re.findall(r"^(\S.*)\n-+$", (folder / "CHANGELOG.rst").read_text(), flags=re.MULTILINE)
    package = ElementTree.parse(folder / "package.xml").getroot().find("version").text
    (setup,) = re.findall(r'version="([^"]*)"', (folder / "setup.py").read_text())
    return package, setup, sections


def run(*command, cwd, **environment):
    """Its output; the test fails where the status is not 0."""
    done = subprocess.run(command, cwd=cwd, env={**os.environ, **environment}, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_there_is_one_version():
    package, setup, sections = versions(ROOT)
    assert package == setup and re.fullmatch(r"\d+\.\d+\.\d+", package)
    released = [section.split()[0] for section in sections if section != "Forthcoming"]
    assert sections and (not released or released[0] == package)


def test_catkin_prepare_release_makes_a_release(sources):
    pytest.importorskip("catkin_pkg")
    if versions(sources)[2][0] != "Forthcoming":
        pytest.skip("nothing is forthcoming in CHANGELOG.rst")
    name = {"GIT_AUTHOR_NAME": "a", "GIT_AUTHOR_EMAIL": "a@b", "GIT_COMMITTER_NAME": "a", "GIT_COMMITTER_EMAIL": "a@b"}
    for command in ("init --quiet --initial-branch main", "add --all", "commit --quiet --message all"):
        run("git", *command.split(), cwd=sources, **name)
    program = Path(sys.executable).with_name("catkin_prepare_release")
    run(program, "--non-interactive", "--no-push", "--version", "7.8.9", cwd=sources, **name)
    package, setup, sections = versions(sources)
    assert (package, setup, sections[0][:5]) == ("7.8.9", "7.8.9", "7.8.9")
    assert run("git", "tag", cwd=sources).split() == ["7.8.9"]
    assert run("git", "status", "--porcelain", cwd=sources) == ""


def test_colcon_builds_and_tests_it(sources, tmp_path):
    pytest.importorskip("colcon_ros")
    colcon = Path(sys.executable).with_name("colcon")
    python = {"PATH": f"{colcon.parent}:{os.environ['PATH']}", "PYTEST_ADDOPTS": ""}
    run(colcon, "build", "--base-paths", sources, cwd=tmp_path, **python)
    prefix = tmp_path / "install" / "cloth_sim_ros"
    programs = re.findall(r'"(\w+) = cloth_sim_ros\.programs:', (ROOT / "setup.py").read_text())
    assert {file.name for file in (prefix / "lib" / "cloth_sim_ros").iterdir()} == set(programs)  # for ros2 run
    share = prefix / "share"
    assert (share / "ament_index/resource_index/packages/cloth_sim_ros").is_file()
    for folder, pattern in (("config", "*"), ("launch", "*.launch.py")):  # for ros2 launch
        wanted = {file.name for file in (ROOT / folder).glob(pattern)}
        assert {file.name for file in (share / "cloth_sim_ros" / folder).iterdir()} == wanted
    run(colcon, "test", "--base-paths", sources, "--pytest-args", "test/ros/test_package.py", cwd=tmp_path, **python)
    assert re.search(r"[1-9]\d* tests, 0 errors, 0 failures", run(colcon, "test-result", cwd=tmp_path, **python))
    help_text = run(
        prefix / "lib/cloth_sim_ros/cloth_sim_demo",
        "--help",
        cwd=tmp_path,
        **python,
        PYTHONPATH=str(next(prefix.glob("lib/python*/site-packages"))),
        AMENT_PREFIX_PATH=str(prefix),
    )
    assert "towel" in help_text
