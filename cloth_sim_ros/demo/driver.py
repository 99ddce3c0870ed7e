# SPDX-License-Identifier: Apache-2.0
"""Base of the drivers of scenes: an ordinary ROS node that sends poses and wind and calls services of cloth_sim.

`cloth_sim_driver SCENE` runs the driver of a scene beside a running node; `--ros-args -p node:=NAME` names the node.
`--rate HZ` sets its rate of messages.
"""

from __future__ import annotations

import argparse
import importlib
import importlib.util
import math
import sys
import time
from collections.abc import Sequence
from typing import Any, ClassVar

import rclpy
from geometry_msgs.msg import PoseStamped, Vector3Stamped
from rcl_interfaces.msg import ParameterEvent
from rcl_interfaces.srv import SetParameters
from rclpy.client import Client
from rclpy.clock import Clock, ClockType
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.utilities import remove_ros_args
from std_msgs.msg import Float64
from std_srvs.srv import SetBool, Trigger

from cloth_sim_ros.shared_files import shared

RATE = 60.0  # [Hz] of poses and wind, unless told otherwise
FASTEST = 1000.0  # [Hz]
LONGEST = 0.1  # [s] largest step of a motion: a driver that was held up goes on from its last pose
PATIENCE = 5.0  # [s] to wait for answers before calling again
NEWEST_ONLY = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]


