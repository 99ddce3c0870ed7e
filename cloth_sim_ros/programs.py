# SPDX-License-Identifier: Apache-2.0
"""Entry points of the installed programs. If ROS is missing, one sentence says how to get it, and the status is 1."""

from __future__ import annotations

import importlib
import importlib.util
import os
import signal
import sys

NO_ROS = "ROS 2 was not found: source /opt/ros/jazzy/setup.bash, or pip install 'cloth_sim_ros[ros]'"


def _run(module: str) -> int:
    if importlib.util.find_spec("rclpy") is None:
        print(f"{sys.argv[0].rpartition('/')[2]}: {NO_ROS}", file=sys.stderr)
        return 1
    # Importing takes a second. A library that is imported may swallow KeyboardInterrupt, so the signal itself ends it.
    before = signal.signal(signal.SIGINT, lambda number, frame: os._exit(128 + number))
    main = importlib.import_module(f"cloth_sim_ros.{module}").main
    signal.signal(signal.SIGINT, before)
    try:
        return main()
    except KeyboardInterrupt:  # before main() handles signals
        return 128 + signal.SIGINT


def node() -> int:
    """Run cloth_sim_node: the node."""
    return _run("ros.__main__")


def viewer() -> int:
    """Run cloth_sim_viewer: the page in a browser."""
    return _run("viewer.__main__")


def record() -> int:
    """Run cloth_sim_record BAG, which records a node."""
    return _run("record.recorder")


def replay() -> int:
    """Run cloth_sim_replay BAG, which computes a recording again."""
    return _run("record.replay")


def export() -> int:
    """Run cloth_sim_export BAG OUT, which writes a recording as glTF, movie or pictures."""
    return _run("record.export")


def driver() -> int:
    """Run cloth_sim_driver SCENE, which moves a scene."""
    return _run("demo.driver")


def demo() -> int:
    """Run cloth_sim_demo SCENE: node, driver and viewer."""
    return _run("demo.__main__")
