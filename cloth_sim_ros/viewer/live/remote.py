# SPDX-License-Identifier: Apache-2.0
"""Client of a running cloth_sim node: its parameters, topics and services."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Point32, PolygonStamped, PoseStamped, Vector3Stamped, WrenchStamped
from rcl_interfaces.msg import ParameterDescriptor, ParameterEvent
from rclpy.node import Node
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.parameter_client import AsyncParameterClient
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.task import Future
from sensor_msgs.msg import PointCloud2
from shape_msgs.msg import Mesh
from std_srvs.srv import SetBool, Trigger
from visualization_msgs.msg import MarkerArray

NEWEST_ONLY = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
ENDS = ("start", "end")  # of a rope
_NAMES = ("objects", "colliders", "handles", "frame_id")


@dataclass
class Known:
    """Parameters of a node: all `values` and descriptors by name, and the names of each kind of owner."""

    values: dict[str, Any] = field(default_factory=dict)
    descriptors: dict[str, ParameterDescriptor] = field(default_factory=dict)

    def names(self, what: str) -> list[str]:
        """Return the names of the objects, colliders or handles."""
        return list(self.values.get(what) or ())

    def ropes(self) -> list[str]:
        """Return the names of the objects that are ropes."""
        return [name for name in self.names("objects") if self.values[f"{name}.type"] == "rope"]


@dataclass
class Seen:
    """Callbacks for messages of the node: see their types in `Remote.listen`."""

    cloud: Callable[[str, PointCloud2], None]
    topology: Callable[[str, Mesh], None]
    markers: Callable[[MarkerArray], None]
    report: Callable[[str, dict[str, str]], None]  # what the node says of itself, and its numbers
    load: Callable[[str, float], None]  # what feels it, its force [N]
    changed: Callable[[str, Any], None]  # a parameter, its new value
    wind: Callable[[tuple[float, float, float]], None]  # that somebody sends [m/s]


class Remote:
    """Client of the node `target`. Everything runs in the executor's thread of `node`.

    Raises ValueError if `target` is no valid name of a node.
    """

    def __init__(self, node: Node, target: str):
        try:
            self.node, self.target = node, node.resolve_topic_name(target)
        except Exception:
            raise ValueError(f"node is {target!r}; allowed is the name of a node, such as /robot/cloth_sim") from None
        self._parameters = AsyncParameterClient(node, self.target)
        self._subscriptions: list[Any] = []
        self._poses: dict[str, Any] = {}
        self._clients: dict[str, Any] = {}
        self._cuts = node.create_publisher(PolygonStamped, f"{self.target}/cut", 10)  # now: the first must not get lost

    @property
    def there(self) -> bool:
        """True if the node answers."""
        return self._parameters.services_are_ready()

    async def know(self) -> Known:
        """Request all parameters and their descriptors. Raises ValueError if the node is no cloth_sim node."""
        listed = await self._parameters.list_parameters([], 0)
        names = list(listed.result.names)
        values = await self._parameters.get_parameters(names)
        described = await self._parameters.describe_parameters(names)
        known = Known(
            {name: parameter_value_to_python(value) for name, value in zip(names, values.values, strict=True)},
            dict(zip(names, described.descriptors, strict=True)),
        )
        missing = [name for name in _NAMES if name not in known.values]
        if missing:
            raise ValueError(f"{self.target} has no parameter {missing[0]}; a cloth_sim node has it")
        return known

    def set(self, name: str, value: Any) -> Future:
        """Request a new value of a parameter; the result has `results`, one SetParametersResult."""
        return self._parameters.set_parameters([Parameter(name, value=value)])

    def get(self, names: list[str]) -> Future:
        """Request values of parameters; the result has `values`."""
        return self._parameters.get_parameters(names)

    def call(self, service: str, on: bool | None = None) -> Future | None:
        """Call `~/service`, a Trigger or, with `on`, a SetBool; return None if the service is not there."""
        kind = Trigger if on is None else SetBool
        if service not in self._clients:
            self._clients[service] = self.node.create_client(kind, f"{self.target}/{service}")
        client = self._clients[service]
        if not client.service_is_ready():
            return None
        return client.call_async(Trigger.Request() if on is None else SetBool.Request(data=on))

    def listen(self, known: Known, seen: Seen) -> None:
        """Subscribe to all topics of a scene."""
        for name in known.names("objects"):
            self._subscribe(PointCloud2, f"{name}/particles", partial(seen.cloud, name), NEWEST_ONLY)
            self._subscribe(Mesh, f"{name}/topology", partial(seen.topology, name), LATCHED)
        loads = [f"{rope}/{end}" for rope in known.ropes() for end in ENDS]
        loads += [f"{kind}/{name}" for kind in ("handles", "colliders") for name in known.names(kind)]
        for each in loads:
            heard = partial(self._load, each, seen)
            self._subscribe(WrenchStamped, f"{each}/wrench", heard, NEWEST_ONLY)
        self._subscribe(MarkerArray, "colliders", seen.markers, LATCHED)
        self._subscribe(Vector3Stamped, "wind", partial(self._wind, known.values["frame_id"], seen), NEWEST_ONLY)
        subscribe = self.node.create_subscription
        self._subscriptions += [
            subscribe(DiagnosticArray, "/diagnostics", partial(self._report, seen), 10),
            subscribe(ParameterEvent, "/parameter_events", partial(self._changed, seen), 100),
        ]

    def forget(self) -> None:
        """End all subscriptions, so that the node computes nothing for them."""
        for subscription in self._subscriptions:
            self.node.destroy_subscription(subscription)
        self._subscriptions.clear()

    def is_ours_alone(self, handle: str) -> bool:
        """Return True if nobody else sends poses to a handle."""
        topic = self._pose_topic(handle)
        return self.node.count_publishers(topic) == (1 if handle in self._poses else 0)

    def move(self, handle: str, position: np.ndarray, frame_id: str) -> None:
        """Send a pose [m] to a handle, stamped now."""
        if handle not in self._poses:
            self._poses[handle] = self.node.create_publisher(PoseStamped, self._pose_topic(handle), NEWEST_ONLY)
        message = PoseStamped()
        message.header.frame_id = frame_id
        message.header.stamp = self.node.get_clock().now().to_msg()
        message.pose.position.x, message.pose.position.y, message.pose.position.z = map(float, position)
        self._poses[handle].publish(message)

    def cut(self, polygon: np.ndarray, frame_id: str) -> None:
        """Cut all objects that tear along a flat polygon (n, 3) [m]."""
        message = PolygonStamped()
        message.header.frame_id = frame_id
        message.polygon.points = [Point32(x=x, y=y, z=z) for x, y, z in polygon.astype(float)]
        self._cuts.publish(message)

    def _pose_topic(self, handle: str) -> str:
        return f"{self.target}/handles/{handle}/pose"

    def _subscribe(self, kind: type, topic: str, heard: Callable, qos: QoSProfile) -> None:
        self._subscriptions.append(self.node.create_subscription(kind, f"{self.target}/{topic}", heard, qos))

    def _load(self, name: str, seen: Seen, message: WrenchStamped) -> None:
        force = message.wrench.force
        seen.load(name, float(np.linalg.norm((force.x, force.y, force.z))))

    def _wind(self, frame_id: str, seen: Seen, message: Vector3Stamped) -> None:
        if message.header.frame_id in ("", frame_id):  # others would need /tf
            seen.wind((message.vector.x, message.vector.y, message.vector.z))

    def _report(self, seen: Seen, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name == f"{self.target}: simulation":
                seen.report(status.message, {item.key: item.value for item in status.values})

    def _changed(self, seen: Seen, event: ParameterEvent) -> None:
        if event.node == self.target:
            for parameter in (*event.new_parameters, *event.changed_parameters):
                seen.changed(parameter.name, parameter_value_to_python(parameter.value))


def positions_of(cloud: PointCloud2) -> np.ndarray:
    """Return x y z (N, 3) [m] of a cloud of float32 fields."""
    numbers = np.frombuffer(cloud.data, np.float32).reshape(-1, cloud.point_step // 4)
    return numbers[:, :3].copy()
