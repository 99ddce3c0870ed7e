# SPDX-License-Identifier: Apache-2.0
"""Topics that parameters name."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rclpy.exceptions import InvalidTopicNameException
from rclpy.node import Node
from rclpy.validate_full_topic_name import validate_full_topic_name


def named_topic(values: Mapping[str, Any], parameter: str, node: Node, kind: type) -> str:
    """Return the topic for messages of a `kind` that a parameter names; "" for none.

    A topic that `node` cannot have gives "" and an error in the log.
    """
    topic = values[parameter]
    trouble = _trouble(topic, node, kind) if topic else ""
    if trouble:
        node.get_logger().error(f"{parameter} is '{topic}', left out: {trouble}")
    return "" if trouble else topic


def _trouble(topic: str, node: Node, kind: type) -> str:
    try:
        full = node.resolve_topic_name(topic)
        validate_full_topic_name(full)
    except (InvalidTopicNameException, RuntimeError) as error:  # RCLError is one
        return " ".join(str(error).split())
    if any(each.topic_name == full for each in node.publishers):
        return "this node sends on it, and would hear itself"
    others = [each.msg_type for each in node.subscriptions if each.topic_name == full]
    return f"this node takes {others[0].__name__} from it" if others and kind not in others else ""
