# SPDX-License-Identifier: Apache-2.0
"""The demonstration starts the node, feeds it, prints status lines and ends."""

import re
import subprocess
import sys

from node_process import ROOT

LINE = re.compile(
    r"real-time factor \d\.\d\d, \d+\.\d\d ms per frame, max strain \d+\.\d %, "
    r"messages out: (\d+) particles/s, (\d+) meshes/s"
)


def test_demo_runs_and_ends_by_itself():
    command = [sys.executable, "-m", "cloth_sim_ros.demo", "--seconds", "4"]
    result = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=120, check=False)
    assert result.returncode == 0, result.stderr
    lines = LINE.findall(result.stdout)
    assert len(lines) >= 3, result.stdout
    assert all(int(rate) > 0 for rate in lines[-1])
    assert "To look closer" in result.stdout
    assert "Traceback" not in result.stderr
