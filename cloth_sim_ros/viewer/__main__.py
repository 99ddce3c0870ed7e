# SPDX-License-Identifier: Apache-2.0
"""Show a running cloth_sim node in a browser: `cloth_sim_viewer`, or `python -m cloth_sim_ros.viewer`.

SIGINT and SIGTERM end it with status 0. Its own parameters: see PARAMETERS.
"""

from __future__ import annotations

import errno
import os
import socket
import sys

from cloth_sim_ros.options import missing
from cloth_sim_ros.ros.surroundings import set_up
from cloth_sim_ros.signals import Stop

SPIN_PERIOD = 0.1  # [s] at most between a signal and its effect
FRAME = 1.0 / 60.0  # [s]
YIELDS = 10  # niceness by which the page yields the processor to the simulation
PARAMETERS = {
    "node": ("cloth_sim", "Name of the node to show; without a slash at the beginning in the viewer's namespace."),
    "host": ("127.0.0.1", "Address at which the page is served; 0.0.0.0 is for other machines too."),
    "allowed_hosts": ([""], "Further names by which browsers reach the page, such as a proxy's."),
    "port": (8080, "Port of the page; where it is taken, the next free one."),
}


def main(arguments: list[str] | None = None) -> int:
    """Serve the page until a signal comes; return the exit status. Raises no exception."""
    stop = Stop()
    if lack := missing("viser"):
        print(f"cloth_sim_viewer: {lack}", file=sys.stderr)
        return 1
    os.nice(YIELDS)
    set_up()

    import rclpy
    from rclpy.signals import SignalHandlerOptions

    try:
        rclpy.init(args=arguments, signal_handler_options=SignalHandlerOptions.NO)
        return serve(stop)
    except Exception as error:
        print(f"cloth_sim_viewer: {error}", file=sys.stderr)
        return 1
    finally:
        rclpy.try_shutdown()


def serve(stop: Stop) -> int:
    """Run node and page until `stop` is set; return the exit status.

    Raises ValueError for parameters that are not allowed.
    """
    import warp
    from rclpy.executors import SingleThreadedExecutor
    from rclpy.node import Node

    from cloth_sim_ros.viewer.live.page import LivePage
    from cloth_sim_ros.viewer.live.remote import Remote
    from cloth_sim_ros.viewer.pages import PAGES
    from cloth_sim_ros.viewer.window import Window

    warp.config.log_level = warp.LOG_WARNING
    node = Node("cloth_sim_viewer")
    given = {name: node.declare_parameter(name, value).value for name, (value, _) in PARAMETERS.items()}
    check_address(given["host"], given["port"])
    remote = Remote(node, given["node"])
    pages = {LivePage.title: lambda server: LivePage(server, remote), **{page.title: page for page in PAGES}}
    window = Window(given["host"], given["port"], pages, given["allowed_hosts"])
    print(f"The page is at {window.address}", flush=True)
    node.create_timer(FRAME, window.advance)
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    while not stop.is_set():
        try:
            executor.spin_once(timeout_sec=SPIN_PERIOD)
        except Exception as error:  # the page outlives it
            node.get_logger().error(f"a callback failed: {type(error).__name__}: {error}")
    window.close()
    executor.shutdown()
    node.destroy_node()
    return 0


def check_address(host: str, port: int) -> None:
    """Raise ValueError in one sentence if no page can be served there. A port in use is allowed."""
    if not 0 < port < 65536:
        raise ValueError(f"port is {port}; allowed is a whole number from 1 to 65535")
    try:
        socket.create_server((host, port)).close()
    except OSError as error:
        if error.errno != errno.EADDRINUSE:
            why = error.strerror or str(error)
            raise ValueError(
                f"host is {host!r} and port {port}: {why}; allowed is an address of this machine"
            ) from None


if __name__ == "__main__":
    sys.exit(main())
