# SPDX-License-Identifier: Apache-2.0
"""Topics of the robot: its description, which sets a parameter, and the positions of its joints."""

from __future__ import annotations

import math

from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from cloth_sim_ros.parameters import shown
from cloth_sim_ros.ros.inputs.frames import Frames, Refused
from cloth_sim_ros.ros.inputs.messages import Complaints
from cloth_sim_ros.ros.inputs.pose_track import Pose
from cloth_sim_ros.ros.inputs.robot import GROUP, read_robot
from cloth_sim_ros.ros.outputs.output import LATCHED
from cloth_sim_ros.ros.parameters.bridge import ParameterBridge
from cloth_sim_ros.ros.topics import named_topic

JOINTS = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)  # each may tell of other joints


class RobotTopics:
    """The subscriptions of `node`, whose callbacks run in the executor's thread."""

    def __init__(self, node: Node, bridge: ParameterBridge, frames: Frames, complaints: Complaints):
        self._node, self._bridge, self._frames, self._complaints = node, bridge, frames, complaints
        self._positions: dict[str, float] = {}
        self._newest, self._urdf, self._robot = 0.0, "", None
        self._description = named_topic(bridge.values, "robot.description", node, String)
        if self._description:
            node.create_subscription(String, self._description, self._on_description, LATCHED)
        self._joint_states = named_topic(bridge.values, "robot.joint_states", node, JointState)
        if self._joint_states:
            frames.waits = self._joint_states
            node.create_subscription(JointState, self._joint_states, self._on_joints, JOINTS)

    def _on_description(self, message: String) -> None:
        if message.data == self._bridge.values["robot.urdf"]:
            return
        text = message.data if message.data.lstrip().startswith("<") else f"<{message.data}"  # never a path
        (result,) = self._node.set_parameters([Parameter("robot.urdf", value=text)])
        if not result.successful:
            self._complaints.refuse(self._description, Refused("description", result.reason))

    def _on_joints(self, message: JointState) -> None:
        values = self._bridge.values
        if not values["robot.urdf"]:
            return  # its description has not come yet
        try:
            if len(message.name) != len(message.position):
                raise Refused("length", f"it has {len(message.name)} names and {len(message.position)} positions")
            for name, position in zip(message.name, message.position, strict=True):
                if not math.isfinite(position):
                    raise Refused("finite", f"the position of its joint {shown(name)} is {position:g}")
            if self._urdf is not values["robot.urdf"]:
                self._robot = read_robot(values["robot.urdf"])
                self._urdf = values["robot.urdf"]
        except Refused as reason:
            self._complaints.refuse(self._joint_states, reason)
            return
        except ValueError:
            return  # the log says so where it was set
        self._positions |= zip(message.name, message.position, strict=True)
        stamp = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
        stamp = stamp or 1e-9 * self._node.get_clock().now().nanoseconds
        if 0.0 < self._newest - stamp < values["pose_timeout"]:
            stamp = self._newest  # of two senders one is a little behind
        self._newest = stamp
        places = self._robot.places(self._positions, Pose.of(values, GROUP))
        self._frames.links = {link: (stamp, pose) for link, pose in places.items()}
