"""Runs the node: `ros2 run cloth_sim_ros cloth_sim_node` or `python -m cloth_sim_ros.ros`.

SIGINT and SIGTERM end it with status 0. ROS is imported only once they are handled and the middleware is set up.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
from pathlib import Path

SPIN_PERIOD = 0.1  # [s] at most between a signal and its effect: the middleware's wait is not interrupted by it


def main(arguments: list[str] | None = None) -> int:
    """Spins the node until a signal comes; returns the exit status."""
    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    set_up_large_messages()

    import rclpy
    from rclpy.logging import get_logger
    from rclpy.signals import SignalHandlerOptions

    from cloth_sim_ros.ros.params_file import readable_arguments

    log = get_logger("cloth_sim")
    try:
        arguments = readable_arguments(sys.argv if arguments is None else arguments, log.error)
        rclpy.init(args=arguments, signal_handler_options=SignalHandlerOptions.NO)
    except Exception as error:
        print(f"cloth_sim: {error}", file=sys.stderr)
        return 1
    spin(stop)
    return 0


def spin(stop: threading.Event) -> None:
    """Runs the node until `stop` is set, then takes everything down."""
    import rclpy
    import warp
    from rclpy.executors import SingleThreadedExecutor

    from cloth_sim_ros.ros.node import ClothSimNode

    warp.config.log_level = warp.LOG_WARNING
    node = ClothSimNode()
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


def set_up_large_messages() -> None:
    """Has Fast DDS send large messages through shared memory, unless the user has chosen a setting."""
    if "FASTDDS_BUILTIN_TRANSPORTS" not in os.environ:
        profile = Path(__file__).with_name("fastdds.xml")
        os.environ.setdefault("FASTRTPS_DEFAULT_PROFILES_FILE", str(profile))


if __name__ == "__main__":
    sys.exit(main())
