# SPDX-License-Identifier: Apache-2.0
"""What the tutorials have a reader write down runs, and prints what they say."""

import re
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from cloth_sim_ros.sim import Simulation
from cloth_sim_ros.study.scene_file import read_plan

TUTORIALS = Path(__file__).parents[2] / "docs" / "tutorials"


def block(page, language):
    (text,) = re.findall(rf"```{language}\n(.*?)```", (TUTORIALS / f"{page}.md").read_text(), flags=re.DOTALL)
    return text


def simulation(page, folder):
    file = folder / "scene.yaml"
    file.write_text(block(page, "yaml"))
    plan = read_plan(file)
    return Simulation(plan.scene, plan.settings, device="cpu")


def printed(page, folder):
    """What the page's Python prints, with the lines that Warp adds."""
    file = folder / "script.py"
    file.write_text(block(page, "python"))
    done = subprocess.run([sys.executable, file], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def told(page, words):
    """The number behind `words` in the output that a page shows."""
    return float(re.search(rf"^ {{4}}.*{words} (-?[\d.]+)", (TUTORIALS / f"{page}.md").read_text(), re.MULTILINE)[1])


@pytest.mark.long
def test_the_first_towel_lies_over_its_ball_and_sags_when_soft(tmp_path):
    sim = simulation("first-scene", tmp_path)
    sim.step(120)
    towel = sim.positions("towel")
    assert towel[:, 2].max() == pytest.approx(0.25 + 0.12, abs=0.005), "it lies on top of the ball"
    assert np.linalg.norm(towel - (0, 0, 0.25), axis=1).min() > 0.12 - 0.001
    assert towel[[0, 19, 380, 399], 2].max() < 0.25, "its corners hang"
    strain, height = sim.report()["towel"]["max_strain"], towel[:, 2].mean()
    sim.set("towel.stretch_compliance", 0.1)
    sim.step(60)
    assert sim.report()["towel"]["max_strain"] > 1.5 * strain
    assert sim.positions("towel")[:, 2].mean() < height - 0.005


@pytest.mark.long
def test_fingers_hold_the_towel_by_friction(tmp_path):
    text = printed("fingers", tmp_path)
    press = float(re.search(r"presses with ([\d.]+)", text)[1])
    carried = float(re.search(r"both carry ([\d.]+)", text)[1])
    holding = float(re.search(r"while each presses with ([\d.]+)", text)[1])
    assert carried == pytest.approx(0.03 * 9.81, abs=0.006) and carried <= 2.0 * 0.8 * holding
    assert press == pytest.approx(told("fingers", "presses with"), abs=0.02)
    assert float(re.search(r"middle is at ([\d.-]+)", text)[1]) == pytest.approx(0.1, abs=0.02), "lifted by 10 cm"
    assert float(re.search(r"falls to ([\d.-]+)", text)[1]) < -0.5


def test_finer_wishes_take_more_substeps_and_leave_less_error(tmp_path):
    text = printed("error-and-budget", tmp_path)
    rows = re.findall(r"^asked ([\d.]+): (\d+) substeps, error (\S+)$", text, re.MULTILINE)
    asked, substeps, measured = (list(map(float, column)) for column in zip(*rows, strict=True))
    assert asked == [0.1, 0.03, 0.01]
    assert all(error <= wish for error, wish in zip(measured, asked, strict=True))
    assert substeps == sorted(substeps) and measured == sorted(measured, reverse=True)
    shown = (TUTORIALS / "error-and-budget.md").read_text()
    assert all(f"    {line}\n" in shown for line in text.splitlines() if line.startswith("asked"))


@contextmanager
def node_of(page, folder):
    """The node on the page's scene, in a process of its own."""
    pytest.importorskip("rclpy")
    scene = folder / "scene.yaml"
    scene.write_text(block(page, "yaml"))
    words = ["--ros-args", "--params-file", str(scene)]
    node = subprocess.Popen([sys.executable, "-m", "cloth_sim_ros.ros", *words], stderr=subprocess.DEVNULL)
    try:
        yield
    finally:
        node.terminate()
        assert node.wait(30.0) == 0


@pytest.mark.long
def test_a_reader_of_the_cloud_sees_the_towel(tmp_path):
    with node_of("first-scene", tmp_path):
        text = printed("first-scene", tmp_path)
    assert text.startswith("400 particles, the highest is at ")
    assert 0.25 + 0.12 - 0.005 < float(text.split()[-2]) < 0.6 + 0.01, "over the ball, or on its way there"


@pytest.mark.long
def test_the_driver_lifts_the_towel_and_feels_its_weight(tmp_path):
    """By the page's own node file and script, as two programs."""
    with node_of("grasp-a-towel", tmp_path):
        text = printed("grasp-a-towel", tmp_path)
    assert "hand holds 1 particle\n" in text
    weight = float(re.search(r"carries ([\d.]+) N", text)[1])
    assert weight == pytest.approx(0.13 * 0.4 * 0.4 * 9.81, rel=0.03)
