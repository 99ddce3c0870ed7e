# SPDX-License-Identifier: Apache-2.0
"""Real nodes in processes of their own, and one client node here, on a ROS domain that no other session uses."""

from __future__ import annotations

import importlib.util
import os

os.environ["ROS_DOMAIN_ID"] = str(1 + os.getpid() % 100)
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
os.environ["PYTHONUNBUFFERED"] = "1"

import pytest

if importlib.util.find_spec("rclpy") is None:
    collect_ignore_glob = ["test_*.py"]
else:
    from client import Client
    from node_process import NodeProcess


@pytest.fixture
def client(ros):
    """A node to publish, subscribe and call services with."""
    node = Client()
    yield node
    node.destroy()


@pytest.fixture
def start(tmp_path):
    """Starts nodes on YAML text or files, and ends them: start(yaml_or_path, *arguments) -> NodeProcess."""
    processes = []

    def launch(parameters: str | None, *arguments: str) -> NodeProcess:
        processes.append(NodeProcess(parameters, arguments, tmp_path / f"node{len(processes)}"))
        return processes[-1]

    yield launch
    for process in processes:
        process.end()