class SceneDriver(Node):
    """Drives the node that the parameter `node` names, as soon as it is there.

    With `use_sim_time` it follows /clock: if the node sends that, motions are the same on a slow machine. named: the
    node. A driver lies in a module of its scene's name, and implements `drive`. It lists the receivers of poses in
    `moves`, such as "colliders/ball" or "handles/left". It lists those of numbers in `numbers`, such as
    "grippers/hand/force" or "cable/winch". After `end` [s] the motion restarts.
    """

    moves: ClassVar[Sequence[str]] = ()
    numbers: ClassVar[Sequence[str]] = ()
    end: ClassVar[float] = math.inf

    def __init__(self):
        super().__init__(f"{type(self).__module__.rpartition('.')[2]}_driver")
        self.named = self.resolve_service_name(self.declare_parameter("node", "cloth_sim").value)
        self._poses = {
            thing: self.create_publisher(PoseStamped, f"{self.named}/{thing}/pose", NEWEST_ONLY) for thing in self.moves
        }
        self._numbers = {
            what: self.create_publisher(Float64, f"{self.named}/{what}", NEWEST_ONLY) for what in self.numbers
        }
        self._wind = self.create_publisher(Vector3Stamped, f"{self.named}/wind", NEWEST_ONLY)
        self._attach = {
            hand: self.create_client(SetBool, f"{self.named}/{hand}/attach")
            for hand in self.moves
            if hand.startswith("handles/")
        }
        self._holds: dict[str, bool] = {}  # last command to each hand
        self._reset = self.create_client(Trigger, f"{self.named}/reset")
        self._pause = self.create_client(SetBool, f"{self.named}/pause")
        self._asked: float | None = None  # start of a reset, until it is done
        self._set = self.create_client(SetParameters, f"{self.named}/set_parameters")
        self.create_subscription(ParameterEvent, "/parameter_events", self._on_parameters, 100)
        self._set_by_others: set[str] = set()
        self._moved: float | None = None  # time of the last move; None at the start
        self._t = 0.0  # [s] of the motion
        self._timer = self.create_timer(1.0 / RATE, self._step)
        # By the wall, as /clock stands while the node is paused.
        self.create_timer(1.0, self._ask_again, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def go_at(self, rate: float) -> None:
        """Send poses and wind `rate` times a second."""
        self._timer.timer_period_ns = round(1e9 / rate)

    def drive(self, t: float) -> None:
        """Send the commands for `t` [s] since the start; called at the rate of `go_at`.

        `t` grows by at most LONGEST at once, so that no pose jumps on a machine that is busy with other things.
        """
        raise NotImplementedError

    def move(self, thing: str, position: Vector, orientation: Quaternion = (0.0, 0.0, 0.0, 1.0)) -> None:
        """Send a pose [m]."""
        message = PoseStamped()
        self._stamp(message)
        p, q = message.pose.position, message.pose.orientation
        p.x, p.y, p.z = position
        q.x, q.y, q.z, q.w = orientation
        self._poses[thing].publish(message)

    def tell(self, what: str, number: float) -> None:
        """Send a gripper an opening [m] or a force [N], or a winch its rate [m/s]."""
        self._numbers[what].publish(Float64(data=number))

    def hold(self, hand: str, on: bool) -> None:
        """Let a hand grasp or let go, if that is a change; at first it holds."""
        if self._holds.get(hand, True) != on:
            self._holds[hand] = on
            self._attach[hand].call_async(SetBool.Request(data=on))

    def blow(self, velocity: Vector) -> None:
        """Send a wind [m/s], unless a user has set the parameter wind.velocity, as by a slider of the viewer."""
        if "wind.velocity" not in self._set_by_others:
            message = Vector3Stamped()
            self._stamp(message)
            message.vector.x, message.vector.y, message.vector.z = velocity
            self._wind.publish(message)

    def set(self, name: str, value: float) -> None:
        """Set a parameter."""
        self._set.call_async(SetParameters.Request(parameters=[Parameter(name, value=value).to_parameter_msg()]))

    def begin_again(self) -> None:
        """Reset all objects to their start; `drive` begins at 0 again.

        Hands grasp anew. They must be empty and at their start. The node is paused meanwhile, so that nothing falls
        from them.
        """
        self._moved, self._asked = None, time.monotonic()
        self._holds = dict.fromkeys(self._holds, True)
        grasps = [(self._attach[hand], SetBool.Request(data=True)) for hand in self._holds]
        stop, go_on = ((self._pause, SetBool.Request(data=on)) for on in (True, False))
        self._call_in_turn([stop, (self._reset, Trigger.Request()), *grasps, go_on])

    def _call_in_turn(self, calls: Sequence[tuple[Client, Any]]) -> None:
        """Call services, each when the one before has answered."""
        if not calls:
            self._asked = None
            return
        (service, request), *others = calls
        service.call_async(request).add_done_callback(lambda _: self._call_in_turn(others))

    def _ask_again(self) -> None:
        if self._asked is not None and time.monotonic() - self._asked > PATIENCE:
            self.begin_again()

    def _step(self) -> None:
        listened = all(each.get_subscription_count() for each in (self._wind, *self._poses.values()))
        if not listened or not self._reset.service_is_ready():
            return
        if self._asked is not None:
            return
        now = 1e-9 * self.get_clock().now().nanoseconds  # of /clock, with use_sim_time
        if self._moved is None or now < self._moved:
            self._t, self._moved = 0.0, now
        self._t += min(now - self._moved, max(LONGEST, 1e-9 * self._timer.timer_period_ns))
        self._moved = now
        self.drive(self._t)
        if self._t > self.end:
            self.begin_again()

    def _stamp(self, message: PoseStamped | Vector3Stamped) -> None:
        message.header.frame_id = "world"
        message.header.stamp = self.get_clock().now().to_msg()

    def _on_parameters(self, event: ParameterEvent) -> None:
        if event.node == self.named:
            self._set_by_others |= {parameter.name for parameter in event.changed_parameters}


def has_driver(scene: str) -> bool:
    """Return True if a scene of config/ has a driver: a module of its name beside this one."""
    known = scene.isidentifier() and shared(f"config/{scene}.yaml").is_file()
    return known and importlib.util.find_spec(f"cloth_sim_ros.demo.{scene}") is not None


def driver_of(scene: str) -> SceneDriver:
    """Return the driver of a scene that has one. Raises ImportError, with what to install, if a package is missing."""
    return importlib.import_module(f"cloth_sim_ros.demo.{scene}").Driver()


def main(arguments: list[str] | None = None) -> int:
    """Drive a scene until a signal comes; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scene", help="a scene of config/")
    parser.add_argument("--rate", type=_rate, default=RATE, help="[Hz] of what it sends")
    given = sys.argv if arguments is None else [sys.argv[0], *arguments]
    options = parser.parse_args(remove_ros_args(given)[1:])
    if not has_driver(options.scene):
        scenes = sorted(file.stem for file in shared("config/curtain.yaml").parent.glob("*.yaml"))
        allowed = ", ".join(filter(has_driver, scenes))
        print(f"cloth_sim_driver: {options.scene} has no driver; allowed is one of {allowed}", file=sys.stderr)
        return 1
    rclpy.init(args=given)
    try:
        driver = driver_of(options.scene)
    except ImportError as error:
        print(f"cloth_sim_driver: {error}", file=sys.stderr)
        return 1
    driver.go_at(options.rate)
    print(f"driving {options.scene} at {driver.named}, until Ctrl-C", flush=True)
    try:
        rclpy.spin(driver)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    driver.destroy_node()
    rclpy.try_shutdown()
    return 0


def _rate(text: str) -> float:
    """Return a rate [Hz]. Raises ArgumentTypeError if `text` is none."""
    try:
        rate = float(text)
    except ValueError:
        rate = math.nan
    if not 1.0 <= rate <= FASTEST:
        raise argparse.ArgumentTypeError(f"{text!r} is no rate; allowed is a number from 1 to {FASTEST:g} Hz")
    return rate


if __name__ == "__main__":
    sys.exit(main())
