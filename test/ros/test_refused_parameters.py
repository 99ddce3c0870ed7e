"""What a running node refuses to take as a parameter: with the reason, and without harm."""

import math

import pytest
from client import Client, finite
from node_process import SMALL, NodeProcess
from rcl_interfaces.msg import Parameter as ParameterMsg
from rcl_interfaces.msg import ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from sensor_msgs.msg import PointCloud2


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
        ("cloth.resolution", [1, 1], "cloth.resolution is (1, 1); allowed is 2 whole numbers from 2 to"),
        ("cloth.resolution", [100000, 100000], "cloth.resolution is (100000, 100000); allowed is"),
        ("cloth.resolution", "big", "cloth.resolution is 'big'"),
        ("cloth.mesh", "/nowhere/shirt.obj", "cloth.mesh is '/nowhere/shirt.obj'; no such file is there"),
        ("cloth.bending", "wood", "cloth.bending is 'wood'; allowed is one of none, springs, dihedral"),
        ("gravity", [0.0, 0.0], "gravity is (0.0, 0.0); allowed is 3 finite numbers"),
        ("gravity", [0.0, 0.0, math.nan], "gravity is"),
        ("solver.substeps", -1, "solver.substeps out of range. Min: 0, Max: 10000"),
        ("ball.dimensions", [0.1, 0.2], "ball.dimensions is [0.1, 0.2]; a sphere has 1: radius [m]"),
        ("ball.orientation", [0.0, 0.0, 0.0, 0.0], "quaternion"),
        ("objects", ["other"], "read-only"),
        ("frame_id", "map", "read-only"),
        ("cloth.colour", "red", "there is no parameter cloth.colour"),
        ("cloth.masss", 1.0, "there is no parameter cloth.masss; did you mean cloth.mass?"),
    ],
)
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


def test_a_malformed_request_does_not_end_the_node(shared):
    malformed = ParameterMsg(name="cloth.mass", value=ParameterValue(type=77))
    service = shared.client.service(SetParameters, "/cloth_sim/set_parameters")
    service.call_async(SetParameters.Request(parameters=[malformed]))  # rclpy raises, so no answer comes
    shared.client.until(lambda: "a callback failed" in shared.log)
    assert shared.client.set("cloth.damping", 0.0).successful


def test_descriptors_tell_unit_range_and_effect(shared):
    mass = shared.client.describe("cloth.mass")
    assert mass.type == ParameterType.PARAMETER_DOUBLE
    assert "[kg]" in mass.description and "rebuilds the simulation" in mass.description
    assert (mass.floating_point_range[0].from_value, mass.floating_point_range[0].to_value) == (1e-9, 1e6)
    assert "live" in shared.client.describe("solver.substeps").description
    assert shared.client.describe("objects").read_only
    assert shared.client.describe("rope.segments").integer_range[0].from_value == 1
