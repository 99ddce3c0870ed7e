# SPDX-License-Identifier: Apache-2.0
"""A demonstration: starts the node, swings a ball through the curtain, lets the breeze come and go, and watches.

Everything goes through the real topics; the status line is made of what arrives. Run it with `make demo`.
"""

from __future__ import annotations

import argparse
import math
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

LOOK_CLOSER = """
The ball and the breeze are fed by topic, particles and meshes come back as standard messages. To look closer:
  rviz2 -d config/cloth_sim.rviz                                    (with an installed ROS 2 Jazzy)
  ros2 topic hz /cloth_sim/cloth/particles
  ros2 param set /cloth_sim cloth.stretch_compliance 0.01           (softer, at once)
  ros2 service call /cloth_sim/reset std_srvs/srv/Trigger
Ctrl-C ends it.
"""


def main(arguments: list[str] | None = None) -> int:
    """Runs the demonstration until Ctrl-C, SIGTERM or --seconds; returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--config", type=Path, default=shared("config/curtain.yaml"), help="parameter file of the node")
    parser.add_argument("--seconds", type=float, default=math.inf, help="how long to run once messages arrive")
    options = parser.parse_args(arguments)
    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    print(f"Starting the node on {options.config} ...", flush=True)
    node = start_node(options.config)
    try:
        watch(stop, node, options.seconds)
    finally:
        node.terminate()
        status = node.wait(timeout=10.0)
    return status


def start_node(config: Path, *arguments: str) -> subprocess.Popen:
    """The node with the parameters of `config` and further ROS arguments, in a process of its own."""
    command = [sys.executable, "-m", "cloth_sim_ros.ros", "--ros-args", "--params-file", str(config), *arguments]
    # A process group of its own, so that Ctrl-C reaches this process alone, which then ends the node.
    return subprocess.Popen(command, start_new_session=True, env={**os.environ, "PYTHONUNBUFFERED": "1"})


def shared(path: str) -> Path:
    """A file that comes with the package: in a source tree, or installed by colcon or pip."""
    roots = [Path(__file__).parents[2]]
    roots += [Path(root) / "share/cloth_sim_ros" for root in os.environ.get("AMENT_PREFIX_PATH", "").split(":") if root]
    roots.append(Path(sys.prefix) / "share/cloth_sim_ros")
    return next((root / path for root in roots if (root / path).is_file()), roots[0] / path)


def watch(stop: threading.Event, node: subprocess.Popen, seconds: float) -> None:
    """Feeds and watches the node until `stop`, the node's own end, or `seconds` after the first message."""
    import rclpy
    from rclpy.executors import SingleThreadedExecutor
    from rclpy.signals import SignalHandlerOptions

    from cloth_sim_ros.demo.audience import Audience

    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    audience = Audience()
    executor = SingleThreadedExecutor()
    executor.add_node(audience)
    end, greeted = math.inf, False
    while not stop.is_set() and node.poll() is None and time.monotonic() < end:
        executor.spin_once(timeout_sec=0.1)
        if audience.seen and not greeted:
            print(LOOK_CLOSER, flush=True)
            end, greeted = time.monotonic() + seconds, True
    executor.shutdown()
    audience.destroy_node()
    rclpy.try_shutdown()


if __name__ == "__main__":
    sys.exit(main())
