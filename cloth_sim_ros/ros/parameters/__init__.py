# SPDX-License-Identifier: Apache-2.0
"""ROS parameters, and the scene that they describe."""
