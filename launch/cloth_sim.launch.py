# SPDX-License-Identifier: Apache-2.0
"""ros2 launch cloth_sim_ros cloth_sim.launch.py [params:=FILE] [rviz:=true]."""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node


def generate_launch_description() -> LaunchDescription:
    """The node, and on request a view of it."""
    config = Path(get_package_share_directory("cloth_sim_ros")) / "config"
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "params", default_value=str(config / "curtain.yaml"), description="parameter file of the node"
            ),
            DeclareLaunchArgument("rviz", default_value="false", description="whether to show it"),
            Node(
                package="cloth_sim_ros",
                executable="cloth_sim_node",
                parameters=[LaunchConfiguration("params")],
                output="screen",
            ),
            ExecuteProcess(
                cmd=["rviz2", "-d", str(config / "cloth_sim.rviz")], condition=IfCondition(LaunchConfiguration("rviz"))
            ),
        ]
    )
