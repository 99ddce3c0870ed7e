# SPDX-License-Identifier: Apache-2.0
"""Grippers by the messages of ros2_control: commands and trajectories of a joint. No message is dropped."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory

from cloth_sim_ros.parameters import shown
from cloth_sim_ros.ros.inputs.frames import Refused
from cloth_sim_ros.ros.inputs.grippers import STRONGEST
from cloth_sim_ros.ros.inputs.messages import Complaints
from cloth_sim_ros.ros.joints import Joint, topic_of
from cloth_sim_ros.ros.parameters.bridge import ParameterBridge
from cloth_sim_ros.ros.time.loop import SimulationLoop
from cloth_sim_ros.ros.world import World

EVERY_ONE = QoSProfile(depth=100, reliability=ReliabilityPolicy.RELIABLE)
ROUNDING = 1e-3  # share of the widest opening by which a position may exceed its ends without a warning


class GripperJoints:
    """The subscriptions of `node`, whose callbacks run in the executor's thread.

    now(world) returns the time of stamps [ns]. A command waits in the loop's queue while the simulation is built. A
    command that arrives during a pause moves the fingers when the simulation goes on.
    """

    def __init__(
        self,
        node: Node,
        loop: SimulationLoop,
        bridge: ParameterBridge,
        complaints: Complaints,
        now: Callable[[World], int],
    ):
        self._loop, self._bridge, self._complaints, self._now = loop, bridge, complaints, now
        self._met: set[tuple[str, str]] = set()  # topics and grippers whose joint has come, or was told to be missing
        for gripper in bridge.values["grippers"]:
            for field, kind, read in (
                ("joint_commands", JointState, self._command),
                ("joint_trajectory", JointTrajectory, self._trajectory),
            ):
                topic = topic_of(bridge.values, gripper, field, node, kind)
                if topic:
                    node.create_subscription(kind, topic, partial(self._on, topic, gripper, read), EVERY_ONE)

    def _on(self, topic: str, gripper: str, read: Callable, message: Any) -> None:
        joint = Joint.of(self._bridge.values, gripper)
        names = message.name if isinstance(message, JointState) else message.joint_names
        if joint.name not in names:  # of other joints, as may well be; or its name is mistyped
            if (topic, gripper) not in self._met:
                self._complaints.ignore(topic, f"{gripper} is the joint {shown(joint.name)}, and it has {shown(names)}")
            self._met.add((topic, gripper))
            return
        self._met.add((topic, gripper))
        try:
            command = read(topic, gripper, joint, message)
        except Refused as reason:
            self._complaints.refuse(topic, reason)
            return
        self._loop.submit(command)

    def _command(self, topic: str, gripper: str, joint: Joint, message: JointState) -> Callable:
        """Return the loop's command for a message: an opening or, without a position, a force.

        NaN is no command, as in ros2_control. Raises Refused.
        """
        number = message.name.index(joint.name)
        position, effort = (
            _of_joint(getattr(message, what), number, len(message.name), what) for what in ("position", "effort")
        )
        if not math.isnan(position):
            return partial(self._set, gripper, "opening", self._opening(topic, joint, position))
        if math.isnan(effort):
            raise Refused("empty", f"it has neither a position nor an effort of its joint {joint.name}")
        force = effort / abs(joint.slope)
        if not 0.0 <= force <= STRONGEST:
            raise Refused("size", f"its effort {effort:g} is a force of {force:g} N, not from 0 to {STRONGEST:g}")
        return partial(self._set, gripper, "force", force)

    def _trajectory(self, topic: str, gripper: str, joint: Joint, message: JointTrajectory) -> Callable:
        """Return the loop's command for a trajectory. Raises Refused.

        Its times count from its stamp; a stamp of zero means now.
        """
        number, stamp = message.joint_names.index(joint.name), message.header.stamp
        begin = stamp.sec + 1e-9 * stamp.nanosec
        late = 1e-9 * self._now(self._loop.world) - begin if begin else 0.0
        points, before = [], -math.inf
        for point in message.points:
            position = _of_joint(point.positions, number, len(message.joint_names), "position")
            if math.isnan(position):
                raise Refused("empty", f"a point has no position of its joint {joint.name}")
            after = point.time_from_start.sec + 1e-9 * point.time_from_start.nanosec
            if after < 0.0 or after <= before:
                raise Refused("order", f"a point at {after:g} s follows one at {max(before, 0.0):g} s")
            before = after
            points.append((after - late, self._opening(topic, joint, position)))
        ahead = [point for point in points if point[0] > 0.0]
        return partial(self._move, gripper, ahead or [(0.0, points[-1][1])] if points else [])

    def _opening(self, topic: str, joint: Joint, position: float) -> float:
        """Return the opening [m] at a position of the joint, clipped to its range."""
        opening = joint.opening(position)
        if not -ROUNDING * joint.widest <= opening <= (1.0 + ROUNDING) * joint.widest:
            ends = f"{joint.closed:g} and {joint.open:g}"
            self._complaints.cut(topic, f"the position {position:g} of {joint.name} is not between {ends}")
        return min(max(opening, 0.0), joint.widest)

    def _set(self, gripper: str, what: str, value: float) -> None:
        self._loop.world.set_gripper(gripper, what, value)

    def _move(self, gripper: str, points: Sequence[tuple[float, float]]) -> None:
        self._loop.world.move_gripper(gripper, points)


def _of_joint(numbers: Sequence[float], number: int, count: int, what: str) -> float:
    """Return the number of a joint, NaN if the message has none. Raises Refused."""
    if len(numbers) == 0:
        return math.nan
    if len(numbers) != count:
        raise Refused("length", f"it has {count} names, and {len(numbers)} numbers as {what}")
    if math.isinf(numbers[number]):
        raise Refused("finite", f"its {what} {numbers[number]:g} is not finite")
    return numbers[number]
