# SPDX-License-Identifier: Apache-2.0
"""Run the node: `ros2 run cloth_sim_ros cloth_sim_node` or `python -m cloth_sim_ros.ros`.

SIGINT and SIGTERM end it with status 0. ROS is imported only once they are handled and the middleware is set up.
"""

from __future__ import annotations

import gc
import os
import signal
import sys
import tempfile
from pathlib import Path
from typing import Any

from cloth_sim_ros.ros.surroundings import set_up
from cloth_sim_ros.signals import NUMBERS, Stop

SPIN_PERIOD = 0.5  # [s] at most between a signal and its effect: the middleware's wait is not interrupted by it


def main(arguments: list[str] | None = None) -> int:
    """Spin the node until a signal comes; return the exit status. Raises no exception."""
    stop = Stop()
    set_up()

    import rclpy
    from rclpy.logging import get_logger
    from rclpy.signals import SignalHandlerOptions

    from cloth_sim_ros.ros.parameters.file import readable_arguments

    log = get_logger("cloth_sim")
    try:
        with tempfile.TemporaryDirectory(prefix="cloth_sim_") as folder:
            given = sys.argv if arguments is None else arguments
            refuse_others(given[1:])
            arguments, keys = readable_arguments(given, Path(folder), log.error)
            rclpy.init(args=arguments, signal_handler_options=SignalHandlerOptions.NO)
    except Exception as error:
        print(f"cloth_sim: {error}", file=sys.stderr)
        return 1
    spin(stop, keys)
    for number in NUMBERS:  # a second one, while the interpreter ends, is no news
        signal.signal(number, signal.SIG_IGN)
    return 0


def refuse_others(arguments: list[str]) -> None:
    """Raise ValueError if there are arguments that are not for ROS, outside of --ros-args ... --."""
    others, is_for_ros = [], False
    for argument in arguments:
        if argument == ("--" if is_for_ros else "--ros-args"):
            is_for_ros = not is_for_ros
        elif not is_for_ros:
            others.append(argument)
    if others:
        allowed = "allowed is --ros-args and what follows it, such as --params-file FILE or -p NAME:=VALUE"
        raise ValueError(f"the arguments {' '.join(others)} are not known; {allowed}")


def spin(stop: Stop, keys: dict[str, list[str]]) -> None:
    """Run the node until `stop` is set, then shut everything down. keys: parameter file -> nodes that it is for."""
    # Collecting garbage takes a fifth of the import, and 0.1 s each time that a frame has to wait for it later.
    gc.disable()
    import rclpy
    import warp
    from rclpy.executors import SingleThreadedExecutor

    from cloth_sim_ros.ros.node import ClothSimNode

    gc.freeze()
    gc.enable()
    warp.config.log_level = warp.LOG_WARNING
    node = ClothSimNode()
    tell_lost_parameters(node, keys)
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    while not stop.is_set():
        try:
            executor.spin_once(timeout_sec=SPIN_PERIOD)
        except Exception as error:  # a malformed request raises inside rclpy; the node outlives it
            node.get_logger().error(f"a callback failed: {type(error).__name__}: {error}")
    ended = node.stop()
    executor.shutdown()
    node.destroy_node()
    rclpy.try_shutdown()
    if not ended:  # compiling, which cannot be interrupted: leave without waiting
        sys.stdout.flush()
        os._exit(0)


def tell_lost_parameters(node: Any, keys: dict[str, list[str]]) -> None:
    """Warn of parameter files for other nodes only, and of an empty scene if no file was given."""
    from cloth_sim_ros.ros.parameters.file import is_for

    log, name = node.get_logger(), node.get_fully_qualified_name()
    for path, found in keys.items():
        if not any(is_for(key, name) for key in found):
            keyed = ", ".join(found) or "no node with ros__parameters"
            log.warning(f"{path} is for {keyed} and none of it reaches this node; key it with {name} or /**")
    if not keys and not node.get_parameter("objects").value:
        log.warning("the scene is empty, as no parameters were given; start with --ros-args --params-file FILE")


if __name__ == "__main__":
    sys.exit(main())
