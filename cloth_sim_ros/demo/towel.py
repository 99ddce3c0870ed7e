# SPDX-License-Identifier: Apache-2.0
"""Folds the towel of config/towel.yaml in half, as a robot's driver would: poses and services of two hands."""

from __future__ import annotations

import math
import time

from geometry_msgs.msg import PoseStamped
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from std_srvs.srv import SetBool, Trigger

RATE = 60.0  # [Hz] of the hands' poses
HANDS = {"left": -0.25, "right": 0.25}  # name -> x [m]
HALF, TABLE = 0.25, 0.006  # [m] half of the towel's length, and where it lies
WAIT, FOLD, LIE, AGAIN = 1.0, 3.0, 1.0, 2.0  # [s] before, for and after the fold, and then until the next one


def hand(t: float) -> tuple[float, float]:
    """y and z [m] of both hands at time t [s]: half a circle over the towel."""
    share = min(max((t - WAIT) / FOLD, 0.0), 1.0)
    angle = math.pi * 0.5 * (1.0 - math.cos(math.pi * share))
    return -HALF * math.cos(angle), TABLE + HALF * math.sin(angle) + 0.012 * share


class Driver(Node):
    """Moves the hands, has them let go when the towel is folded, and begins again."""

    def __init__(self):
        super().__init__("towel_driver")
        newest = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
        self._poses = {
            name: self.create_publisher(PoseStamped, f"/cloth_sim/handles/{name}/pose", newest) for name in HANDS
        }
        self._attach = {name: self.create_client(SetBool, f"/cloth_sim/handles/{name}/attach") for name in HANDS}
        self._reset = self.create_client(Trigger, "/cloth_sim/reset")
        self._begin: float | None = None  # when the node was there
        self._holds = True
        self.create_timer(1.0 / RATE, self._step)

    def _step(self) -> None:
        ready = all(publisher.get_subscription_count() for publisher in self._poses.values())
        if not ready or not self._reset.service_is_ready():
            return
        if self._begin is None:
            self._begin = time.monotonic()
        t = time.monotonic() - self._begin
        folded = t - (WAIT + FOLD + LIE)
        if self._holds and folded > 0.0:
            self._hold(False)
        for name, x in HANDS.items():
            self._move(name, x, *hand(t if folded < 0.5 * AGAIN else 0.0))  # back, with empty hands
        if folded > AGAIN:
            self._reset.call_async(Trigger.Request())
            self._hold(True)
            self._begin = None

    def _hold(self, on: bool) -> None:
        self._holds = on
        for client in self._attach.values():
            client.call_async(SetBool.Request(data=on))

    def _move(self, name: str, x: float, y: float, z: float) -> None:
        message = PoseStamped()
        message.header.frame_id = "world"
        message.header.stamp = self.get_clock().now().to_msg()
        message.pose.position.x, message.pose.position.y, message.pose.position.z = x, y, z
        self._poses[name].publish(message)
