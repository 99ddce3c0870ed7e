# SPDX-License-Identifier: Apache-2.0
"""A gripper as a joint of ros2_control, whose position tells the opening of the fingers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from rclpy.node import Node

from cloth_sim_ros.ros.topics import named_topic


@dataclass(frozen=True)
class Joint:
    """A joint, whose positions [m or rad] are `closed` with the fingers together and `open` with them `widest` [m]
    apart."""

    name: str
    closed: float
    open: float
    widest: float

    @classmethod
    def of(cls, values: Mapping[str, Any], gripper: str) -> Joint:
        """Return the joint of a gripper by its parameters."""
        ends = (values[f"{gripper}.{field}"] for field in ("joint_closed", "joint_open", "max_opening"))
        return cls(values[f"{gripper}.joint"] or gripper, *ends)

    @property
    def slope(self) -> float:
        """Ratio of opening to position. By virtual work the joint's effort is this times the force of a finger."""
        return self.widest / (self.open - self.closed)

    def position(self, opening: float) -> float:
        """Return the position at an opening [m]."""
        return self.closed + opening / self.slope

    def opening(self, position: float) -> float:
        """Return the opening [m] at a position, which may be beyond both ends."""
        return (position - self.closed) * self.slope


def topic_of(values: Mapping[str, Any], gripper: str, field: str, node: Node, kind: type) -> str:
    """Return the topic for messages of a `kind` that a gripper's parameter names; "" for none, see `named_topic`."""
    if values[f"{gripper}.joint_open"] == values[f"{gripper}.joint_closed"]:
        return ""
    return named_topic(values, f"{gripper}.{field}", node, kind)
