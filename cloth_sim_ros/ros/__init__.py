# SPDX-License-Identifier: Apache-2.0
"""The ROS 2 node around the solver core: the only place that imports rclpy and messages."""
