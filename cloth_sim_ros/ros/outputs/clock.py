# SPDX-License-Identifier: Apache-2.0
"""The topic /clock, if the node is the source of time."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from builtin_interfaces.msg import Time
from rclpy.node import Node
from rosgraph_msgs.msg import Clock

from cloth_sim_ros.ros.outputs.output import LATEST, Output, Stamp
from cloth_sim_ros.ros.world import World


class ClockOutput(Output):
    """Simulated time, always sent."""

    is_heard = True

    def __init__(self, node: Node, values: Mapping[str, Any]):
        self.publishers = [node.create_publisher(Clock, "/clock", LATEST)]

    @classmethod
    def each(cls, node: Node, values: Mapping[str, Any]) -> Iterable[Output]:
        """Return one output if the parameter publish_clock is true and the node follows no clock itself."""
        if values["publish_clock"] and node.get_parameter("use_sim_time").value:
            sentence = "publish_clock is true with use_sim_time; a node cannot follow its own clock, and sends none"
            node.get_logger().error(sentence)
            return []
        return [cls(node, values)] if values["publish_clock"] else []

    def request(self, world: World, stamp: Stamp) -> None:
        """Send the time, before anything else that has this stamp."""
        self.publishers[0].publish(Clock(clock=Time(sec=stamp[0], nanosec=stamp[1])))
