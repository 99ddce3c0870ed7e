# SPDX-License-Identifier: Apache-2.0
"""A winch by topic and by parameter, seen from another process; bad rates get one sentence each."""

import math

import pytest
from client import fields
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import WrenchStamped
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Float64

WINCH = """
cloth_sim:
  ros__parameters:
    objects: [rope, other]
    rope:
      type: rope
      segments: 16
      start: [0, 0, 2]
      end: [0, 0, 0]
      mass: 0.4
      stretch_compliance: 1.0e-4
      winch: {enabled: true, length: 0.5, acceleration: 4.0, longest: 1.5, timeout: 60.0}
    other: {type: rope, segments: 4}
    solver: {substeps: 8, global_damping: 1.0}
"""


@pytest.fixture
def winch(start, client):
    """The running node, and the end's height and the pull on the drum as they are now."""
    node = start(WINCH).ready()
    clouds = client.listen(PointCloud2, "/cloth_sim/rope/particles", 1)
    wrenches = client.listen(WrenchStamped, "/cloth_sim/rope/start/wrench", 1)
    client.until(lambda: clouds and wrenches)
    node.height = lambda: float(fields(clouds[-1])[-1, 2])
    node.pull = lambda: wrenches[-1].wrench.force.z
    node.turn = lambda rate: client.publish("/cloth_sim/rope/winch", Float64(data=rate))
    return node


def lines(node, text):
    return [line for line in node.log.splitlines() if text in line]


@pytest.mark.long
def test_pays_out_by_topic_up_to_its_limit_and_goes_on_after_a_rebuild(winch, client):
    client.spin(0.5)
    assert winch.height() == pytest.approx(1.5, abs=1e-3)
    client.until(lambda: winch.height() < 1.2, meanwhile=lambda: winch.turn(0.5))
    assert winch.pull() == pytest.approx(-9.81 * 0.2 * (2.0 - winch.height()), rel=0.1)
    assert client.set("other.segments", 5).successful
    winch.wait_for("simulating rope (17 particles), other (6 particles)")
    client.spin(0.2)
    assert winch.height() < 1.2, "what was paid out was forgotten"
    winch.wait_for("rope's winch stopped at 1.5 m, a limit set by winch.shortest, winch.longest or the rope itself")
    client.spin(0.3)
    assert winch.height() == pytest.approx(0.5, abs=0.01)
    told = client.listen(DiagnosticArray, "/diagnostics", 1)
    client.until(lambda: told)
    values = {pair.key: pair.value for pair in told[-1].status[0].values}
    assert float(values["rope.paid_out"]) == pytest.approx(1.5, abs=1e-3)
    assert float(values["rope.pay_out"]) == pytest.approx(0.0, abs=1e-3)


def test_the_example_holds_its_load(start, client):
    start("config/winch.yaml").ready()
    wrenches = client.listen(WrenchStamped, "/cloth_sim/cable/start/wrench", 1)
    client.until(lambda: wrenches)
    client.spin(1.5)
    assert wrenches[-1].wrench.force.z == pytest.approx(-9.81 * (5.0 + 0.1), rel=0.02)


def test_hauls_in_by_parameter(winch, client):
    assert client.set("rope.winch.pay_out", -0.5).successful
    client.until(lambda: winch.height() > 1.8)
    assert client.set("rope.winch.pay_out", 5.0).successful
    winch.wait_for("rope.winch.pay_out is 5 m/s and is cut to rope.winch.max_rate, 1 m/s")
    refused = client.set("rope.winch.shortest", 1.8)
    assert not refused.successful
    assert refused.reason.startswith("rope.winch.shortest is 1.8 with a longest of 1.5; allowed")


@pytest.mark.parametrize(
    ("rate", "text"),
    [
        (math.nan, "a message on rope/winch is refused: its rate nan is not finite"),
        (-math.inf, "a message on rope/winch is refused: its rate -inf is not finite"),
    ],
)
@pytest.mark.long
def test_a_bad_rate_is_refused_in_one_sentence(winch, client, rate, text):
    client.spin(0.5)
    client.until(lambda: text in winch.log, meanwhile=lambda: winch.turn(rate))
    for _ in range(5):
        winch.turn(rate)
        client.spin(0.05)
    assert len(lines(winch, "rope/winch")) == 1
    assert winch.height() == pytest.approx(1.5, abs=1e-3)


def test_a_rate_beyond_the_limit_is_cut_with_a_warning(winch, client):
    text = "a message on rope/winch is cut: its rate 9 m/s is beyond rope.winch.max_rate, 1 m/s"
    client.until(lambda: text in winch.log, meanwhile=lambda: winch.turn(9.0))
    for _ in range(5):
        winch.turn(9.0)
        client.spin(0.05)
    assert len(lines(winch, "is cut")) == 1
    client.until(lambda: winch.height() < 1.0)
    refusal = "other/winch is refused: other has no winch; set the parameter other.winch.enabled to true"
    client.until(lambda: refusal in winch.log, meanwhile=lambda: client.publish("/cloth_sim/other/winch", Float64()))


def test_a_rate_beyond_its_limit_is_told_once(winch, client):
    for rate in (5.0, 6.0, 7.0, 0.1, 8.0):
        assert client.set("rope.winch.pay_out", rate).successful
    winch.wait_for("rope.winch.pay_out is 8 m/s and is cut to rope.winch.max_rate, 1 m/s")
    told = [line for line in winch.log.splitlines() if "is cut to rope.winch.max_rate" in line]
    assert ["is 5 m/s" in told[0], "is 8 m/s" in told[1]] == [True, True] and len(told) == 2
