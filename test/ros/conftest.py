# SPDX-License-Identifier: Apache-2.0
"""Real nodes in processes of their own, and one client node here, on a ROS domain that no other session uses."""

from __future__ import annotations

import importlib.util
import os

os.environ["ROS_DOMAIN_ID"] = str(1 + os.getpid() % 100)
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
os.environ["PYTHONUNBUFFERED"] = "1"


if importlib.util.find_spec("rclpy") is None:
    collect_ignore_glob = ["test_*.py", "*/test_*.py"]
