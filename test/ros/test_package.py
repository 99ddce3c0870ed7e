# SPDX-License-Identifier: Apache-2.0
"""package.xml names every ROS package that is used here."""

import ast
import sys
import xml.etree.ElementTree as ElementTree

from node_process import ROOT

# With a rosdep key or by pip.
FOREIGN = {"numpy", "yaml", "warp", "trimesh", "scipy", "pytest", "rosbags", "viser", "websockets"}
FOREIGN |= {"matplotlib", "pygltflib", "imageio_ffmpeg", "tqdm"}


def imported(folder: str) -> set[str]:
    """The top packages that the Python files of a folder import."""
    found = set()
    for path in (ROOT / folder).rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                found |= {alias.name.partition(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom):
                found.add(node.module.partition(".")[0])
    return found


def test_it_names_what_is_imported_and_launched():
    needed = imported("cloth_sim_ros/ros") | imported("launch") | imported("cloth_sim_ros/demo")
    needed |= imported("cloth_sim_ros/viewer") | imported("cloth_sim_ros/record")
    needed -= {*sys.stdlib_module_names, "cloth_sim_ros", *FOREIGN}
    needed |= {"rviz2"}  # which the launch file starts
    root = ElementTree.parse(ROOT / "package.xml").getroot()
    assert needed <= {depend.text for depend in root.findall("exec_depend")}
    assert root.find("license").text == "Apache-2.0"


def test_every_source_file_here_names_the_licence():
    licence = ElementTree.parse(ROOT / "package.xml").getroot().find("license").text
    files = [ROOT / "setup.py"]
    for folder in ("cloth_sim_ros", "launch", "test"):
        files += (ROOT / folder).rglob("*.py")
    bare = [file for file in files if not file.read_text().startswith(f"# SPDX-License-Identifier: {licence}\n")]
    assert len(files) > 20 and not bare
