# SPDX-License-Identifier: Apache-2.0
"""The page of a running node, over ROS: remote connects, scene draws, panel sets parameters, grasp drags."""
