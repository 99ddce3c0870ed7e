# SPDX-License-Identifier: Apache-2.0
"""A user who is not root and has a home that cannot be written to; several nodes that compile at once."""

import os
import shutil
import subprocess
import sys

import pytest
import rclpy
from client import fields
from node_process import ROOT
from patience import tries
from sensor_msgs.msg import PointCloud2

SCENE = """
/**:
  ros__parameters:
    objects: [cloth]
    cloth: {type: cloth, resolution: [4, 4], pins: corners, position: [0, 0, 2]}
"""
NOBODY = 65534
# Who may read what root may, as Python may lie there, and writes as nobody.
AS_NOBODY = ["setpriv", f"--reuid={NOBODY}", f"--regid={NOBODY}", "--clear-groups"]
AS_NOBODY += [f"--{kind}-caps=-all,+dac_read_search" for kind in ("inh", "ambient")]
AS_NOBODY += ["--bounding-set=-all,+dac_read_search"]


@pytest.fixture
def running(tmp_path):
    """running(name, user, **environment) -> the process of a node of that name, and the file of its log."""
    processes = []
    scene = tmp_path / "scene.yaml"
    scene.write_text(SCENE)

    def run(name, user=(), **environment):
        command = [*user, sys.executable, "-m", "cloth_sim_ros.ros", "--ros-args", "--params-file", str(scene)]
        log = tmp_path / f"{name}.txt"
        with log.open("w") as said:
            process = subprocess.Popen(
                [*command, "-r", f"__node:={name}"],
                cwd=ROOT,
                env={**os.environ, **environment},
                stdout=said,
                stderr=subprocess.STDOUT,
            )
        processes.append(process)
        return process, log

    yield run
    for process in processes:
        process.kill()
        process.wait()


def simulates(process, log):
    """Waits until a node simulates."""
    for _ in tries(300.0, pause=0.1):
        assert process.poll() is None, log.read_text()
        if "all kernels are compiled" in log.read_text():
            return
    raise AssertionError(log.read_text())


@pytest.mark.long
def test_a_home_that_cannot_be_written_to(running, tmp_path, monkeypatch):
    """Logs and kernels go below the temporary folder, which only that user may write to."""
    user = ()
    if os.getuid() == 0:
        user = AS_NOBODY
        if not shutil.which("setpriv") or subprocess.run([*user, "true"], check=False).returncode:
            pytest.skip("root cannot become another user here")
    home, room = tmp_path / "home", tmp_path / "tmp"
    home.mkdir(mode=0o555)
    room.mkdir()
    for folder in (room, *tmp_path.parents[:2], tmp_path):
        folder.chmod(0o777 if folder == room else 0o755)
    given = {"HOME": str(home), "TMPDIR": str(room)}
    for variable in ("XDG_CACHE_HOME", "ROS_LOG_DIR", "ROS_HOME"):
        monkeypatch.delenv(variable, raising=False)
    process, log = running("guest", user, **given)
    simulates(process, log)
    assert not list(home.iterdir())
    (own,) = room.glob("cloth_sim_*")
    assert (
        own.stat().st_mode & 0o777 == 0o700
        and list(own.glob("xdg_cache_home/warp/*"))
        and "Error" not in log.read_text()
    )


@pytest.mark.long
def test_nodes_that_compile_at_once(running, client, tmp_path):
    """They share an empty folder of kernels."""
    nodes = [running(f"node{k}", WARP_CACHE_PATH=str(tmp_path / "kernels")) for k in range(3)]
    for process, log in nodes:
        simulates(process, log)
    clouds = [client.listen(PointCloud2, f"/node{k}/cloth/particles", 1) for k in range(3)]
    client.until(lambda: all(clouds))
    assert all(fields(each[-1]).shape == (16, 3) for each in clouds)
    assert not any("Traceback" in log.read_text() or "[ERROR]" in log.read_text() for _, log in nodes)


def test_a_node_whose_name_another_one_has_says_so(running, client):
    process, log = running("twin")
    simulates(process, log)
    assert "another node" not in log.read_text()
    other = rclpy.create_node("twin")
    client.until(lambda: "another node is named /twin too, and messages reach both; end it, or" in log.read_text())
    other.destroy_node()
