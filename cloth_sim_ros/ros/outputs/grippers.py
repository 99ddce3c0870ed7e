# SPDX-License-Identifier: Apache-2.0
"""What grippers do, on ~/grippers/<gripper>/state and as joints."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Header

from cloth_sim_ros.ros.joints import Joint, topic_of
from cloth_sim_ros.ros.outputs.output import LATEST, Output, Stamp
from cloth_sim_ros.ros.world import World


class GripperStates(Output):
    """Opening [m], its speed [m/s] and the force [N] of each gripper, and the same of its joint."""

    def __init__(self, node: Node, values: Mapping[str, Any]):
        self._by_name = {}
        for name in values["grippers"]:
            fingers = Joint(name, 0.0, 1.0, 1.0)  # whose position is the opening
            told = [(fingers, node.create_publisher(JointState, f"~/grippers/{name}/state", LATEST))]
            topic = topic_of(values, name, "joint_states", node.get_logger())
            if topic:
                told.append((Joint.of(values, name), node.create_publisher(JointState, topic, LATEST)))
            self._by_name[name] = told
        self.publishers = [publisher for told in self._by_name.values() for _, publisher in told]
        self._header = Header(frame_id=values["frame_id"])

    def read(self, world: World, stamp: Stamp) -> None:
        """Sends the state at the end of a frame."""
        self._header.stamp.sec, self._header.stamp.nanosec = stamp
        for name, driver in world.grippers.drivers.items() if world.sim is not None else ():
            heard = [told for told in self._by_name[name] if told[1].get_subscription_count() > 0]
            force = driver.measure(world.sim) if heard else 0.0
            for joint, publisher in heard:
                message = JointState(header=self._header, name=[joint.name])
                message.position, message.velocity = [joint.position(driver.opening)], [driver.speed / joint.slope]
                message.effort = [abs(joint.slope) * force]
                publisher.publish(message)
