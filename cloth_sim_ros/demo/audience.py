# SPDX-License-Identifier: Apache-2.0
"""The demonstration's own node: the one that feeds the simulation and watches what comes back."""

from __future__ import annotations

import math
import time

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped, Vector3Stamped
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import PointCloud2
from visualization_msgs.msg import Marker

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


class Audience(Node):
    """Moves the ball, makes the wind, counts messages and prints a line for each message on /diagnostics."""

    def __init__(self):
        super().__init__("cloth_demo")
        self.seen = False
        self._counts = {"particles": 0, "mesh": 0}
        self._begin: float | None = None  # when the node was there to be fed
        self._last = time.monotonic()
        newest = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
        self._ball = self.create_publisher(PoseStamped, "/cloth_sim/colliders/ball/pose", newest)
        self._wind = self.create_publisher(Vector3Stamped, "/cloth_sim/wind", newest)
        for kind, topic in ((PointCloud2, "particles"), (Marker, "mesh")):
            callback = self._counter(topic)
            self.create_subscription(kind, f"/cloth_sim/cloth/{topic}", callback, newest, raw=True)
        self.create_subscription(DiagnosticArray, "/diagnostics", self._print_status, 10)
        self.create_timer(1.0 / RATE, self._feed)

    def _counter(self, topic: str):
        def count(_):
            self._counts[topic] += 1
            self.seen = True

        return count

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
        self._wind.publish(wind)

    def _print_status(self, array: DiagnosticArray) -> None:
        now = time.monotonic()
        for status in array.status:
            if status.name.endswith("cloth_sim: simulation"):
                print(self._line(status, now - self._last), flush=True)
                self._counts = dict.fromkeys(self._counts, 0)
                self._last = now

    def _line(self, status: DiagnosticStatus, elapsed: float) -> str:
        values = {item.key: item.value for item in status.values}
        particles, meshes = (count / elapsed for count in self._counts.values())
        return (
            f"{status.message}: real-time factor {float(values['real_time_factor']):.2f}, "
            f"{float(values['ms_per_frame']):.2f} ms per frame, "
            f"max strain {100 * float(values.get('max_strain', 'nan')):.1f} %, "
            f"messages out: {particles:.0f} particles/s, {meshes:.0f} meshes/s"
        )
