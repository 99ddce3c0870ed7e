# SPDX-License-Identifier: Apache-2.0
"""What a running node refuses to take as a parameter: with the reason, and without harm."""

import math

import pytest
from client import Client, finite
from node_process import SMALL, NodeProcess
from rcl_interfaces.msg import Parameter as ParameterMsg
from rcl_interfaces.msg import ParameterType, ParameterValue
from rcl_interfaces.srv import (
    DescribeParameters,
    GetParameters,
    GetParameterTypes,
    ListParameters,
    SetParameters,
    SetParametersAtomically,
)
from rclpy.parameter import Parameter
from sensor_msgs.msg import PointCloud2

from cloth_sim_ros.ros.parameters import names


@pytest.fixture(scope="module")
def shared(ros, tmp_path_factory):
    """One running node, and its client, for tests that leave it as it is."""
    process = NodeProcess(SMALL, (), tmp_path_factory.mktemp("shared") / "node").ready()
    process.client = Client()
    process.clouds = process.client.listen(PointCloud2, "/cloth_sim/cloth/particles", 1)
    yield process
    process.client.destroy()
    assert process.end() == 0


@pytest.mark.parametrize(
    ("name", "value", "reason"),
    [
        ("cloth.stretch_compliance", "soft", "cloth.stretch_compliance is 'soft'; allowed is a finite number"),
        ("cloth.stretch_compliance", -1.0, "cloth.stretch_compliance"),
        ("cloth.stretch_compliance", math.nan, "cloth.stretch_compliance"),
        ("cloth.stretch_compliance", math.inf, "cloth.stretch_compliance"),
        ("cloth.stretch_compliance", True, "cloth.stretch_compliance is True"),
        ("cloth.resolution", [1, 1], "cloth.resolution is [1, 1]; allowed is 2 whole numbers from 2 to"),
        ("cloth.resolution", [100000, 100000], "cloth.resolution is [100000, 100000]; allowed is"),
        ("cloth.resolution", "big", "cloth.resolution is 'big'"),
        ("cloth.mesh", "/nowhere/shirt.obj", "cloth.mesh is '/nowhere/shirt.obj'; no such file is in"),
        ("cloth.bending", "wood", "cloth.bending is 'wood'; allowed is one of none, springs, dihedral"),
        ("gravity", [0.0, 0.0], "gravity is [0.0, 0.0]; allowed is 3 finite numbers"),
        ("gravity", [0.0, 0.0, math.nan], "gravity is"),
        ("solver.substeps", -1, "solver.substeps is -1; allowed is a whole number from 0 to 10000"),
        ("ball.dimensions", [0.1, 0.2], "ball.dimensions is [0.1, 0.2]; a sphere has 1: radius [m]"),
        ("ball.orientation", [0.0, 0.0, 0.0, 0.0], "quaternion"),
        ("state_file", "", "state_file is ''; allowed is the path of a file, where ~/ is your home"),
        ("state_file", "folder/..", "state_file is 'folder/..'; allowed is"),
        ("state_file", "~somebody/x.npz", "state_file is '~somebody/x.npz'; allowed is"),
        ("state_file", "two\nlines", "state_file is 'two\\nlines'; allowed is"),
        ("objects", ["other"], "read-only"),
        ("frame_id", "map", "read-only"),
        ("cloth.colour", "red", "there is no parameter cloth.colour"),
        ("cloth.masss", 1.0, "there is no parameter cloth.masss; did you mean cloth.mass?"),
    ],
)
@pytest.mark.long
def test_refused_with_the_reason(shared, name, value, reason):
    client = shared.client
    before = client.get(name)
    result = client.set(name, value)
    assert not result.successful
    assert reason in result.reason
    assert "\n" not in result.reason
    assert client.get(name) == before
    shared.clouds.clear()
    client.until(lambda: shared.clouds)
    assert finite(shared.clouds[0]) and shared.clouds[0].width == 30


def test_parameters_cannot_be_deleted(shared):
    request = SetParameters.Request(parameters=[Parameter("cloth.mass", Parameter.Type.NOT_SET).to_parameter_msg()])
    result = shared.client.call(SetParameters, "/cloth_sim/set_parameters", request).results[0]
    assert (result.successful, result.reason) == (False, "cloth.mass cannot be deleted")


