# SPDX-License-Identifier: Apache-2.0
"""What the node sends has one protocol: `Output`. table.py lists all of them."""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from cloth_sim_ros.ros.world import World
from cloth_sim_ros.sim import Simulation

LATEST = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE)
LATCHED = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL)

Stamp = tuple[int, int]  # seconds, nanoseconds


class Output:
    """Topics that are sent after every frame, where somebody subscribes.

    Made in the executor's thread, from the parameter `values`. The thread that simulates calls attach() for another
    simulation, and after each frame request() and read(). publish() may run in another thread; it ends before the next
    request().
    """

    publishers: Sequence[Publisher] = ()

    @classmethod
    def each(cls, node: Node, values: Mapping[str, Any]) -> Iterable[Output]:
        """The outputs of this class that a node has: one, unless a class says otherwise."""
        return [cls(node, values)]

    @property
    def is_heard(self) -> bool:
        """Whether somebody subscribes."""
        return any(publisher.get_subscription_count() > 0 for publisher in self.publishers)

    @property
    def owned(self) -> Sequence[Publisher]:
        """All publishers, to be destroyed with it."""
        return self.publishers

    @property
    def size(self) -> int:
        """Bytes that publish() sends."""
        return 0

    def attach(self, sim: Simulation | None, values: Mapping[str, Any]) -> None:
        """Prepares for another simulation, or none, and other parameters `values`."""

    def request(self, world: World, stamp: Stamp) -> None:
        """Starts what the device has to compute and to copy, so that it does so while other outputs ask."""

    def read(self, world: World, stamp: Stamp) -> None:
        """Waits for what was requested, and reads the state at the end of the frame; a small message is sent here."""

    def publish(self) -> None:
        """Sends what was read."""


class Audience:
    """Whether somebody listens to one of `outputs`. Where nobody did, it looks again every HEARING, as asking the
    middleware takes its time."""

    HEARING = 0.1  # [s]

    def __init__(self, outputs: Sequence[Output]):
        self._outputs = outputs
        self._was_there, self._looked = False, -self.HEARING

    @property
    def is_there(self) -> bool:
        """To be asked once a frame."""
        now = time.monotonic()
        if self._was_there or now >= self._looked + self.HEARING:
            self._looked = now
            self._was_there = any(output.is_heard for output in self._outputs)
        return self._was_there
