# SPDX-License-Identifier: Apache-2.0
"""use_sim_time: frames, motion and stamps follow /clock, whoever sends it and however fast."""

import math

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from client import fields, seconds
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import PointCloud2

FALLING = """
/**:
  ros__parameters:
    objects: [rope]
    colliders: [ball]
    gravity: [0, 0, -2.0]
    rope: {type: rope, segments: 4, pins: none, start: [0, 0, 0], end: [1, 0, 0]}
    ball: {dimensions: [0.1], position: [0, 9, 0]}
"""
FRAME = 1 / 60


def stamp(t: float) -> Time:
    return Time(sec=int(t), nanosec=int(t % 1 * 1e9))


@pytest.fixture
def falling(start, client):
    """A node on use_sim_time whose rope falls freely; tick(t) sends /clock, heights is stamp -> height."""
    node = start(FALLING, "-p", "use_sim_time:=true").ready()
    node.clouds = client.listen(PointCloud2, "/cloth_sim/rope/particles", 100)
    publisher = client.node.create_publisher(Clock, "/clock", 10)
    client.until(lambda: publisher.get_subscription_count() > 0)
    node.tick = lambda t: publisher.publish(Clock(clock=stamp(t)))
    node.newest = lambda: seconds(node.clouds[-1].header.stamp) if node.clouds else -math.inf
    return node


def run(client, node, begin, end, step):
    """Ticks from `begin` to `end` [s], each once the frames up to the last one are there."""
    for t in np.arange(begin, end + 1e-9, step):
        # Sent again as long as it has not arrived, as /clock is taken best effort.
        client.until(lambda t=t: node.newest() > t - FRAME + 1e-5, meanwhile=lambda t=t: node.tick(t))


@pytest.mark.long
def test_one_frame_for_each_frame_dt_of_the_clock(falling, client):
    client.until(lambda: falling.log.count("no /clock above 0 comes") == 1)
    told = client.listen(DiagnosticArray, "/diagnostics", 1)
    client.until(lambda: told)
    assert told[0].header.stamp.sec > 1 and told[0].status[0].level == DiagnosticStatus.WARN
    assert told[0].status[0].message == "use_sim_time is set and no /clock above 0 comes"
    assert not falling.clouds, "nothing was sent, so nothing was stamped 0"
    for _ in range(5):  # the first tick is where time begins
        falling.tick(100.0)
        client.spin(0.05)
    assert not falling.clouds
    for begin, end, step in ((100 + FRAME, 100.5, FRAME), (100.6, 101.0, 0.1), (101.5, 102.0, 0.5)):
        run(client, falling, begin, end, step)
    stamps = np.array([seconds(cloud.header.stamp) for cloud in falling.clouds])
    assert stamps == pytest.approx(100.0 + FRAME * np.arange(1, 121), abs=2e-6)
    heights = np.array([fields(cloud)[:, 2].mean() for cloud in falling.clouds])
    assert heights == pytest.approx(-0.5 * 2.0 * (stamps - 100.0) ** 2, rel=0.05, abs=1e-3)
    client.until(lambda: told[-1].status[0].message == "follows /clock")
    assert seconds(told[-1].header.stamp) == pytest.approx(102.0, abs=1e-3)


@pytest.mark.long
def test_a_paused_clock_pauses_and_one_that_goes_back_starts_time_anew(falling, client):
    client.until(lambda: falling.log.count("no /clock above 0 comes") == 1)
    for _ in range(5):
        falling.tick(100.0)
        client.spin(0.05)
    run(client, falling, 100.1, 100.5, 0.1)
    frames, height = len(falling.clouds), fields(falling.clouds[-1])[:, 2].mean()
    for _ in range(20):
        falling.tick(100.5)
        client.spin(0.05)
    assert len(falling.clouds) == frames
    client.move("ball", (0.0, 8.0, 0.0), stamp=stamp(100.5))
    client.until(lambda: "went back" in falling.log, meanwhile=lambda: falling.tick(20.0))
    assert "/clock went back by 80.5 s: time starts anew there, objects go on as they are" in falling.log
    falling.clouds.clear()
    run(client, falling, 20.1, 20.5, 0.1)
    stamps = np.array([seconds(cloud.header.stamp) for cloud in falling.clouds])
    assert stamps == pytest.approx(20.0 + FRAME * np.arange(1, 31), abs=2e-6)
    fallen = fields(falling.clouds[-1])[:, 2].mean()
    assert height == pytest.approx(-(0.5**2), rel=0.05), "it fell for half a second"
    assert fallen == pytest.approx(-(1.0**2), rel=0.05), "and for another half from where it was"
    refused = falling.log.count("is refused")
    client.move("ball", (0.0, 7.0, 0.0), stamp=stamp(20.5))
    client.spin(0.3)
    assert falling.log.count("is refused") == refused, "stamps of before the jump are forgotten"
    client.until(lambda: "skips" in falling.log, meanwhile=lambda: falling.tick(1000.0))
    assert "/clock is 979.5 s ahead of the simulation, which skips that time" in falling.log


def test_parameters_act_while_the_clock_stands(falling, client):
    assert client.set("rope.segments", 8).successful
    falling.wait_for("simulating rope (9 particles)")
    client.until(lambda: falling.clouds, meanwhile=lambda: [falling.tick(t) for t in (5.0, 5.0 + 1.5 * FRAME)])
    assert falling.clouds[-1].width == 9 and falling.newest() >= 5.0
    assert client.set("use_sim_time", False).successful
    falling.clouds.clear()
    client.until(lambda: len(falling.clouds) > 10)
    assert falling.newest() > 1e9, "by the wall again"


def test_no_node_follows_its_own_clock(start, client):
    node = start(FALLING, "-p", "use_sim_time:=true", "-p", "publish_clock:=true").ready()
    assert "publish_clock is true with use_sim_time; a node cannot follow its own clock, and sends none" in node.log
    refused = client.set("use_sim_time", True)
    assert not refused.successful and "cannot follow its own clock" in refused.reason


def test_a_clock_below_0_or_none_or_one_that_jumps_fills_no_log(falling, client):
    falling.wait_for("no /clock above 0 comes")
    for k in range(150):
        falling.tick(-5.0 - 0.1 * k)
        client.spin(0.01)
    client.spin(6.0)
    assert falling.log.count("/clock") == 1, falling.log
    for k in range(200):
        falling.tick(1000.0 if k % 2 else 3000.0)
        client.spin(0.01)
    assert 1 < falling.log.count("/clock") < 5 and falling.alive()
    assert client.set("gravity", [0.0, 0.0, -1.0]).successful
