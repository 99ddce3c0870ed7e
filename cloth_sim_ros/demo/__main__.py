# SPDX-License-Identifier: Apache-2.0
"""A demonstration: start the node on a scene of config/, the scene's driver, if it has one, and the viewer.

Everything goes through the real topics; the status line shows the messages that arrive. Run it with `make demo
SCENE=towel`.
"""

from __future__ import annotations

import argparse
import importlib.util
import math
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import yaml

from cloth_sim_ros.options import duration
from cloth_sim_ros.shared_files import shared
from cloth_sim_ros.signals import Stop

RUNS = "\nCtrl-C ends it. Another scene: make demo SCENE={other}, or the list at the top of the page.\n"
WITH_ROS = """
The driver speaks by topic and service, particles and meshes come back as standard messages. To look closer:
  rviz2 -d {view}
  ros2 topic hz /cloth_sim/{object}/particles
  ros2 param set /cloth_sim solver.error 0.001        (finer, at once)
  ros2 service call /cloth_sim/reset std_srvs/srv/Trigger
"""


def main(arguments: list[str] | None = None) -> int:
    """Run the demonstration until Ctrl-C, SIGTERM or --seconds; return the exit status."""
    parser = argparse.ArgumentParser(prog="cloth_sim_demo", description=__doc__.splitlines()[0])
    parser.add_argument("scene", nargs="?", default="curtain", choices=scenes(), help="a scene of config/")
    parser.add_argument("--headless", action="store_true", help="without the viewer")
    parser.add_argument("--seconds", type=duration, default=math.inf, help="how long to run once messages arrive")
    options = parser.parse_args(arguments)
    stop = Stop()
    viewer = None if options.headless else start_viewer()
    scene, status = options.scene, 0
    try:
        while scene:
            config = shared(f"config/{scene}.yaml")
            print(f"Starting the node on {config} ...", flush=True)
            node = start_node(config, "-p", "publish_clock:=true")  # by which the driver goes
            try:
                scene = watch(stop, node, scene, options.seconds)
            except ImportError as error:  # of a driver
                print(f"cloth_sim_demo: {error}", file=sys.stderr)
                return 1
            finally:
                status = end(node)
    finally:
        if viewer is not None:
            end(viewer)
    return status


def start_node(config: Path, *arguments: str) -> subprocess.Popen:
    """Start the node with the parameters of `config` and further ROS arguments, in a process of its own."""
    return start("cloth_sim_ros.ros", "--ros-args", "--params-file", str(config), *arguments)


def start_viewer() -> subprocess.Popen | None:
    """Start the viewer, which prints its address, in a process of its own.

    Returns None, and prints a sentence, if viser is not installed.
    """
    if importlib.util.find_spec("viser") is None:
        print("Nothing is shown in a browser, as viser is not installed: make extras", flush=True)
        return None
    return start("cloth_sim_ros.viewer")


def start(module: str, *arguments: str) -> subprocess.Popen:
    """Start a Python module as a process, with a process group of its own.

    Ctrl-C therefore reaches only the calling process, which then ends the other.
    """
    environment = {**os.environ, "PYTHONUNBUFFERED": "1"}
    return subprocess.Popen([sys.executable, "-m", module, *arguments], start_new_session=True, env=environment)


def end(process: subprocess.Popen) -> int:
    """Ask a process to end and return its status; kill one that compiles for long."""
    process.terminate()
    try:
        return process.wait(timeout=10.0)
    except subprocess.TimeoutExpired:
        process.kill()
        return process.wait()


def scenes() -> list[str]:
    """Return the names of the scenes in config/."""
    return sorted(file.stem for file in shared("config/curtain.yaml").parent.glob("*.yaml"))


def objects_of(config: Path) -> list[str]:
    """Return the names of the objects in a parameter file."""
    (parameters,) = yaml.safe_load(config.read_text()).values()
    return parameters["ros__parameters"]["objects"]


def watch(stop: Stop, node: subprocess.Popen, scene: str, seconds: float) -> str:
    """Drive and watch the node until `stop`, the node's own end, or `seconds` after the first message.

    Returns the scene that a user has chosen meanwhile, or "".
    """
    import rclpy
    from rclpy.executors import SingleThreadedExecutor
    from rclpy.parameter import Parameter
    from rclpy.signals import SignalHandlerOptions

    from cloth_sim_ros.demo.audience import Audience
    from cloth_sim_ros.demo.driver import driver_of, has_driver

    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    objects = objects_of(shared(f"config/{scene}.yaml"))
    audience = Audience(objects, scene, scenes())
    ours = [audience]
    if has_driver(scene):
        ours.append(driver_of(scene))
        ours[1].set_parameters([Parameter("use_sim_time", value=True)])
    executor = SingleThreadedExecutor()
    for each in ours:
        executor.add_node(each)
    end, greeted = math.inf, False
    while not stop.is_set() and node.poll() is None and time.monotonic() < end and audience.scene == scene:
        executor.spin_once(timeout_sec=0.1)
        if audience.seen and not greeted:
            tell_more(scene, objects[0])
            end, greeted = time.monotonic() + seconds, True
    executor.shutdown()
    for each in ours:
        each.destroy_node()
    rclpy.try_shutdown()
    return audience.scene if audience.scene != scene else ""


def tell_more(scene: str, thing: str) -> None:
    """Print what can be done next, with commands of ROS if it is installed."""
    if shutil.which("ros2"):
        print(WITH_ROS.format(view=shared(f"config/{scene}.rviz"), object=thing), end="")
    print(RUNS.format(other="towel" if scene != "towel" else "flag"), flush=True)


if __name__ == "__main__":
    sys.exit(main())
