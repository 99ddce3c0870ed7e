# SPDX-License-Identifier: Apache-2.0
"""What tests of several folders share."""

import pytest


@pytest.fixture(scope="session")
def ros():
    """An initialised rclpy, once in a process: tests of the node and of the viewer may share one."""
    import rclpy
    from rclpy.signals import SignalHandlerOptions

    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    yield
    rclpy.shutdown()
