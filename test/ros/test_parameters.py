"""Parameters of a running node, set through its service: coerced, live, or rebuilding."""

import numpy as np
import pytest
from client import fields, finite
from diagnostic_msgs.msg import DiagnosticArray
from node_process import SMALL
from sensor_msgs.msg import PointCloud2


@pytest.fixture
def node(start, client):
    """A running node with a small cloth, a rope and a ball."""
    process = start(SMALL).ready()
    process.clouds = client.listen(PointCloud2, "/cloth_sim/cloth/particles", 1)
    client.until(lambda: process.clouds)
    return process


def test_text_and_whole_numbers_count_as_decimals(node, client):
    for given, value in (("1e-6", 1e-6), (0, 0.0), (2e-3, 2e-3), (1, 1.0)):
        assert client.set("cloth.stretch_compliance", given).successful
        assert client.get("cloth.stretch_compliance") == value
    assert client.set("gravity", [0, 0, -2]).successful
    assert list(client.get("gravity")) == [0.0, 0.0, -2.0]
    assert client.set("solver.iterations", 2.0).successful
    assert client.get("solver.iterations") == 2


def test_structural_changes_rebuild_and_others_keep_their_state(node, client):
    ropes = client.listen(PointCloud2, "/cloth_sim/rope/particles", 1)
    client.until(lambda: ropes and fields(ropes[-1])[-1, 2] < 0.5)  # the rope swings down
    swung = fields(ropes[-1])[-1, 2]
    assert client.set("cloth.resolution", [9, 4]).successful
    client.until(lambda: node.clouds[-1].width == 36)
    ropes.clear()
    client.until(lambda: ropes)
    assert fields(ropes[0])[-1, 2] < 0.5 + swung, "the rope started anew"
    assert client.set("publish.velocities", True).successful
    client.until(lambda: [f.name for f in node.clouds[-1].fields] == ["x", "y", "z", "vx", "vy", "vz"])


def test_a_simulation_that_cannot_be_built_leaves_the_one_before(node, client):
    assert client.set("device", "cuda:77").successful
    node.wait_for("cannot build the simulation: device is 'cuda:77'")
    assert "the simulation before goes on" in node.log
    client.until(lambda: client.get("device") == "auto")
    node.clouds.clear()
    client.until(lambda: len(node.clouds) > 3)
    assert finite(node.clouds[-1])


def test_a_live_value_that_explicit_steps_cannot_hold_is_put_back(start, client):
    node = start(SMALL + "    solver: {method: verlet, substeps: 120}\n").ready()
    assert client.set("cloth.stretch_compliance", 2e-3).successful
    assert client.set("cloth.stretch_compliance", 1e-9).successful
    node.wait_for("cloth.stretch_compliance is put back: solver.substeps is 120 with method 'verlet'; allowed is")
    client.until(lambda: client.get("cloth.stretch_compliance") == 2e-3)


def test_auto_tells_in_log_and_diagnostics_how_each_object_is_computed(start, client):
    node = start(SMALL + "    solver: {method: auto, substeps: 120}\n").ready()
    node.wait_for("cloth is computed by verlet, since 120 substeps are at least the")
    assert client.set("cloth.stretch_compliance", 1e-9).successful
    node.wait_for("cloth is computed by xpbd order 2, since explicit steps would need")
    told = client.listen(DiagnosticArray, "/diagnostics", 1)
    client.until(lambda: told)
    values = {value.key: value.value for value in told[-1].status[0].values}
    assert "explicit steps would need" in values["cloth.method"] and values["method"].startswith("auto: ")
    clouds = client.listen(PointCloud2, "/cloth_sim/cloth/particles", 1)
    client.until(lambda: len(clouds) > 2)
    assert finite(clouds[-1])


def test_live_changes_act_on_the_motion(node, client):
    assert client.set("gravity", [0.0, 0.0, 9.81]).successful
    client.until(lambda: fields(node.clouds[-1])[:, 2].mean() > 2.0)
    assert client.set("ball.position", [0.0, 0.0, 1.0]).successful
    assert np.isfinite(fields(node.clouds[-1])).all()
