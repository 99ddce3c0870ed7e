# SPDX-License-Identifier: Apache-2.0
"""The topics ~/journal and ~/journal/acts: the input of each frame, so that a replay gives the same bits.

A message is a JSON object with `sequence`, counted from 0 through both topics, `stamp`, that of the clouds sent with
it, and one of
- `start`: the parameters in effect, the poses of colliders and handles, and the whole state as ~/save writes it;
- `acts`: the acts since the message before, in order, each a list of a name of ACTS and its arguments;
- `end`: nothing is written until the next start, as nobody listened.
Starts are on ~/journal, all else on ~/journal/acts. Each new listener has a start sent, which is large. The middleware
keeps buffers for all messages of a topic, and each grows to the largest that it once held.
"""

from __future__ import annotations

import base64
import dataclasses
import json
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import String

from cloth_sim_ros.ros.journal import VERSION
from cloth_sim_ros.ros.outputs.output import Output, Stamp
from cloth_sim_ros.ros.world import World
from cloth_sim_ros.sim.colliders.collider import Collider

# Late listeners get what was sent before they came, as far as it goes back: discovery takes longer than a frame.
ACTS = QoSProfile(depth=1000, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL)
STARTS = QoSProfile(depth=4, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class JournalOutput(Output):
    """Sends the journal of a world; while nobody listens, none is written."""

    def __init__(self, node: Node, values: Mapping[str, Any]):
        self._publisher = node.create_publisher(String, "~/journal/acts", ACTS)
        self._starts = node.create_publisher(String, "~/journal", STARTS)
        self.publishers = [self._publisher, self._starts]
        self._sequence = self._listeners = 0

    @property
    def is_heard(self) -> bool:
        """True if there is a subscriber, or was one at the last frame."""
        return self._listeners > 0 or super().is_heard

    def read(self, world: World, stamp: Stamp) -> None:
        """Send the acts before the frame that is sent with `stamp`."""
        journal, before = world.journal, self._listeners
        self._listeners = self._starts.get_subscription_count() if world.sim is not None else 0
        acts = journal.take()
        if not self._listeners:
            if journal.runs:
                self._send(self._publisher, stamp, end=True)
            journal.runs = False
        elif self._listeners > before or journal.is_cut:
            journal.runs, journal.is_cut = True, False
            self._send(self._starts, stamp, start=start_of(world))
        elif acts:
            self._send(self._publisher, stamp, acts=acts)

    def _send(self, publisher: Publisher, stamp: Stamp, **content: Any) -> None:
        message = {"version": VERSION, "sequence": self._sequence, "stamp": stamp, **content}
        self._sequence += 1
        publisher.publish(String(data=json.dumps(message, default=_plain)))


def start_of(world: World) -> dict[str, Any]:
    """Return the start of a recording of `world`, from which another world goes on to the same bits."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "state.npz"
        world.sim.save(file, world.notes())
        state = base64.b64encode(file.read_bytes()).decode()
    poses = {name: [track.pose.position, track.pose.orientation] for name, track in world.tracks.items()}
    return {"parameters": dict(world.in_effect), "poses": poses, "state": state}


def _plain(thing: Any) -> Any:
    """Convert a type that JSON lacks: a collider, which came on ~/scene, or numbers of NumPy."""
    if isinstance(thing, Collider):
        return {"shape": type(thing).__name__, **dataclasses.asdict(thing)}
    return thing.tolist()
