# SPDX-License-Identifier: Apache-2.0
"""Parameters of a running node, set through its service: coerced, live, or rebuilding."""

import numpy as np
import pytest
from client import fields, finite
from diagnostic_msgs.msg import DiagnosticArray
from node_process import SMALL
from sensor_msgs.msg import PointCloud2
from std_srvs.srv import SetBool

from cloth_sim_ros.sim.scene.materials import CORDS, FABRICS, spring_constants


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
    assert client.call(SetBool, "/cloth_sim/pause", SetBool.Request(data=True)).success
    ropes.clear()
    client.until(lambda: len(ropes) > 2)
    swung = fields(ropes[-1])
    assert client.set("cloth.resolution", [9, 4]).successful
    client.until(lambda: node.clouds[-1].width == 36)
    ropes.clear()
    client.until(lambda: ropes)
    assert np.array_equal(fields(ropes[0]), swung), "the rope started anew"
    assert client.call(SetBool, "/cloth_sim/pause", SetBool.Request(data=False)).success
    assert client.set("publish.velocities", True).successful
    client.until(lambda: [f.name for f in node.clouds[-1].fields] == ["x", "y", "z", "vx", "vy", "vz"])


def diagnostics(client) -> dict[str, str]:
    """What the node says of the simulation next but one."""
    told = client.listen(DiagnosticArray, "/diagnostics", 1)
    client.until(lambda: len(told) > 1 and told[-1].status[0].values, timeout=60.0)
    return {value.key: value.value for value in told[-1].status[0].values}


def method(client) -> str:
    """What computes now."""
    return diagnostics(client)["method"]


@pytest.mark.long
def test_a_cloth_is_kept_apart_from_itself_from_now_on(node, client):
    assert client.set("cloth.self_contact", True).successful
    client.until(lambda: "cloth.crossings" in diagnostics(client), timeout=60.0)
    assert diagnostics(client)["cloth.crossings"] == "0"


@pytest.mark.long
def test_what_cannot_be_is_refused_with_the_reason_and_what_is_taken_acts(node, client):
    refusals = {
        ("device", "cuda:77"): "device is 'cuda:77'; allowed is auto or one of cpu",
        ("device", ""): "device is ''; allowed is auto or one of cpu",
        ("solver.substeps", 2): "solver.substeps is 2 with method 'verlet'; allowed is at least",
        ("cloth.stretch_compliance", 0): "a spring of cloth too stiff for explicit steps; allowed is 'auto' or 'xpbd'",
        ("cloth.bending", "dihedral"): "",
        ("rope.bending", "angle"): "'verlet' with bending by angles of rope; allowed is 'auto' or 'xpbd'",
        ("rope.winch.enabled", True): "solver.method is 'verlet' with a winch on rope; allowed is 'auto' or 'xpbd'",
    }
    assert client.set("solver.method", "verlet").successful
    client.until(lambda: method(client).startswith("verlet"), timeout=60.0)
    for (name, value), reason in refusals.items():
        before, result = client.get(name), client.set(name, value)
        assert result.successful == (not reason) and reason in result.reason and "inf" not in result.reason, result
        assert client.get(name) == (before if reason else value)
    assert client.set("cloth.bending", "none").successful
    client.until(lambda: method(client).startswith("verlet"), timeout=60.0)
    built = node.log.count("building the simulation")
    assert built == 4, "the start and three changes that were taken"
    assert client.set("solver.method", "auto").successful and client.set("rope.stretch_compliance", 0.0).successful
    refused = client.set("solver.method", "verlet")
    assert not refused.successful and "a spring of rope too stiff" in refused.reason and "inf" not in refused.reason
    node.clouds.clear()
    client.until(lambda: len(node.clouds) > 3)
    assert finite(node.clouds[-1]) and method(client).startswith("auto: ")
    assert "put back" not in node.log and "cannot build" not in node.log


def test_what_is_set_without_effect_is_said_in_the_answer(node, client):
    remarks = {
        ("wind.velocity", (1.0, 0.0, 0.0)): "wind.velocity acts only where wind.enabled is not false",
        ("cloth.bend_compliance", 2.0): "cloth.bend_compliance acts only where cloth.bending is not none",
        ("rope.winch.pay_out", 0.5): "rope.winch.pay_out acts only where rope.winch.enabled is not false",
        ("cloth.shear_compliance", 2e-3): "",
        ("cloth.shear", False): "",
        ("gravity", (0.0, 0.0, -5.0)): "",
    }
    for (name, value), remark in remarks.items():
        result = client.set(name, list(value) if isinstance(value, tuple) else value)
        assert (result.successful, result.reason) == (True, remark)


def test_a_thickness_that_may_be_in_millimetres_is_said_in_answer_and_log(node, client):
    said = {
        "cloth.thickness": "cloth.thickness is 1 m for a cloth of 1 m; usual is up to 0.1 m, and 1 mm is 0.001",
        "rope.radius": "rope.radius is 1 m for a rope of 1 m; usual is up to 0.1 m, and 1 mm is 0.001",
    }
    for name, sentence in said.items():
        result = client.set(name, 1.0)
        assert (result.successful, result.reason) == (True, sentence)
        node.wait_for(sentence)
        assert client.set(name, 0.001).reason == ""


