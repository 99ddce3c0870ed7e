# SPDX-License-Identifier: Apache-2.0
"""Protocol of all outputs of the node: `Output`. table.py lists them."""

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
    """Topics that are sent after every frame, if there is a subscriber.

    Made in the executor's thread, from the parameter `values`. The thread that simulates calls attach() for another
    simulation, and after each frame request() and read(). publish() may run in another thread; it ends before the next
    request().
    """

    publishers: Sequence[Publisher] = ()

    @classmethod
    def each(cls, node: Node, values: Mapping[str, Any]) -> Iterable[Output]:
        """Return the outputs of this class that a node has: one, unless a class says otherwise."""
        return [cls(node, values)]

    @property
    def is_heard(self) -> bool:
        """True if there is a subscriber."""
        return any(publisher.get_subscription_count() > 0 for publisher in self.publishers)

    @property
    def owned(self) -> Sequence[Publisher]:
        """All publishers, to be destroyed with the output."""
        return self.publishers

    @property
    def size(self) -> int:
        """Bytes that publish() sends."""
        return 0

    def attach(self, sim: Simulation | None, values: Mapping[str, Any]) -> None:
        """Prepare for another simulation, or none, and other parameters `values`."""

    def request(self, world: World, stamp: Stamp) -> None:
        """Start computing and copying on the device, which goes on while other outputs request theirs."""

    def read(self, world: World, stamp: Stamp) -> None:
        """Wait for the requested data, and read the state at the end of the frame; a small message is sent here."""

    def publish(self) -> None:
        """Send the data that was read."""


class Audience:
    """Tells if any of `outputs` has a subscriber.

    If none had, it looks again every HEARING, as the query of the middleware takes time.
    """

    HEARING = 0.1  # [s]

    def __init__(self, outputs: Sequence[Output]):
        self._outputs = outputs
        self._was_there, self._looked = False, -self.HEARING

    @property
    def is_there(self) -> bool:
        """True if any output has a subscriber; read it once a frame."""
        now = time.monotonic()
        if self._was_there or now >= self._looked + self.HEARING:
            self._looked = now
            self._was_there = any(output.is_heard for output in self._outputs)
        return self._was_there
