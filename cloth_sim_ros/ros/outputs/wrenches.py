# SPDX-License-Identifier: Apache-2.0
"""Wrenches on colliders, handles and the ends of ropes, in world axes, computed and sent if there is a subscriber."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from geometry_msgs.msg import WrenchStamped
from rclpy.node import Node
from std_msgs.msg import Header

from cloth_sim_ros.ros.outputs.output import LATEST, Output, Stamp
from cloth_sim_ros.ros.world import World
from cloth_sim_ros.sim import EndReadback, Simulation

ENDS = ("start", "end")  # of a rope


class _Wrenches(Output):
    """A topic for each of `names`: `topic` with the name in place of {}."""

    def __init__(self, node: Node, values: Mapping[str, Any], topic: str, names: Sequence[str]):
        self._by_name = {name: node.create_publisher(WrenchStamped, topic.format(name), LATEST) for name in names}
        self.publishers = list(self._by_name.values())
        self._message = WrenchStamped(header=Header(frame_id=values["frame_id"]))

    def _send(self, wrenches: Mapping[str, Sequence[float]], stamp: Stamp) -> None:
        """Send force [N] and torque [N m] of each name that has a subscriber."""
        self._message.header.stamp.sec, self._message.header.stamp.nanosec = stamp
        force, torque = self._message.wrench.force, self._message.wrench.torque
        for name, publisher in self._by_name.items():
            if name in wrenches and publisher.get_subscription_count() > 0:  # else it is left out of the simulation
                force.x, force.y, force.z, torque.x, torque.y, torque.z = wrenches[name]
                publisher.publish(self._message)


class Wrenches(_Wrenches):
    """Wrenches on colliders or handles (`kind`), about their origins."""

    def __init__(self, node: Node, values: Mapping[str, Any], kind: str):
        super().__init__(node, values, f"~/{kind}/{{}}/wrench", values[kind])
        self._kind = kind

    @classmethod
    def each(cls, node: Node, values: Mapping[str, Any]) -> Iterable[Output]:
        """Return one output for colliders and one for handles."""
        return [cls(node, values, kind) for kind in ("colliders", "handles")]

    def read(self, world: World, stamp: Stamp) -> None:
        """Send the last frame's wrenches."""
        if world.sim is None or not self.is_heard:
            return
        if self._kind == "handles":
            rows, names = world.sim.handle_wrenches(), world.sim.scene.handles
        else:
            rows, names = world.sim.wrenches(), world.sim.scene.colliders
        self._send(dict(zip(names, rows.tolist(), strict=False)), stamp)  # spare rows lie behind


class RopeEnds(_Wrenches):
    """Wrenches of a rope on the supports of its ends, about each end."""

    def __init__(self, node: Node, values: Mapping[str, Any], name: str):
        super().__init__(node, values, f"~/{name}/{{}}/wrench", ENDS)
        self._name, self._wanted = name, False
        self._readback: EndReadback | None = None

    @classmethod
    def each(cls, node: Node, values: Mapping[str, Any]) -> Iterable[Output]:
        """Return one output for each rope."""
        return [cls(node, values, name) for name in values["objects"] if values[f"{name}.type"] == "rope"]

    def attach(self, sim: Simulation | None, values: Mapping[str, Any]) -> None:
        """Prepare the readback; nothing is sent for a rope that does not exist."""
        there = sim is not None and self._name in sim.scene.objects
        self._readback = EndReadback(sim, self._name) if there else None

    def request(self, world: World, stamp: Stamp) -> None:
        """Start computing and copying if there is a subscriber."""
        self._wanted = self._readback is not None and self.is_heard
        if self._wanted:
            self._readback.request()

    def read(self, world: World, stamp: Stamp) -> None:
        """Wait for the wrenches and send them."""
        if self._wanted:
            self._send(dict(zip(ENDS, self._readback.wrenches().tolist(), strict=True)), stamp)
