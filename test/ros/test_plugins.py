# SPDX-License-Identifier: Apache-2.0
"""docs/how-to/extending.md, file by file: a shape, a force, a constraint and a topic that no file of ours knows."""

import re
import subprocess
import sys

import numpy as np
import pytest
from client import LATCHED, fields
from node_process import ROOT
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Float64
from visualization_msgs.msg import Marker, MarkerArray

BLOCKS = re.findall(
    r"^```(?:python|yaml)\n(.*?)^```", (ROOT / "docs/how-to/extending.md").read_text(), flags=re.DOTALL | re.MULTILINE
)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The files of the page, on the path of Python."""
    for block in BLOCKS:
        name = re.match(r"# (\w+\.(?:py|yaml))\n", block)
        if name:
            (tmp_path / name[1]).write_text(block)
    monkeypatch.setenv("PYTHONPATH", f"{tmp_path}:{ROOT}")
    return tmp_path


@pytest.mark.long
def test_a_node_has_them_from_yaml(start, client, folder):
    node = start((folder / "scene.yaml").read_text())
    drawn = client.listen(MarkerArray, "/cloth_sim/colliders", LATCHED)
    clouds = client.listen(PointCloud2, "/cloth_sim/towel/particles")
    energies = client.listen(Float64, "/cloth_sim/energy")
    client.until(lambda: drawn and clouds and energies)
    assert np.isfinite(energies[-1].data) and energies[-1].data >= 0.0
    cone = drawn[-1].markers[1]
    assert (cone.ns, cone.type, cone.pose.position.z) == ("tip", Marker.TRIANGLE_LIST, 0.3)
    top = max(cone.points, key=lambda point: point.z)
    assert (top.x, top.y, top.z) == pytest.approx((0.0, 0.0, 0.3)) and len(cone.points) % 3 == 0

    def height():
        return fields(clouds[-1])[:, 2].mean()

    client.spin(1.0)
    hanging = height()
    assert "-10 to 10" in client.set("pull.strength", 11.0).reason
    assert client.set("pull.strength", 0.01).successful
    client.until(lambda: height() > hanging + 0.05)
    x = fields(clouds[-1])
    assert all(np.linalg.norm(x[a] - x[b]) < 1.03 for a, b in ((0, 132), (11, 143)))
    assert client.set("leash.strain", 0.5).successful and client.get("leash.strain") == 0.5
    assert "left out" not in node.log and "ERROR" not in node.log


def test_a_plugin_that_is_not_there_is_named(start):
    scene = "/**:\n  ros__parameters: {plugins: [nowhere], forces: [pull], pull: {type: magnet}}\n"
    node = start(scene).ready()
    assert "plugins holds 'nowhere', left out: ModuleNotFoundError" in node.log
    assert "pull.type is 'magnet'; allowed is none, as no plugin adds any" in node.log


@pytest.mark.long
@pytest.mark.parametrize("block", [block for block in BLOCKS if "import" in block], ids=range(5))
def test_each_piece_of_code_runs_alone(block, folder):
    (folder / "piece.py").write_text(block)
    done = subprocess.run([sys.executable, folder / "piece.py"], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
