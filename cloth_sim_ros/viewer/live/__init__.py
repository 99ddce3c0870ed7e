# SPDX-License-Identifier: Apache-2.0
"""The page of a running node, over ROS: remote speaks with it, scene draws it, panel steers it, grasp drags it."""
