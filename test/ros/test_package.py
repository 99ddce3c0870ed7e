# SPDX-License-Identifier: Apache-2.0
"""package.xml names every ROS package that is used here, and what else has a rosdep key; setup.py names the rest."""

import ast
import os
import re
import subprocess
import sys
import xml.etree.ElementTree as ElementTree

from node_process import ROOT

KEYS = {"numpy": "python3-numpy", "scipy": "python3-scipy", "yaml": "python3-yaml"}  # of rosdep
# Import -> what pip brings it with.
BY_PIP = {"PIL": "matplotlib", "warp": "warp_lang", "websockets": "viser"}


def imported(folder: str) -> set[str]:
    """The top packages that the Python files of a folder import, but for ours and those of Python."""
    found = set()
    for path in (ROOT / folder).rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                found |= {alias.name.partition(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom):
                found.add(node.module.partition(".")[0])
    return found - {*sys.stdlib_module_names, "cloth_sim_ros"}


def by_pip() -> set[str]:
    """What setup.py asks pip for, always or as an extra, as its imports are spelled."""
    wanted = []
    for node in ast.walk(ast.parse((ROOT / "setup.py").read_text())):
        if isinstance(node, ast.keyword) and node.arg in ("install_requires", "extras_require"):
            value = ast.literal_eval(node.value)
            wanted += value if isinstance(value, list) else sum(value.values(), [])
    return {re.split("[<>=!]", each)[0].replace("-", "_") for each in wanted}


def test_all_that_is_imported_is_asked_for():
    root = ElementTree.parse(ROOT / "package.xml").getroot()
    named = {depend.text for depend in root.findall("exec_depend")}
    needed = imported("cloth_sim_ros") | imported("launch")
    assert named == {KEYS.get(name, name) for name in needed if KEYS.get(name, BY_PIP.get(name, name)) not in by_pip()}
    assert root.find("license").text == "Apache-2.0"


def test_every_source_file_here_names_the_licence():
    licence = ElementTree.parse(ROOT / "package.xml").getroot().find("license").text
    files = [ROOT / "setup.py"]
    for folder in ("cloth_sim_ros", "launch", "test"):
        files += (ROOT / folder).rglob("*.py")
    bare = [file for file in files if not file.read_text().startswith(f"# SPDX-License-Identifier: {licence}\n")]
    assert len(files) > 20 and not bare


def test_a_file_that_skips_itself_takes_no_other_along_where_launch_testing_looks_into_it(tmp_path):
    """As that of Jazzy does: what it imports may skip, and then its hook does."""
    hook = "def pytest_pycollect_makemodule(module_path, parent):\n    pytest.skip('', allow_module_level=True)\n"
    (tmp_path / "looks_into_files.py").write_text(f"import pytest\n\n\n{hook}")
    command = [sys.executable, "-m", "pytest", "-p", "looks_into_files", "-p", "no:cacheprovider", "--collect-only"]
    environment = {**os.environ, "PYTHONPATH": ":".join([str(tmp_path), *sys.path])}
    found = subprocess.run([*command, "test/test_layers.py"], cwd=ROOT, env=environment, capture_output=True, text=True)
    assert "test_no_import_runs_back" in found.stdout and found.returncode == 0, found.stdout + found.stderr
