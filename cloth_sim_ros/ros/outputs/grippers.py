# SPDX-License-Identifier: Apache-2.0
"""State of the grippers, on ~/grippers/<gripper>/state and as joints."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rclpy.node import Node
from rclpy.publisher import Publisher
from sensor_msgs.msg import JointState
from std_msgs.msg import Header

from cloth_sim_ros.ros.joints import Joint, topic_of
from cloth_sim_ros.ros.outputs.output import LATEST, Output, Stamp
from cloth_sim_ros.ros.world import World
from cloth_sim_ros.sim import Simulation


class GripperStates(Output):
    """Opening [m], its speed [m/s] and the force [N] of each gripper, and the same of its joint.

    Joints that share a topic share a message, as ros2_control reads only the newest one.
    """

    def __init__(self, node: Node, values: Mapping[str, Any]):
        self._own = {
            name: node.create_publisher(JointState, f"~/grippers/{name}/state", LATEST) for name in values["grippers"]
        }
        self._shared: dict[str, Publisher] = {}
        for name in self._own:
            topic = values[f"{name}.joint_states"]
            if topic not in self._shared and topic_of(values, name, "joint_states", node, JointState):
                self._shared[topic] = node.create_publisher(JointState, topic, LATEST)
        self.publishers = [*self._own.values(), *self._shared.values()]
        self._header = Header(frame_id=values["frame_id"])
        self._told: list[tuple[Publisher, dict[str, Joint]]] = []  # the joints of grippers that each sends

    def attach(self, sim: Simulation | None, values: Mapping[str, Any]) -> None:
        """Adopt the joints and the widest openings of the parameters."""
        self._told = [(publisher, {name: Joint(name, 0.0, 1.0, 1.0)}) for name, publisher in self._own.items()]
        for topic, publisher in self._shared.items():
            names = [name for name in self._own if values[f"{name}.joint_states"] == topic]
            self._told.append((publisher, {name: Joint.of(values, name) for name in names}))

    def read(self, world: World, stamp: Stamp) -> None:
        """Send the state at the end of a frame."""
        self._header.stamp.sec, self._header.stamp.nanosec = stamp
        drivers = world.grippers.drivers if world.sim is not None else {}
        for publisher, joints in self._told:
            there = [(joint, drivers[name]) for name, joint in joints.items() if name in drivers]
            if there and publisher.get_subscription_count() > 0:
                message = JointState(header=self._header, name=[joint.name for joint, _ in there])
                message.position = [joint.position(driver.opening) for joint, driver in there]
                message.velocity = [driver.speed / joint.slope for joint, driver in there]
                message.effort = [abs(joint.slope) * driver.measure(world.sim) for joint, driver in there]
                publisher.publish(message)
