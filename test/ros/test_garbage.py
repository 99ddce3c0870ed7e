# SPDX-License-Identifier: Apache-2.0
"""Messages of garbage on every topic that comes in: the node goes on, answers, and stays finite."""

import math
import random

import all_inputs
import pytest
from client import finite
from rclpy.node import NodeNameNonExistentError
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import serialize_message
from sensor_msgs.msg import PointCloud2
from std_srvs.srv import Trigger

SCENE = """
/**:
  ros__parameters:
    objects: [cloth, cable]
    colliders: [ball]
    handles: [hand]
    grippers: [jaw]
    spare_colliders: 4
    wind: {enabled: true}
    cloth: {type: cloth, resolution: [5, 5], pins: corners, position: [0, 0, 1], tear_strain: 0.5}
    cable: {type: rope, segments: 6, start: [1, 0, 2], end: [1, 0, 1], winch: {enabled: true, length: 0.5}}
    ball: {shape: sphere, dimensions: [0.1], position: [0, 0, -3]}
    hand: {position: [0, 0, 3]}
    jaw: {joint_commands: /jaw_commands, joint_trajectory: /jaw_trajectory}
"""
NUMBERS = (0.0, -0.0, 1.0, -1.0, 0.5, 1e-300, 1e38, -1e300, 1e300, math.inf, -math.inf, math.nan)
WORDS = ("", "world", "jaw", "hand", "/", "~", "a b", "\u00e9\U0001f9f5", "x" * 5000, "{", "<robot")
RELIABLE = QoSProfile(depth=100, reliability=ReliabilityPolicy.RELIABLE)


def filled(rng, message):
    """The message with odd contents in every field, as its types allow."""
    for name, kind in message.get_fields_and_field_types().items():
        if kind.endswith("]") or kind.startswith("sequence"):
            inner = getattr(message, name)
            if not kind.startswith("sequence"):
                continue  # of fixed length, such as covariances
            item = kind.removeprefix("sequence<").split(",")[0].removesuffix(">")
            setattr(message, name, [value_of(rng, item, inner) for _ in range(rng.choice((0, 1, 2, 5)))])
        else:
            setattr(message, name, value_of(rng, kind, getattr(message, name)))
    return message


def value_of(rng, kind, like):
    """An odd value of a type of ROS."""
    if kind in ("double", "float"):
        number = rng.choice(NUMBERS)
        return number if kind == "double" or not 3e38 < abs(number) < math.inf else 1e38
    if kind == "string":
        return rng.choice(WORDS)
    if kind == "boolean":
        return rng.random() < 0.5
    if kind in ("octet", "byte"):
        return b"\0"
    for part in ("uint8", "int8", "uint16", "int16", "uint32", "int32", "uint64", "int64"):
        if kind == part:
            bits, low = int(part.lstrip("uint")), 0 if part[0] == "u" else 1
            least, most = -(1 << (bits - 1)) if low else 0, (1 << (bits - low)) - 1
            return rng.choice((least, most, 0, 1, min(rng.randrange(1000), most)))
    return filled(
        rng, type(like)() if not isinstance(like, (list, tuple)) and hasattr(like, "SLOT_TYPES") else made(kind)
    )


def made(kind):
    """An empty message of a type such as geometry_msgs/Point."""
    package, name = kind.split("/")
    module = __import__(f"{package}.msg", fromlist=[name])
    return getattr(module, name)()


def topics(client):
    """Topics that the node subscribes to, with their types; none before its name is discovered."""
    try:
        found = client.node.get_subscriber_names_and_types_by_node("cloth_sim", "/")
    except NodeNameNonExistentError:
        return {}
    return {name: kinds[0].replace("/msg/", "/") for name, kinds in found if "parameter_events" not in name}


@pytest.mark.parametrize(
    ("scene", "count", "seed"),
    [
        pytest.param(all_inputs.SCENE, 200, 0, id="few"),
        *(pytest.param(SCENE, 10_000, seed, marks=pytest.mark.long, id=f"many, {seed}") for seed in range(1, 4)),
    ],
)
def test_the_node_goes_on(start, client, scene, count, seed):
    node = start(scene).wait_for("all kernels are compiled")
    client.until(lambda: len(topics(client)) >= 6)
    kinds = {name: type(made(kind)) for name, kind in topics(client).items() if name != "/clock"}
    senders = {name: client.node.create_publisher(kind, name, RELIABLE) for name, kind in kinds.items()}
    client.until(lambda: all(sender.get_subscription_count() for sender in senders.values()))
    rng = random.Random(seed)
    for k in range(count):
        name = rng.choice(list(senders))
        message = filled(rng, kinds[name]())
        if k % 4 == 3:  # bytes that are no such message
            raw = bytearray(serialize_message(message))[: rng.randrange(4, 200)]
            raw[4:] = rng.randbytes(len(raw) - 4) if rng.random() < 0.5 else raw[4:]
            senders[name].publish(bytes(raw))
        else:
            senders[name].publish(message)
        if k % 50 == 49:
            assert client.call(Trigger, "/cloth_sim/reset").success and node.alive(), f"message {k} of seed {seed}"
    clouds = client.listen(PointCloud2, "/cloth_sim/cloth/particles")
    client.until(lambda: clouds)
    assert finite(clouds[-1]) and "Traceback" not in node.log, node.log[-3000:]
    assert node.log.count("is refused") > 5, "they have come"
    assert node.end() == 0
