# SPDX-License-Identifier: Apache-2.0
"""What `make` installs, with a python that writes down what pip is asked for."""

import os
import shutil
import subprocess
from pathlib import Path

ROOT = Path(__file__).parents[2]
PYTHON = """#!/bin/bash
case "$1 $2" in
"-m venv") folder="${@: -1}"; rm -rf "$folder"; mkdir -p "$folder/bin"; cp "$0" "$folder/bin/python";;
"-m pip") echo "${@: -1}" >> asked;;
esac
"""


def test_extras_outlast_a_change_of_the_setup(tmp_path):
    for name in ("Makefile", "setup.py", "setup.cfg", "pyproject.toml"):
        shutil.copy(ROOT / name, tmp_path)
    python = tmp_path / "python"
    python.write_text(PYTHON), python.chmod(0o755)

    def asked_by(goal):
        (tmp_path / "asked").write_text("")
        subprocess.run(["make", goal, f"PYTHON={python}"], cwd=tmp_path, check=True, capture_output=True)
        return (tmp_path / "asked").read_text().split()

    def change():
        """Makes the environment older than setup.py."""
        os.utime(tmp_path / ".venv/ready-to-run", (0, 0))

    assert asked_by(".venv/ready-to-run") == [".[viewer]"]
    change()
    assert asked_by(".venv/ready-to-run") == [".[viewer]"]
    (extras,) = asked_by("extras")
    assert extras.startswith(".[viewer,record,")
    change()
    assert asked_by(".venv/ready-to-run") == [extras]
    assert asked_by(".venv/ready-to-run") == []
