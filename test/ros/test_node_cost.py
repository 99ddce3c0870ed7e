# SPDX-License-Identifier: Apache-2.0
"""The measure of what a node costs that nobody listens to."""

import subprocess
import sys

import numpy as np
import pytest
from node_process import ROOT, SMALL
from patience import patience

from cloth_sim_ros.demo import node_cost


@pytest.mark.long
def test_it_compares_a_node_with_the_simulation_alone(tmp_path):
    config = tmp_path / "small.yaml"
    config.write_text(SMALL)
    command = [sys.executable, "-m", "cloth_sim_ros.demo.node_cost", "--config", str(config)]
    command += ["--seconds", "0.5", "--rounds", "2"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=patience(180))
    assert done.returncode == 0, done.stderr
    told = [float(line.split(": ")[1].split()[0]) for line in done.stdout.splitlines() if " times that" in line]
    assert len(told) == 2 and 0.0 < told[0] <= told[1], "the whole node is more than its thread"


def test_ratios_are_those_of_each_window():
    rows = np.array([(1.1, 1.2, 1.0), (2.2, 2.6, 2.0), (3.3, 4.2, 3.0)])
    _, thread, whole = node_cost.table(rows).splitlines()
    assert thread.endswith("1.100 times that, quartiles 1.100 and 1.100, 3 windows")
    assert whole.endswith("1.300 times that, quartiles 1.250 and 1.350, 3 windows")
