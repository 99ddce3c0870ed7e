# SPDX-License-Identifier: Apache-2.0
"""Wheel and sdist pass the checks of the Python registry, and work in an empty environment."""

import os
import re
import subprocess
import sys
import venv
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
USE = """
import sys
from cloth_sim_ros.shared_files import shared
from cloth_sim_ros.sim import Cloth, Scene, Simulation
assert shared("config/towel.yaml").is_relative_to(sys.prefix) and shared("config/towel.yaml").is_file()
sim = Simulation(Scene({"cloth": Cloth(resolution=(4, 4))}), device="cpu")
sim.step(2)
print("it moved", sim.positions("cloth").min() < 0)
"""

pytestmark = pytest.mark.long


def run(*command, cwd):
    """Its output and status, apart from this source tree and its environment."""
    clean = {key: value for key, value in os.environ.items() if key not in ("PYTHONPATH", "AMENT_PREFIX_PATH")}
    done = subprocess.run(command, cwd=cwd, env=clean, capture_output=True, text=True)
    return done.stdout + done.stderr, done.returncode


@pytest.fixture
def distributions(sources):
    """What `make dist` makes, by its own commands."""
    pytest.importorskip("build")
    pytest.importorskip("twine")
    _, status = run(
        sys.executable, "-m", "pip", "download", "--no-deps", "--dest", "registry", "setuptools", cwd=sources
    )
    if status != 0:
        pytest.skip("no Python registry answers")
    recipe = re.search(r"^dist:.*\n((?:\t.*\n)+)", (ROOT / "Makefile").read_text(), flags=re.MULTILINE)[1]
    for command in recipe.splitlines():
        text, status = run("bash", "-c", command.replace("$(RUN)", sys.executable), cwd=sources)
        assert status == 0, text
    assert text.count("PASSED") == 2
    return sorted((sources / "dist").iterdir())


def test_they_install_and_run_in_an_empty_environment(distributions, tmp_path):
    assert [file.suffix for file in distributions] == [".whl", ".gz"]
    venv.create(tmp_path / "empty", with_pip=True)
    python = tmp_path / "empty" / "bin" / "python"
    for file in distributions:
        text, status = run(python, "-m", "pip", "install", "--force-reinstall", file, cwd=tmp_path)
        assert status == 0, text
        text, status = run(python, "-c", USE, cwd=tmp_path)
        assert status == 0 and "it moved True" in text, text
        text, status = run(python.with_name("cloth_sim_node"), cwd=tmp_path)
        assert status == 1 and text.startswith("cloth_sim_node: ROS 2 was not found: ") and text.count("\n") == 1
        run(python, "-m", "pip", "uninstall", "--yes", "cloth_sim_ros", cwd=tmp_path)
