# SPDX-License-Identifier: Apache-2.0
"""What grippers do, on ~/grippers/<gripper>/state."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Header

from cloth_sim_ros.ros.outputs.output import LATEST, Output, Stamp
from cloth_sim_ros.ros.world import World


class GripperStates(Output):
    """Opening [m], its speed [m/s] and the force [N] of each gripper."""

    def __init__(self, node: Node, values: Mapping[str, Any]):
        self._by_name = {
            name: node.create_publisher(JointState, f"~/grippers/{name}/state", LATEST) for name in values["grippers"]
        }
        self.publishers = list(self._by_name.values())
        self._header = Header(frame_id=values["frame_id"])

    def read(self, world: World, stamp: Stamp) -> None:
        """Sends the state at the end of a frame."""
        self._header.stamp.sec, self._header.stamp.nanosec = stamp
        for name, driver in world.grippers.drivers.items() if world.sim is not None else ():
            if self._by_name[name].get_subscription_count() > 0:
                message = JointState(header=self._header, name=[name], position=[driver.opening])
                message.velocity, message.effort = [driver.speed], [driver.measure(world.sim)]
                self._by_name[name].publish(message)
