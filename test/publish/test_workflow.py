# SPDX-License-Identifier: Apache-2.0
"""Workflow, Dockerfile and devcontainer name only what there is, and their shell is shell."""

import ast
import json
import re
import subprocess
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).parents[2]
WORKFLOW = yaml.safe_load((ROOT / ".github/workflows/ci.yml").read_text())
STEPS = [step for job in WORKFLOW["jobs"].values() for step in job["steps"]]
SCRIPTS = [step["run"] for step in STEPS if "run" in step]
DOCKER = {name: (ROOT / name).read_text() for name in ("Dockerfile", ".devcontainer/Dockerfile")}
DEVCONTAINER = json.loads((ROOT / ".devcontainer/devcontainer.json").read_text())


def setup_argument(name):
    """What setup.py says of a keyword of setup()."""
    (call,) = [node for node in ast.walk(ast.parse((ROOT / "setup.py").read_text())) if isinstance(node, ast.Call)
               and getattr(node.func, "id", "") == "setup"]  # fmt: skip
    return ast.literal_eval(next(each.value for each in call.keywords if each.arg == name))


def test_a_workflow_builds_with_colcon_and_pip():
    ros, pip = WORKFLOW["jobs"]["ros"], WORKFLOW["jobs"]["pip"]
    assert ros["container"] == "ros:jazzy"
    commands = "\n".join(step.get("run", "") for step in ros["steps"])
    assert all(word in commands for word in ("colcon build", "colcon test", "colcon test-result", "ruff check"))
    versions = pip["strategy"]["matrix"]["python"]
    assert versions == ["3.10", "3.11", "3.12", "3.13"] and f">={versions[0]}" == setup_argument("python_requires")
    assert f"Python {versions[0]} to {versions[-1]}" in " ".join((ROOT / "README.md").read_text().split())


@pytest.mark.parametrize("script", [*SCRIPTS, DEVCONTAINER["postCreateCommand"][-1]])
def test_its_shell_is_shell_and_its_targets_are_those_of_the_makefile(script):
    expanded = re.sub(r"\$\{\{.*?\}\}", "value", script)
    assert subprocess.run(["bash", "-n"], input=expanded, text=True, check=False).returncode == 0
    makefile = (ROOT / "Makefile").read_text()
    for target in re.findall(r"\bmake (?!python)([\w./-]+)", script):
        assert re.search(rf"^{re.escape(target.replace('.venv', '$(VENV)'))}:", makefile, flags=re.MULTILINE), target


def test_steps_act_and_extras_exist():
    assert all(("run" in step) != ("uses" in step) for step in STEPS)
    extras = setup_argument("extras_require")
    named = re.findall(r"cloth_sim_ros\[([\w,]+)\]", "\n".join([*SCRIPTS, *DOCKER.values()]))
    assert named and {extra for each in named for extra in each.split(",")} <= set(extras)


def test_containers_see_the_gpu_and_start_what_is_installed():
    for text in DOCKER.values():
        assert "FROM ros:jazzy" in text and re.search(r"NVIDIA_DRIVER_CAPABILITIES=\S*compute", text)
    (command,) = re.findall(r"^CMD (\[.*\])$", DOCKER["Dockerfile"], flags=re.MULTILINE)
    programs = [line.split(" = ")[0] for line in setup_argument("entry_points")["console_scripts"]]
    assert json.loads(command)[0] in programs
    assert DEVCONTAINER["hostRequirements"]["gpu"] == "optional"
    assert (ROOT / ".devcontainer" / DEVCONTAINER["build"]["dockerfile"]).is_file()
