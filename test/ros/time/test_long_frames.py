# SPDX-License-Identifier: Apache-2.0
"""A frame that takes very long is told of, the node answers meanwhile, and it can be ended."""

import signal

import pytest
from client import fields
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from sensor_msgs.msg import PointCloud2
from std_srvs.srv import Trigger

SHEET = """
/**:
  ros__parameters:
    objects: [sheet]
    sheet: {resolution: [128, 128]}
    solver: {method: xpbd}
"""


@pytest.mark.long
def test_a_frame_without_end_is_told_of(start, client):
    node = start(SHEET).ready()
    clouds = client.listen(PointCloud2, "/cloth_sim/sheet/particles", 1)
    told = client.listen(DiagnosticArray, "/diagnostics", 1)
    client.until(lambda: clouds)
    assert client.set("solver.iterations", 10).successful
    assert client.set("solver.substeps", 10000).successful
    sentence = "s so far; fewer substeps or iterations, or coarser objects, take less"
    client.until(lambda: sentence in node.log, timeout=30.0)
    client.until(lambda: told and sentence in told[-1].status[0].message)
    assert told[-1].status[0].name == "/cloth_sim: simulation" and told[-1].status[0].level == DiagnosticStatus.WARN
    assert client.get("solver.substeps") == 10000
    busy = client.call(Trigger, "/cloth_sim/reset")
    assert not busy.success and "the simulation is busy; this takes effect when it is not" in busy.message
    assert client.set("solver.substeps", 10).successful, "a parameter is answered before it acts"
    assert len(fields(clouds[-1])) == 128 * 128
    assert node.end(signal.SIGINT) == 0 and "Traceback" not in node.log
