# SPDX-License-Identifier: Apache-2.0
"""Bad poses and winds: one clear warning each, the last good state kept, the node alive."""

import math

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from client import Client, fields, finite
from diagnostic_msgs.msg import DiagnosticArray
from node_process import NodeProcess
from sensor_msgs.msg import PointCloud2

NET = """
cloth_sim:
  ros__parameters:
    objects: [cloth]
    colliders: [ball]
    handles: [hand]                       # idle, and room for a collider: kernels are those of all_inputs.py
    spare_colliders: 1
    cloth: {resolution: [12, 12], pins: edges, position: [0.0, 0.0, 1.0], thickness: 0.01,
            bending: dihedral, bend_compliance: 1000.0}
    ball: {dimensions: [0.1], position: [0.0, 0.0, 0.0]}
    wind: {enabled: true}
    pose_timeout: 30.0                    # no silence of these tests lets an older stamp pass
"""
LEVEL = (0.0, 0.0, 0.0, 1.0)
BESIDE = (0.0, 0.0, 0.2)  # where the ball is before each bad message, below the net that it must not touch


@pytest.fixture(scope="module")
def net(ros, tmp_path_factory):
    """A node with a net held at its edges, a ball below it, and a client."""
    process = NodeProcess(NET, (), tmp_path_factory.mktemp("net") / "node").ready()
    process.client = Client()
    process.clouds = process.client.listen(PointCloud2, "/cloth_sim/cloth/particles", 1)
    process.client.until(lambda: process.clouds)
    yield process
    process.client.destroy()
    assert process.end() == 0


def warnings(net: NodeProcess) -> list[str]:
    return [line for line in net.log.splitlines() if "is refused" in line]


def one_warning(net: NodeProcess, bad, text: str) -> None:
    """`bad`, sent ten times, gives one warning with `text`, and the net stays as it is."""
    client = net.client
    client.move("ball", BESIDE)
    client.spin(0.2)
    before, shape = warnings(net), fields(net.clouds[-1])
    for _ in range(10):
        bad()
        client.spin(0.02)
    client.until(lambda: len(warnings(net)) > len(before))
    client.spin(0.2)
    (warning,) = warnings(net)[len(before) :]
    assert text in warning and len(warning) < 250
    assert not [line for line in net.log.splitlines() if line.startswith("[INFO] [1.0]")]
    assert net.alive() and finite(net.clouds[-1])
    assert np.abs(fields(net.clouds[-1]) - shape).max() < 0.05


NAN, INF = math.nan, math.inf


@pytest.mark.long
@pytest.mark.parametrize(
    ("position", "orientation", "header", "text"),
    [
        ((NAN, 0, 1), LEVEL, {}, "its position (nan, 0, 1) is not finite"),
        ((1e30, 0, 1), LEVEL, {}, "its position (1e+30, 0, 1) is beyond"),
        ((0, 0, 1), (0, 0, 0, 0), {}, "its orientation (0, 0, 0, 0) has norm 0, but must be of unit norm"),
        (
            (0, 0, 1),
            LEVEL,
            {"frame_id": "moon'\n[INFO] [1.0] [cloth_sim]: forged " + 10000 * "x"},
            "its frame_id is \"moon'\\n[INFO] [1.0] [cloth_sim]: ",
        ),
        ((0, 0, 1), LEVEL, {"stamp": Time(sec=1)}, "its stamp is"),
    ],
)
def test_bad_pose(net, position, orientation, header, text):
    one_warning(net, lambda: net.client.move("ball", position, orientation, **header), text)


@pytest.mark.parametrize(
    ("velocity", "header", "text"),
    [
        ((INF, 0, 0), {}, "its velocity (inf, 0, 0) is not finite"),
        ((0, 0, 1e9), {}, "its velocity (0, 0, 1e+09) is beyond 1000 m/s"),
        ((0, 0, 1), {"frame_id": "moon"}, "its frame_id is 'moon', but this node only knows 'world'"),
    ],
)
def test_bad_wind(net, velocity, header, text):
    one_warning(net, lambda: net.client.blow(velocity, **header), text)


def test_a_good_wind_is_told_while_the_parameter_keeps_what_was_set(net):
    client = net.client
    told = client.listen(DiagnosticArray, "/diagnostics", 1)

    def blows():
        return [value.value for value in told[-1].status[0].values if value.key == "wind.velocity"] if told else []

    client.until(lambda: blows() == ["[0.0, 0.5, 0.0]"], meanwhile=lambda: client.blow((0.0, 0.5, 0.0)))
    assert list(client.get("wind.velocity")) == [0.0, 0.0, 0.0]
    assert "/diagnostics tells which blows" in client.describe("wind.velocity").description
    assert client.set("wind.velocity", [0.0, 0.0, 0.0]).successful
    client.until(lambda: blows() == ["[0.0, 0.0, 0.0]"])


def test_a_good_pose_after_bad_ones_is_followed(net):
    client = net.client
    client.move("ball", (NAN, NAN, NAN))
    for k in range(60):
        client.move("ball", (0.0, 0.0, 0.2 + 0.015 * k), frame_id="")  # an empty frame is ours
        client.spin(0.02)
    client.spin(0.3)
    assert fields(net.clouds[-1])[:, 2].max() > 1.1


def test_orientation_near_unit_is_normalised(net):
    refused = len(warnings(net))
    net.client.move("ball", BESIDE, (0, 0, 0, 1.005))
    net.client.spin(0.3)
    assert len(warnings(net)) == refused
