# SPDX-License-Identifier: Apache-2.0
"""The parameter files in README and docs/reference/ros.md are what the node takes, and do what the text says."""

import re
from pathlib import Path

import numpy as np
import pytest
import yaml

from cloth_sim_ros.sim import Simulation
from cloth_sim_ros.study.scene_file import read_plan

ROOT = Path(__file__).parents[2]


@pytest.fixture
def simulations(tmp_path):
    """Object name -> a simulation of each file in the pages."""
    found = {}
    pages = "".join((ROOT / page).read_text() for page in ("README.md", "docs/reference/ros.md"))
    for text in re.findall(r"```yaml\n(.*?)```", pages, flags=re.DOTALL):
        file = tmp_path / "example.yaml"
        file.write_text(text)
        plan = read_plan(file)
        assert not plan.problems
        found[next(iter(plan.scene.objects))] = Simulation(plan.scene, plan.settings, device="cpu")
    return found


@pytest.mark.long
def test_the_winch_holds_five_kilograms_and_the_hose_half_a_turn(simulations):
    cable, hose = simulations["cable"], simulations["hose"]
    cable.set("solver.global_damping", 10.0)
    cable.step(120)
    assert cable.end_wrenches("cable")[0, 2] == pytest.approx(-9.81 * (5.0 + 0.1), rel=5e-3)
    cable.set("cable.winch.pay_out", 0.5)
    cable.step(60)
    assert cable.report()["cable"]["paid_out"] == pytest.approx(1.25, abs=0.01)
    hose.step(30)
    report = hose.report()["hose"]
    assert report["torsion"] == pytest.approx(report["twist"] / 15.0 / (38 / 40), rel=1e-4)
    assert report["twist"] == pytest.approx(3.14, abs=0.3) and np.isfinite(hose.positions("hose")).all()


@pytest.mark.long
def test_the_example_of_the_winch_is_its_file(simulations):
    file = read_plan(ROOT / "config" / "winch.yaml").scene.objects["cable"]
    assert simulations["cable"].scene.objects["cable"].winch == file.winch
    assert simulations["cable"].scene.objects["cable"].end_mass == file.end_mass


def test_the_cheat_sheet_is_a_scene_that_runs(tmp_path):
    page = (ROOT / "docs/reference/yaml.md").read_text()
    (text,) = re.findall(r"```yaml\n(.*?)```", page, flags=re.DOTALL)
    lines = dict(re.findall(r"^\| ([^|]+) \| `([^`]+: .*?)`", page, flags=re.MULTILINE))
    file = tmp_path / "example.yaml"
    file.write_text(text)
    plan = read_plan(file)
    assert not plan.problems and set(plan.scene.objects) == {"sheet", "skirt", "cable"}
    assert plan.scene.objects["cable"].winch.length == 0.4 and plan.grippers["gripper"].force == 2.0
    assert plan.scene.seams["tie"].first == "sheet"
    for line in lines.values():
        ((name, value),) = yaml.safe_load(line).items()
        parameters = yaml.safe_load(text)["/**"]["ros__parameters"]
        parameters[name] = {**parameters.get(name, {}), **value} if isinstance(value, dict) else value
        file.write_text(yaml.safe_dump({"/**": {"ros__parameters": parameters}}))
        assert not read_plan(file).problems, line
    assert len(lines) == 11


@pytest.mark.long
def test_the_first_scene_has_a_hand_that_keeps_a_corner(simulations):
    sim = simulations["towel"]
    assert sim.held("hand") == 1 and set(sim.scene.objects) == {"towel", "cable"}
    for frame in range(60):
        sim.set_handle_pose("hand", (-0.25, -0.25, 0.01 + 0.005 * frame))
        sim.step()
    assert sim.positions("towel")[:, 2].max() == pytest.approx(0.305, abs=2e-3)


@pytest.mark.long
def test_the_python_example_runs(capsys):
    (code,) = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), flags=re.DOTALL)
    exec(code.replace('"auto"', '"cpu"'), {})
    assert "is computed by" in capsys.readouterr().out


def test_the_readme_says_what_its_ros2_lines_need_before_the_first_of_them():
    before, _, lines = (ROOT / "README.md").read_text().partition("\n    ros2 ")
    assert "Lines with `ros2` need an [installed ROS 2](docs/how-to/installing.md)" in before and "    ros2 " in lines


def test_the_readme_is_short():
    assert len((ROOT / "README.md").read_text().splitlines()) <= 150
