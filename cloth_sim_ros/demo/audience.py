# SPDX-License-Identifier: Apache-2.0
"""The demonstration's own node, which watches the messages of the simulation."""

from __future__ import annotations

import time
from collections.abc import Sequence

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rcl_interfaces.msg import ParameterDescriptor, SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import PointCloud2
from visualization_msgs.msg import Marker


class Audience(Node):
    """Counts the messages of `objects` and prints a line for each message on /diagnostics.

    Its parameter `scene` is one of `scenes`; setting it switches to another one.
    """

    def __init__(self, objects: Sequence[str], scene: str = "", scenes: Sequence[str] = ()):
        super().__init__("cloth_demo")
        self.seen, self.scene = False, scene
        described = ParameterDescriptor(description="The scene.", additional_constraints=" ".join(scenes))
        self.declare_parameter("scene", scene, described)
        self.add_on_set_parameters_callback(lambda parameters: self._choose(parameters, scenes))
        self._counts = {"particles": 0, "mesh": 0}
        self._last = time.monotonic()
        newest = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
        for kind, topic in ((PointCloud2, "particles"), (Marker, "mesh")):
            callback = self._counter(topic)
            for name in objects:
                self.create_subscription(kind, f"/cloth_sim/{name}/{topic}", callback, newest, raw=True)
        self.create_subscription(DiagnosticArray, "/diagnostics", self._print_status, 10)

    def _choose(self, parameters: Sequence[Parameter], scenes: Sequence[str]) -> SetParametersResult:
        for parameter in parameters:
            if parameter.name == "scene" and parameter.value not in scenes:
                allowed = f"allowed is one of {', '.join(scenes)}"
                return SetParametersResult(successful=False, reason=f"scene is {parameter.value!r}; {allowed}")
            if parameter.name == "scene":
                self.scene = parameter.value
        return SetParametersResult(successful=True)

    def _counter(self, topic: str):
        def count(_):
            self._counts[topic] += 1
            self.seen = True

        return count

    def _print_status(self, array: DiagnosticArray) -> None:
        now = time.monotonic()
        for status in array.status:
            if status.name.endswith("cloth_sim: simulation"):
                print(self._line(status, now - self._last), flush=True)
                self._counts = dict.fromkeys(self._counts, 0)
                self._last = now

    def _line(self, status: DiagnosticStatus, elapsed: float) -> str:
        values = {item.key: item.value for item in status.values}
        if not values:  # nothing is simulated at this time
            return status.message
        particles, meshes = (count / elapsed for count in self._counts.values())
        return (
            f"{status.message}: real-time factor {float(values['real_time_factor']):.2f}, "
            f"{float(values['ms_per_frame']):.2f} ms per frame, "
            f"max strain {100 * float(values.get('max_strain', 'nan')):.1f} %, "
            f"messages out: {particles:.0f} particles/s, {meshes:.0f} meshes/s"
        )
