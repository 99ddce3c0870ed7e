# SPDX-License-Identifier: Apache-2.0
"""Drives config/curtain.yaml: a ball swings through the curtain, and a breeze comes and goes.

The breeze ends for good where somebody sets the parameter wind.velocity, as by a slider of the viewer.
"""

from __future__ import annotations

import math
import time

from geometry_msgs.msg import PoseStamped, Vector3Stamped
from rcl_interfaces.msg import ParameterEvent
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy

RATE = 60.0  # [Hz] of the ball's poses
SWING_PERIOD = 6.0  # [s] of the ball, to and fro
GUST_PERIOD = 8.0  # [s] of the breeze


def ball_pose(t: float) -> tuple[float, float, float]:
    """Where the ball is at time t [s]: it swings through the curtain's plane y = 0, and from side to side."""
    phase = 2.0 * math.pi * t / SWING_PERIOD
    return 0.25 * math.sin(0.3 * phase), -0.6 * math.cos(phase), 1.0


def breeze(t: float) -> tuple[float, float, float]:
    """The wind at time t [s], in m/s."""
    return 0.0, 2.0 * math.sin(2.0 * math.pi * t / GUST_PERIOD) ** 2, 0.0


class Driver(Node):
    """Moves the ball and makes the wind."""

    def __init__(self):
        super().__init__("curtain_driver")
        newest = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
        self._ball = self.create_publisher(PoseStamped, "/cloth_sim/colliders/ball/pose", newest)
        self._wind = self.create_publisher(Vector3Stamped, "/cloth_sim/wind", newest)
        self._blows = True
        self.create_subscription(ParameterEvent, "/parameter_events", self._on_parameters, 100)
        self._begin: float | None = None  # when the node was there to be fed
        self.create_timer(1.0 / RATE, self._feed)

    def _feed(self) -> None:
        if self._begin is None:
            if not self._ball.get_subscription_count():
                return
            self._begin = time.monotonic()
        t = time.monotonic() - self._begin
        pose, wind = PoseStamped(), Vector3Stamped()
        pose.header.frame_id = wind.header.frame_id = "world"
        pose.header.stamp = wind.header.stamp = self.get_clock().now().to_msg()
        pose.pose.position.x, pose.pose.position.y, pose.pose.position.z = ball_pose(t)
        wind.vector.x, wind.vector.y, wind.vector.z = breeze(t)
        self._ball.publish(pose)
        if self._blows:
            self._wind.publish(wind)

    def _on_parameters(self, event: ParameterEvent) -> None:
        changed = {parameter.name for parameter in event.changed_parameters}
        if event.node == "/cloth_sim" and "wind.velocity" in changed:
            self._blows = False
