# SPDX-License-Identifier: Apache-2.0
"""Who speaks last acts: a parameter takes back what a topic set, also where its value is the one it already had."""

import pytest
from client import LATCHED, Client, fields
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Float64
from std_srvs.srv import Trigger
from visualization_msgs.msg import MarkerArray

SCENE = """
/**:
  ros__parameters:
    objects: [flag, rope]
    colliders: [plate]
    handles: [hand]  # idle, and room for a collider: kernels are those of all_inputs.py
    spare_colliders: 1
    gravity: [0, 0, -9.81]
    flag:
      {resolution: [6, 6], size: [0.5, 0.5], position: [0, 5, 0], orientation: [0.7071068, 0, 0, 0.7071068], pins: top,
       bending: dihedral, bend_compliance: 1000.0}
    rope:
      type: rope
      segments: 16
      start: [0, 0, 2]
      end: [0, 0, 0]
      winch: {enabled: true, length: 0.5, acceleration: 4.0, timeout: 60.0}
    plate: {shape: box, dimensions: [0.1, 0.6, 0.6], position: [0, 0, -5]}
    wind: {enabled: true}
    solver: {global_damping: 2.0}
"""


@pytest.fixture
def heights(start, client: Client):
    """The running node; lee() and end_of_rope() [m] are of the next frame."""
    node = start(SCENE).ready()
    clouds = {name: client.listen(PointCloud2, f"/cloth_sim/{name}/particles", 1) for name in ("flag", "rope")}

    def newest(name):
        clouds[name].clear()
        client.until(lambda: clouds[name])
        return fields(clouds[name][-1])

    node.lee = lambda: float(newest("flag")[:6, 1].mean() - 5.0)  # how far the wind along y has driven the free edge
    node.end_of_rope = lambda: float(newest("rope")[-1, 2])
    node.turn = lambda rate: client.publish("/cloth_sim/rope/winch", Float64(data=rate))
    return node


@pytest.mark.long
def test_calm_by_parameter_ends_a_wind_by_topic(heights, client):
    client.until(lambda: heights.lee() > 0.2, meanwhile=lambda: client.blow((0.0, 8.0, 0.0)))
    client.spin(0.5)
    assert heights.lee() > 0.2, "the wind blows on while nobody speaks"
    assert list(client.get("wind.velocity")) == [0.0, 0.0, 0.0]
    assert client.set("wind.velocity", [0.0, 0.0, 0.0]).successful
    client.spin(4.0)
    assert abs(heights.lee()) < 0.02


def rate_of(client, heights) -> float:
    """Speed of the rope's end downwards [m/s], over a second of stamps."""
    clouds = client.listen(PointCloud2, "/cloth_sim/rope/particles", 1)
    client.until(lambda: len(clouds) > 60)
    return float(fields(clouds[0])[-1, 2] - fields(clouds[60])[-1, 2])


@pytest.mark.long
def test_pay_out_by_parameter_stops_a_winch_set_by_topic(heights, client):
    client.until(lambda: heights.end_of_rope() < 1.45, meanwhile=lambda: heights.turn(0.2))
    assert rate_of(client, heights) == pytest.approx(0.2, rel=0.1)
    assert client.get("rope.winch.pay_out") == 0.0
    assert client.set("rope.winch.pay_out", 0).successful
    client.spin(0.2)
    assert abs(rate_of(client, heights)) < 0.01


def test_reset_stops_a_winch_set_by_topic(heights, client):
    client.until(lambda: heights.end_of_rope() < 1.4, meanwhile=lambda: heights.turn(0.4))
    assert client.call(Trigger, "/cloth_sim/reset").success
    client.spin(0.5)
    assert heights.end_of_rope() == pytest.approx(1.5, abs=0.01)


def test_a_rate_by_topic_ends_with_its_time(heights, client):
    assert client.set("rope.winch.timeout", 0.5).successful
    for _ in range(10):  # the node listens
        heights.turn(0.0)
        client.spin(0.02)
    assert "back to" not in heights.log
    before = heights.end_of_rope()
    heights.turn(0.6)
    heights.wait_for("rope/winch: no rate came for 0.5 s; back to rope.winch.pay_out, 0 m/s")
    client.spin(1.0)
    assert before - heights.end_of_rope() == pytest.approx(0.6 * 0.5, abs=0.06)
    client.spin(1.0)
    assert heights.log.count("no rate came") == 1
    assert before - heights.end_of_rope() == pytest.approx(0.6 * 0.5, abs=0.06)


def test_a_place_by_parameter_takes_a_collider_back(heights, client):
    rope = client.listen(PointCloud2, "/cloth_sim/rope/particles", 1)
    shown = client.listen(MarkerArray, "/cloth_sim/colliders", LATCHED)
    height = lambda: next(each.pose.position.z for each in shown[-1].markers if each.ns == "plate")  # noqa: E731
    client.until(lambda: shown and heights.end_of_rope() == pytest.approx(1.5, abs=0.01))
    aside = []
    for k in range(40):  # the plate pushes the rope's end along x, a move a frame, until the rope slips off
        client.move("plate", (-0.2 + 0.01 * k, 0.0, 1.5))
        heights.end_of_rope()
        aside.append(fields(rope[-1])[-1, 0] if rope else 0.0)
    client.until(lambda: height() == 1.5)
    client.spin(0.3)  # the last moves arrive
    assert max(aside) > 0.1
    assert list(client.get("plate.position")) == [0.0, 0.0, -5.0]
    assert client.set("plate.position", [0, 0, -5]).successful
    client.until(lambda: height() == -5.0)
    still = lambda: max(abs(fields(each)[-1, 0]) for each in rope[-60:]) < 0.05  # noqa: E731
    client.until(still)  # the end swings out where it hung, as nothing holds it aside any more
