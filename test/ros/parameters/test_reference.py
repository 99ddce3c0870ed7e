# SPDX-License-Identifier: Apache-2.0
"""docs/reference/parameters.md is what the table says, and nothing but ros/ imports ROS."""

import subprocess
import sys

from node_process import ROOT


def test_the_parameter_reference_is_up_to_date():
    command = [sys.executable, "-m", "cloth_sim_ros.ros.parameters.reference"]  # here, plugins of other tests are known
    printed = subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True).stdout
    assert (ROOT / "docs/reference/parameters.md").read_text() == printed, "run: make docs"


def test_the_solver_core_imports_without_ros():
    code = "import sys; import cloth_sim_ros.sim; sys.exit(any(name.startswith('rclpy') for name in sys.modules))"
    assert subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=False).returncode == 0
