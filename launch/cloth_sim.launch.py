# SPDX-License-Identifier: Apache-2.0
"""ros2 launch cloth_sim_ros cloth_sim.launch.py [scene:=towel] [params_file:=FILE] [viewer:=true] ..."""

import re
from pathlib import Path

from ament_index_python.packages import PackageNotFoundError, get_package_share_directory
from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, LogInfo, OpaqueFunction
from launch.conditions import evaluate_condition_expression
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from cloth_sim_ros.demo.driver import has_driver

ARGUMENTS = {
    "scene": ("curtain", "a scene of config/, such as curtain, towel, flag or hose"),
    "params_file": ("", "parameter file of the node, in place of a scene's"),
    "namespace": ("", "namespace of the node"),
    "name": ("cloth_sim", "name of the node"),
    "device": ("", "where to compute: auto, cpu, cuda:0, ...; empty is what the file says"),
    "use_sim_time": ("false", "whether to follow /clock"),
    "viewer": ("false", "whether to show it on a page in the browser, whose address is printed"),
    "driver": ("true", "whether to run the scene's driver, if it has one, which moves hands, colliders and wind"),
    "rviz": ("false", "whether to show the scene in RViz"),
}
TRUTHS = ["true", "false", "True", "False", "1", "0"]


def generate_launch_description() -> LaunchDescription:
    """The node on a scene, and on request a view of it."""
    declared = [
        DeclareLaunchArgument(
            name, default_value=default, description=text, choices=TRUTHS if default in TRUTHS else None
        )
        for name, (default, text) in ARGUMENTS.items()
    ]
    return LaunchDescription([*declared, OpaqueFunction(function=start)])


def start(context: LaunchContext) -> list:
    """The actions for the arguments in `context`. Raises FileNotFoundError where a file is missing."""
    given = {name: LaunchConfiguration(name).perform(context) for name in ARGUMENTS}
    config = Path(get_package_share_directory("cloth_sim_ros")) / "config"
    file = Path(given["params_file"]) if given["params_file"] else config / f"{given['scene']}.yaml"
    if not file.is_file():
        there = ", ".join(sorted(each.stem for each in config.glob("*.yaml")))
        raise FileNotFoundError(f"there is no {file}; the scenes are {there}")
    use_sim_time, viewer, driver, rviz = (
        evaluate_condition_expression(context, [LaunchConfiguration(name)])
        for name in ("use_sim_time", "viewer", "driver", "rviz")
    )
    driven = driver and not given["params_file"] and has_driver(given["scene"])
    # Drivers go by the simulation's time, which the node sends where nobody else sends one.
    set_here = {"use_sim_time": use_sim_time, **({"publish_clock": True} if driven and not use_sim_time else {})}
    if given["device"]:
        set_here["device"] = given["device"]
    node = Node(
        package="cloth_sim_ros",
        executable="cloth_sim_node",
        namespace=given["namespace"],
        name=given["name"],
        parameters=[str(file), set_here],
        output="screen",
    )
    actions = [node]
    if driven:
        actions.append(_beside("cloth_sim_driver", given, True, given["scene"]))
    if viewer:
        actions.append(_beside("cloth_sim_viewer", given, use_sim_time))
    if rviz:
        actions += _rviz(config / f"{file.stem}.rviz", given, use_sim_time)
    return actions


def _beside(executable: str, given: dict[str, str], use_sim_time: bool, *words: str) -> Node:
    """A program of this package that speaks with the node."""
    return Node(
        package="cloth_sim_ros",
        executable=executable,
        namespace=given["namespace"],
        arguments=list(words),
        parameters=[{"node": given["name"], "use_sim_time": use_sim_time}],
        output="screen",
    )


def _rviz(file: Path, given: dict[str, str], use_sim_time: bool) -> list:
    """RViz with a configuration, whose topics of /cloth_sim are those of the node as it is named here."""
    try:
        get_package_share_directory("rviz2")
    except PackageNotFoundError:
        return [LogInfo(msg="rviz2 is not installed, so nothing is shown: sudo apt install ros-jazzy-rviz2")]
    node = "/".join(["", *given["namespace"].split("/"), given["name"]]).replace("//", "/")
    topics = re.findall(r"Value: /cloth_sim/(\S+)", file.read_text()) if file.is_file() else []
    return [
        Node(
            package="rviz2",
            executable="rviz2",
            arguments=["-d", str(file)] if file.is_file() else [],
            parameters=[{"use_sim_time": use_sim_time}],
            remappings=[(f"/cloth_sim/{topic}", f"{node}/{topic}") for topic in topics],
        )
    ]