def test_more_kinetic_than_static_friction_is_said_in_answer_and_log(node, client):
    said = "kinetic_friction of cloth is 0.5, above its static_friction, 0.25; usual is at most that"
    assert client.set("cloth.kinetic_friction", 0.5).reason == ""
    result = client.set("cloth.static_friction", 0.25)
    assert (result.successful, result.reason) == (True, said)
    node.wait_for(said)
    assert client.set("cloth.kinetic_friction", 0.25).reason == "" and node.log.count("usual is at most that") == 1
    assert (
        client.set("cloth.static_friction", 0.5).reason == "" and client.set("cloth.kinetic_friction", 0.4).successful
    )


def test_too_many_sweeps_are_refused(node, client):
    assert client.set("solver.substeps", 10000).successful
    refused = client.set("solver.iterations", 1000)
    reason = (
        "solver.substeps 10000 times solver.iterations 1000 are 10000000 sweeps a frame; allowed are at most 100000"
    )
    assert (refused.successful, refused.reason) == (False, reason)


def test_auto_tells_in_log_and_diagnostics_how_each_object_is_computed(start, client):
    node = start(SMALL + "    solver: {method: auto, substeps: 120}\n").ready()
    node.wait_for("cloth is computed by xpbd order 2 in 120 x 1")
    assert client.set("solver.substeps", 0).successful
    client.until(lambda: "in 120 x 1" not in diagnostics(client)["cloth.method"])
    values = diagnostics(client)
    assert "is computed by xpbd order 2 in" in values["cloth.method"] and values["method"].startswith("auto: ")
    clouds = client.listen(PointCloud2, "/cloth_sim/cloth/particles", 1)
    client.until(lambda: len(clouds) > 2)
    assert finite(clouds[-1])


def test_live_changes_act_on_the_motion(node, client):
    assert client.set("gravity", [0.0, 0.0, 9.81]).successful
    client.until(lambda: fields(node.clouds[-1])[:, 2].mean() > 2.0)
    assert client.set("ball.position", [0.0, 0.0, 1.0]).successful
    assert np.isfinite(fields(node.clouds[-1])).all()


OF_COTTON = """
cloth_sim:
  ros__parameters:
    objects: [cloth, line]
    cloth: {type: cloth, material: cotton, resolution: [6, 6], size: [0.5, 0.4], damping: 0.001}
    line: {type: rope, material: steel cable, segments: 8, start: [0, 0, 1], end: [2, 0, 1]}
"""


def test_a_material_sets_what_the_file_does_not(start, client):
    start(OF_COTTON).ready()
    cotton, steel = FABRICS["cotton"], CORDS["steel cable"]
    assert client.get("cloth.mass") == pytest.approx(0.2 * cotton.areal_mass)
    assert client.get("cloth.bending") == "dihedral"
    assert client.get("cloth.bend_compliance") == pytest.approx(1.0 / cotton.bend_warp)
    diagonal = spring_constants(cotton.warp, cotton.weft, cotton.shear, cell=(0.5, 0.4))[2]  # of as many cells each way
    assert client.get("cloth.shear_compliance") == pytest.approx(1.0 / diagonal)
    assert client.get("cloth.damping") == 0.001, "the file set it"
    assert client.get("line.mass") == pytest.approx(2.0 * steel.linear_mass)
    assert client.get("line.stretch_compliance") == pytest.approx(1.0 / steel.stretch)
    assert client.get("line.bending") == "angle"


def test_a_material_may_change_and_what_was_set_stays(start, client):
    node = start(OF_COTTON).ready()
    denim = FABRICS["denim"]
    assert client.set("cloth.static_friction", 0.1).successful
    assert client.set("cloth.material", "denim").successful
    assert client.get("cloth.mass") == pytest.approx(0.2 * denim.areal_mass)
    assert client.get("cloth.bend_compliance") == pytest.approx(1.0 / denim.bend_warp)
    assert client.get("cloth.weft_bend_compliance") == pytest.approx(1.0 / denim.bend_weft)
    assert (client.get("cloth.static_friction"), client.get("cloth.damping")) == (0.1, 0.001)
    assert client.set("cloth.size", [1.0, 1.0]).successful
    assert client.get("cloth.mass") == pytest.approx(denim.areal_mass)
    for wrong in ([1, 1], [0, 4], [4]):
        refused = client.set("cloth.resolution", wrong)
        assert not refused.successful and refused.reason.startswith("cloth.resolution is [")
        assert refused.reason.endswith("allowed is 2 whole numbers from 2 to 2048")
    for wrong in ([0.0, 1.0], [1.0], [float("nan"), 1.0]):
        assert client.set("cloth.size", wrong).reason.endswith("allowed is 2 finite numbers from 0.0001 to 10000 [m]")
    refused = client.set("cloth.material", "tweed")
    assert not refused.successful
    assert refused.reason == f"cloth.material is 'tweed'; allowed is one of {', '.join(FABRICS)}"
    assert client.get("cloth.material") == "denim"
    assert client.set("cloth.material", "").successful
    assert (client.get("cloth.mass"), client.get("cloth.bending")) == (0.2, "none")
    clouds = client.listen(PointCloud2, "/cloth_sim/cloth/particles", 1)
    client.until(lambda: len(clouds) > 2)
    assert finite(clouds[-1]) and "accepted but not applied" not in node.log