def test_a_malformed_request_is_answered(shared):
    malformed = ParameterMsg(name="cloth.mass", value=ParameterValue(type=77))
    good = Parameter("cloth.damping", value=0.0).to_parameter_msg()
    request = SetParameters.Request(parameters=[malformed, good])
    results = shared.client.call(SetParameters, "/cloth_sim/set_parameters", request).results
    reason = "'cloth.mass' is sent as type 77; allowed are those of ParameterType, 0 to 9"
    assert [(result.successful, result.reason) for result in results] == [(False, reason), (True, "")]
    atomic = SetParametersAtomically.Request(parameters=[malformed, good])
    result = shared.client.call(SetParametersAtomically, "/cloth_sim/set_parameters_atomically", atomic).result
    assert (result.successful, result.reason) == (False, reason)


def test_every_question_is_answered(shared):
    """Also about names that are not there, in a list with others."""
    asked = ["cloth.mass", "no\nsuch", "", "x" * 5000, "objects"]
    kinds = {GetParameters: "get_parameters", GetParameterTypes: "get_parameter_types"}
    kinds |= {DescribeParameters: "describe_parameters"}
    answers = {
        kind: shared.client.call(kind, f"/cloth_sim/{name}", kind.Request(names=asked)) for kind, name in kinds.items()
    }
    values = answers[GetParameters].values
    assert values[0].double_value == pytest.approx(0.2) and list(values[4].string_array_value) == ["cloth", "rope"]
    types = [ParameterType.PARAMETER_DOUBLE, 0, 0, 0, ParameterType.PARAMETER_STRING_ARRAY]
    assert list(answers[GetParameterTypes].types) == [value.type for value in values] == types
    descriptors = answers[DescribeParameters].descriptors
    assert [descriptor.name for descriptor in descriptors] == asked
    assert [descriptor.type for descriptor in descriptors] == types
    listed = shared.client.call(ListParameters, "/cloth_sim/list_parameters", ListParameters.Request(prefixes=["rope"]))
    assert "rope.winch.timeout" in listed.result.names and "cloth.mass" not in listed.result.names
    refused = shared.client.set("forged\n[INFO] all is well", 1)
    assert not refused.successful and "\n" not in refused.reason


def test_a_mesh_of_no_use_is_refused_at_once(shared, tmp_path):
    assert shared.client.set("cloth.mesh", "m" * 5000).reason.startswith("cloth.mesh is 'mmmm")
    assert len(shared.client.set("cloth.mesh", "m" * 5000).reason) < 200
    file = tmp_path / "fins.obj"
    file.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nv 0 -1 0\nf 1 2 3\nf 1 2 4\nf 1 2 5\n")
    reason = "cloth has 3 triangles at edge 0-1; allowed are meshes with at most 2 an edge"
    request = SetParametersAtomically.Request(
        parameters=[
            Parameter("cloth.pins", value="none").to_parameter_msg(),
            Parameter("cloth.mesh", value=str(file)).to_parameter_msg(),
        ]
    )
    result = shared.client.call(SetParametersAtomically, "/cloth_sim/set_parameters_atomically", request).result
    assert (result.successful, result.reason) == (False, reason) and shared.client.get("cloth.pins") == "corners"


def test_descriptors_tell_unit_range_and_effect(shared):
    mass = shared.client.describe("cloth.mass")
    assert mass.type == ParameterType.PARAMETER_DOUBLE
    assert "[kg]" in mass.description and "live" in mass.description
    assert "rebuilds the simulation" in shared.client.describe("cloth.resolution").description
    assert (mass.floating_point_range[0].from_value, mass.floating_point_range[0].to_value) == (1e-9, 1e6)
    assert "live" in shared.client.describe("solver.substeps").description
    assert shared.client.describe("no.such").type == ParameterType.PARAMETER_NOT_SET
    assert shared.client.describe("objects").read_only
    assert shared.client.describe("rope.segments").integer_range[0].from_value == 1


NAMED = {"objects": ["cloth", "rope"], "colliders": ["ball"], "cloth.type": "cloth", "rope.type": "rope"}


def test_ranges_are_those_of_the_reference(shared):
    rows = {**names.fixed_rows(), **names.scene_rows(NAMED)}
    numbers = {name: row for name, row in rows.items() if row.kind in ("double", "integer")}
    request = DescribeParameters.Request(names=list(numbers))
    answer = shared.client.call(DescribeParameters, "/cloth_sim/describe_parameters", request)
    for descriptor, (name, row) in zip(answer.descriptors, numbers.items(), strict=True):
        ranges = descriptor.floating_point_range if row.kind == "double" else descriptor.integer_range
        assert [(r.from_value, r.to_value) for r in ranges] == [(row.low, row.high)], name
