# SPDX-License-Identifier: Apache-2.0
"""Topics that command wind, winches, grippers and cuts. Callbacks only check messages and pass them on."""

from __future__ import annotations

import math
from functools import partial

from geometry_msgs.msg import PolygonStamped, Vector3Stamped
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from std_msgs.msg import Float64

from cloth_sim_ros.ros.inputs import messages as inputs
from cloth_sim_ros.ros.inputs.frames import Frames, Refused
from cloth_sim_ros.ros.inputs.grippers import ASKED, STRONGEST
from cloth_sim_ros.ros.parameters.bridge import ParameterBridge
from cloth_sim_ros.ros.time.loop import SimulationLoop

NEWEST_ONLY = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)


class Commands:
    """The subscriptions of `node`, whose callbacks run in the executor's thread."""

    def __init__(
        self, node: Node, loop: SimulationLoop, bridge: ParameterBridge, frames: Frames, complaints: inputs.Complaints
    ):
        self._loop, self._bridge, self._frames, self._complaints = loop, bridge, frames, complaints
        values = bridge.values
        for name in values["grippers"]:
            for what in ASKED:
                act = partial(self._on_gripper, name, what)
                node.create_subscription(Float64, f"~/grippers/{name}/{what}", act, NEWEST_ONLY)
        for name in values["objects"]:
            if values[f"{name}.type"] == "rope":
                node.create_subscription(Float64, f"~/{name}/winch", partial(self._on_winch, name), NEWEST_ONLY)
        node.create_subscription(Vector3Stamped, "~/wind", self._on_wind, NEWEST_ONLY)
        node.create_subscription(PolygonStamped, "~/cut", self._on_cut, 10)  # reliable: a cut must not get lost

    def _on_wind(self, message: Vector3Stamped) -> None:
        try:
            velocity = inputs.read_wind(message, self._frames)
            if not self._bridge.values["wind.enabled"]:
                raise Refused("disabled", "the scene has no wind; set the parameter wind.enabled to true")
            self._loop.submit(lambda: self._loop.world.set_wind(velocity))
        except Refused as reason:
            self._complaints.refuse("wind", reason)

    def _on_gripper(self, name: str, what: str, message: Float64) -> None:
        try:
            number = inputs.read_number(message, what)
            most = self._bridge.values[f"{name}.max_opening"] if what == "opening" else STRONGEST
            if not 0.0 <= number <= most:
                raise Refused("size", f"its {what} {number:g} is not from 0 to {most:g}")
            self._loop.submit(lambda: self._loop.world.set_gripper(name, what, number))
        except Refused as reason:
            self._complaints.refuse(f"grippers/{name}/{what}", reason)

    def _on_cut(self, message: PolygonStamped) -> None:
        try:
            values = self._bridge.values
            if not any(values.get(f"{name}.tear_strain") for name in values["objects"]):
                raise Refused("disabled", "no object tears; set the parameter tear_strain of a cloth to more than 0")
            polygon = inputs.read_polygon(message, self._frames)
            self._loop.submit(lambda: self._loop.world.cut(polygon))
        except Refused as reason:
            self._complaints.refuse("cut", reason)

    def _on_winch(self, rope: str, message: Float64) -> None:
        values, topic = self._bridge.values, f"{rope}/winch"
        try:
            rate = inputs.read_number(message, "rate")
            if not values[f"{rope}.winch.enabled"]:
                raise Refused("disabled", f"{rope} has no winch; set the parameter {rope}.winch.enabled to true")
            most = values[f"{rope}.winch.max_rate"]
            if abs(rate) > most:
                self._complaints.cut(topic, f"its rate {rate:g} m/s is beyond {rope}.winch.max_rate, {most:g} m/s")
                rate = math.copysign(most, rate)
            self._loop.submit(lambda: self._loop.world.set_pay_out(rope, rate))
        except Refused as reason:
            self._complaints.refuse(topic, reason)
