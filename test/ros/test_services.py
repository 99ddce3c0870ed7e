# SPDX-License-Identifier: Apache-2.0
"""Pause, step, reset, diagnostics and the clock."""

import pytest
from client import fields, seconds
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from node_process import SMALL
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import PointCloud2
from std_srvs.srv import SetBool, Trigger

FRAME = 1 / 60


@pytest.fixture
def clouds(start, client):
    """The particles of the small scene's rope, which swings, on simulated time."""
    start(SMALL, "-p", "publish_clock:=true").ready()
    clouds = client.listen(PointCloud2, "/cloth_sim/rope/particles", 1)
    client.until(lambda: clouds)
    return clouds


def test_pause_step_reset(client, clouds):
    def newest():
        clouds.clear()
        client.until(lambda: len(clouds) > 1)
        return clouds[-1]

    refused = client.call(Trigger, "/cloth_sim/step")
    assert not refused.success and "pause it first" in refused.message
    assert client.call(SetBool, "/cloth_sim/pause", SetBool.Request(data=True)).success
    held = newest()
    client.spin(0.3)
    assert bytes(clouds[-1].data) == bytes(held.data) and clouds[-1].header.stamp == held.header.stamp
    for k in range(1, 4):
        assert client.call(Trigger, "/cloth_sim/step").success
        stepped = newest()
        assert seconds(stepped.header.stamp) - seconds(held.header.stamp) == pytest.approx(k * FRAME, abs=1e-6)
    assert bytes(stepped.data) != bytes(held.data)
    assert client.call(Trigger, "/cloth_sim/reset").success
    start = newest()
    assert fields(start)[:, 2] == pytest.approx(1.0, abs=1e-6)  # level again
    assert start.header.stamp == stepped.header.stamp  # time does not run backwards
    assert client.call(SetBool, "/cloth_sim/pause", SetBool.Request(data=False)).success
    client.until(lambda: fields(clouds[-1])[-1, 2] < 0.9)


def test_clock(client, clouds):
    ticks = client.listen(Clock, "/clock", 10)
    client.until(lambda: len(ticks) > 20)
    times = [seconds(tick.clock) for tick in ticks]
    steps = [b - a for a, b in zip(times[:-1], times[1:], strict=True)]
    assert min(steps) == pytest.approx(FRAME, abs=1e-6)
    stamps = {seconds(cloud.header.stamp) for cloud in clouds}
    assert stamps & set(times)


def test_diagnostics(client, clouds):
    arrays = client.listen(DiagnosticArray, "/diagnostics")
    client.call(Trigger, "/cloth_sim/reset")
    client.until(lambda: len(arrays) > 2)
    (status,) = arrays[-1].status
    values = {item.key: item.value for item in status.values}
    assert status.name == "/cloth_sim: simulation" and status.hardware_id
    assert status.level in (DiagnosticStatus.OK, DiagnosticStatus.WARN)
    for key in (
        "real_time_factor",
        "ms_per_frame",
        "ms_waiting",
        "max_strain",
        "max_penetration",
        "residual",
        "rope.kinetic_energy",
    ):
        assert float(values[key]) >= 0.0, key
    assert values["method"].startswith("auto: ") and values["resets"] == "1"
    apart = seconds(arrays[-1].header.stamp) - seconds(arrays[-2].header.stamp)
    assert 0.9 < apart < 2.0
