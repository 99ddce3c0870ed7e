# SPDX-License-Identifier: Apache-2.0
"""How far a program is stands in one line of a terminal, and in no log."""

import os
import pty
import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
PROGRAM = "from cloth_sim_ros.status_line import show; show('half of it'); show('all of it'); show('')"


def test_a_log_stays_free_of_it():
    done = subprocess.run([sys.executable, "-c", PROGRAM], cwd=ROOT, capture_output=True, check=True)
    assert done.stdout + done.stderr == b""


def test_a_terminal_shows_the_newest():
    ours, its = pty.openpty()
    subprocess.run([sys.executable, "-c", PROGRAM], cwd=ROOT, stderr=its, check=True)
    os.close(its)
    shown = os.read(ours, 1000)
    os.close(ours)
    assert shown == b"\33[2Khalf of it\r\33[2Kall of it\r\33[2K\r"


def test_nobody_else_writes_over_a_line():
    files = [file for file in (ROOT / "cloth_sim_ros").rglob("*.py") if file.name != "status_line.py"]
    assert [file for file in files if re.search(r'end="\\r"|\\33\[|\\x1b\[|"\\r', file.read_text())] == []
