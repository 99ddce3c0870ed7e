# SPDX-License-Identifier: Apache-2.0
"""What the tests do on the ROS side: listen, publish, call services."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import rclpy
from geometry_msgs.msg import PoseStamped, Vector3Stamped
from patience import patience, tries
from rcl_interfaces.msg import Parameter as ParameterMsg
from rcl_interfaces.srv import DescribeParameters, GetParameters, SetParameters
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import PointCloud2

NEWEST_ONLY = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class Client:
    """A node of our own and its executor; the node under test is /cloth_sim."""

    def __init__(self):
        self.node = rclpy.create_node("test_client")
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self.node)
        self._publishers: dict[str, Any] = {}
        self._services: dict[str, Any] = {}

    def destroy(self) -> None:
        self._executor.shutdown()
        self.node.destroy_node()

    def listen(self, kind: type, topic: str, qos: QoSProfile | int = 10) -> list:
        """A list that fills with the messages that come."""
        messages: list = []
        self.node.create_subscription(kind, topic, messages.append, qos)
        return messages

    def until(self, condition: Callable[[], bool], timeout: float = 60.0, meanwhile: Callable = lambda: None) -> None:
        """Spins until `condition` holds, calling `meanwhile` between callbacks; fails after `patience(timeout)`."""
        for _ in tries(timeout):
            if condition():
                return
            meanwhile()
            self._executor.spin_once(timeout_sec=0.02)
        assert condition(), "waited in vain"

    def spin(self, seconds: float, meanwhile: Callable = lambda: None) -> None:
        """Spins for `seconds`."""
        end = time.monotonic() + seconds
        self.until(lambda: time.monotonic() > end, timeout=seconds + 10.0, meanwhile=meanwhile)

    def call(self, kind: type, name: str, request: Any = None, timeout: float = 30.0) -> Any:
        """The response of a service.

        Asks again every 10 s: Fast DDS loses a response that a server sends before it has discovered who asked.
        """
        service, asked = self.service(kind, name), []
        next_try = time.monotonic()

        def answered() -> bool:
            nonlocal next_try
            if time.monotonic() >= next_try:
                next_try += 10.0
                asked.append(service.call_async(request or kind.Request()))
            return any(future.done() for future in asked)

        self.until(answered, timeout)
        return next(future for future in asked if future.done()).result()

    def service(self, kind: type, name: str) -> Any:
        """The client of a service, once the service is there."""
        if name not in self._services:
            self._services[name] = self.node.create_client(kind, name)
            assert self._services[name].wait_for_service(patience(30.0)), f"no service {name}"
        return self._services[name]

    def set(self, name: str, value: Any) -> Any:
        """SetParametersResult of one parameter of the node under test."""
        request = SetParameters.Request(parameters=[Parameter(name, value=value).to_parameter_msg()])
        return self.call(SetParameters, "/cloth_sim/set_parameters", request).results[0]

    def get(self, name: str) -> Any:
        """The value of one parameter of the node under test."""
        response = self.call(GetParameters, "/cloth_sim/get_parameters", GetParameters.Request(names=[name]))
        return Parameter.from_parameter_msg(ParameterMsg(name=name, value=response.values[0])).value

    def describe(self, name: str) -> Any:
        """The descriptor of one parameter of the node under test."""
        request = DescribeParameters.Request(names=[name])
        return self.call(DescribeParameters, "/cloth_sim/describe_parameters", request).descriptors[0]

    def publish(self, topic: str, message: Any) -> None:
        """Publishes once; the first message on a topic waits for the node to listen."""
        if topic not in self._publishers:
            publisher = self._publishers[topic] = self.node.create_publisher(type(message), topic, NEWEST_ONLY)
            self.until(lambda: publisher.get_subscription_count() > 0)
        self._publishers[topic].publish(message)

    def move(self, collider: str, position: tuple, orientation: tuple = (0.0, 0.0, 0.0, 1.0), **header: Any) -> None:
        """Publishes a pose of `collider`, stamped now and in frame "world" unless `header` says otherwise."""
        message = PoseStamped()
        message.header.stamp = header.get("stamp", self.node.get_clock().now().to_msg())
        message.header.frame_id = header.get("frame_id", "world")
        p, q = message.pose.position, message.pose.orientation
        p.x, p.y, p.z = map(float, position)
        q.x, q.y, q.z, q.w = map(float, orientation)
        self.publish(f"/cloth_sim/colliders/{collider}/pose", message)

    def blow(self, velocity: tuple, frame_id: str = "world") -> None:
        """Publishes a wind [m/s]."""
        message = Vector3Stamped()
        message.header.frame_id = frame_id
        message.vector.x, message.vector.y, message.vector.z = map(float, velocity)
        self.publish("/cloth_sim/wind", message)


def fields(cloud: PointCloud2) -> np.ndarray:
    """The float32 fields of a decoded cloud, (N, fields)."""
    assert cloud.point_step == 4 * len(cloud.fields) and cloud.row_step == cloud.point_step * cloud.width
    assert [field.offset for field in cloud.fields] == [4 * k for k in range(len(cloud.fields))]
    return np.frombuffer(cloud.data, "<f4").reshape(cloud.height * cloud.width, len(cloud.fields))


def seconds(stamp: Any) -> float:
    """A stamp in seconds."""
    return stamp.sec + 1e-9 * stamp.nanosec


def finite(cloud: PointCloud2) -> bool:
    """Whether all numbers of a cloud are finite."""
    return bool(np.isfinite(fields(cloud)).all()) and math.isfinite(seconds(cloud.header.stamp))
