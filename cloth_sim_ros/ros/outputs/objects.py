# SPDX-License-Identifier: Apache-2.0
"""Device arrays -> messages: per object a particle cloud, a mesh to draw and, once, its topology."""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from geometry_msgs.msg import WrenchStamped
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import PointCloud2
from shape_msgs.msg import Mesh
from std_msgs.msg import Header
from visualization_msgs.msg import Marker

from cloth_sim_ros.ros.outputs import cdr
from cloth_sim_ros.sim import EndReadback, Readback, Rope, Simulation, Surface

ENDS = ("start", "end")  # of a rope
LATEST = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE)
LATCHED = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def is_any_heard(publishers: Iterable[Publisher]) -> bool:
    """Whether one of them has a subscriber."""
    return any(publisher.get_subscription_count() > 0 for publisher in publishers)


class Audience:
    """Whether somebody listens to one of `outputs`, or `always`. Where nobody did, it looks again every HEARING, as
    asking the middleware takes its time."""

    HEARING = 0.1  # [s]

    def __init__(self, outputs: Sequence[Any], always: bool):
        self._outputs, self._always = outputs, always
        self._was_there, self._looked = False, -self.HEARING

    @property
    def is_there(self) -> bool:
        """To be asked once a frame."""
        now = time.monotonic()
        if self._was_there or now >= self._looked + self.HEARING:
            self._looked = now
            self._was_there = self._always or any(output.is_heard for output in self._outputs)
        return self._was_there


class RopeEnds:
    """The wrenches of a rope on what holds its ends, in world axes, about the end; sent where somebody subscribes."""

    def __init__(self, node: Node, name: str, frame_id: str):
        self._name = name
        self._publishers = [node.create_publisher(WrenchStamped, f"~/{name}/{end}/wrench", LATEST) for end in ENDS]
        self._message = WrenchStamped(header=Header(frame_id=frame_id))
        self._readback: EndReadback | None = None
        self._wanted = False
        self._wrenches: list[list[float]] = []

    @property
    def is_heard(self) -> bool:
        """Whether somebody subscribes."""
        return is_any_heard(self._publishers)

    def detach(self) -> None:
        """Sends nothing until the next attach()."""
        self._readback = None

    def attach(self, sim: Simulation) -> None:
        """Prepares the readback for a new simulation."""
        self._readback = EndReadback(sim, self._name)

    def request(self) -> None:
        """Starts the computing and copying if it is wanted."""
        self._wanted = self._readback is not None and self.is_heard
        if self._wanted:
            self._readback.request()

    def wait(self, stamp: tuple[int, int]) -> None:
        """Waits for what was requested; it will be sent stamped (seconds, nanoseconds)."""
        if self._wanted:
            self._message.header.stamp.sec, self._message.header.stamp.nanosec = stamp
            self._wrenches = self._readback.wrenches().tolist()

    def publish(self) -> None:
        """Sends it."""
        if not self._wanted:
            return
        force, torque = self._message.wrench.force, self._message.wrench.torque
        for publisher, wrench in zip(self._publishers, self._wrenches, strict=True):
            force.x, force.y, force.z, torque.x, torque.y, torque.z = wrench
            publisher.publish(self._message)


class Wrenches:
    """What colliders or handles (`kind`) feel, in world axes, about their origins; computed and sent where somebody
    subscribes."""

    def __init__(self, node: Node, kind: str, names: Sequence[str], frame_id: str):
        self._kind = kind
        self._publishers = {
            name: node.create_publisher(WrenchStamped, f"~/{kind}/{name}/wrench", LATEST) for name in names
        }
        self._message = WrenchStamped(header=Header(frame_id=frame_id))
        self._sim: Simulation | None = None

    @property
    def is_heard(self) -> bool:
        """Whether somebody subscribes."""
        return is_any_heard(self._publishers.values())

    def attach(self, sim: Simulation | None) -> None:
        """Reads from this simulation from now on."""
        self._sim = sim

    def publish(self, stamp: tuple[int, int]) -> None:
        """Sends the last frame's wrenches, stamped (seconds, nanoseconds)."""
        wanted = [name for name, publisher in self._publishers.items() if publisher.get_subscription_count() > 0]
        if self._sim is None or not wanted:
            return
        self._message.header.stamp.sec, self._message.header.stamp.nanosec = stamp
        force, torque = self._message.wrench.force, self._message.wrench.torque
        if self._kind == "handles":
            rows, names = self._sim.handle_wrenches(), self._sim.scene.handles
        else:
            rows, names = self._sim.wrenches(), self._sim.scene.colliders
        wrenches = dict(zip(names, rows.tolist(), strict=False))  # spare rows lie behind
        for name in wanted:
            if name in wrenches:  # else it is left out of the simulation
                force.x, force.y, force.z, torque.x, torque.y, torque.z = wrenches[name]
                self._publishers[name].publish(self._message)


class ObjectOutput:
    """The topics of one object. Nothing is computed, copied or sent that nobody subscribes to. Particles and mesh share
    one copy; for a mesh alone it has positions and no more.

    Made in the executor's thread; attach(), request() and wait() belong to the thread that simulates. publish() may
    run in another one, if it ends before the next request().
    """

    def __init__(self, node: Node, name: str, kind: str, frame_id: str):
        self._name, self._frame_id = name, frame_id
        self._ends = [RopeEnds(node, name, frame_id)] if kind == "rope" else []
        self._particles = node.create_publisher(PointCloud2, f"~/{name}/particles", LATEST)
        self._mesh = node.create_publisher(Marker, f"~/{name}/mesh", LATEST)
        self._topology = node.create_publisher(Mesh, f"~/{name}/topology", LATCHED)
        self._cloud_wanted = self._mesh_wanted = False
        self._stamp = (0, 0)
        self.detach()

    @property
    def is_heard(self) -> bool:
        """Whether somebody subscribes to what may change in every frame; of what tears that is the topology, too."""
        changes = [self._particles, self._mesh]
        if self._surface is not None and self._surface.tears:
            changes.append(self._topology)
        return is_any_heard(changes) or any(ends.is_heard for ends in self._ends)

    def detach(self) -> None:
        """Sends nothing until the next attach(): the object does not exist."""
        self._cloud = self._marker = self._source = self._surface = None
        for ends in self._ends:
            ends.detach()

    def attach(self, sim: Simulation, normals: bool, velocities: bool, tensions: bool, mesh: bool) -> None:
        """Prepares messages and readbacks for a new simulation and sends the topology. A cloth has no tensions."""
        name, frame = self._name, self._frame_id
        thing, rest = sim.scene.objects[name], sim.rest_positions(name)
        tensions = tensions and isinstance(thing, Rope)
        columns = {"normals": normals, "velocities": velocities, "tensions": tensions}
        self._readback, self._positions = Readback(sim, name, mesh=mesh, **columns), Readback(sim, name, mesh=mesh)
        self._cloud = cdr.particle_cloud(frame, len(rest), cdr.cloud_fields(normals, velocities, tensions))
        width = 2 * thing.radius if isinstance(thing, Rope) else None
        self._make_marker = lambda count: cdr.mesh_marker(frame, name, width, count)
        triangles = sim.triangles(name)
        self._marker = self._make_marker(len(rest) if width else 3 * len(triangles)) if mesh else None
        for ends in self._ends:
            ends.attach(sim)
        self._surface, self._rest = Surface(sim, name), rest
        self._send_topology(triangles)

    def _send_topology(self, triangles: np.ndarray) -> None:
        self._triangles = len(triangles)
        self._topology.publish(cdr.topology_mesh(triangles, self._rest))

    def request(self) -> None:
        """Starts the writing and copying of what is wanted; the device does it while other objects are asked."""
        self._cloud_wanted = self._cloud is not None and self._particles.get_subscription_count() > 0
        self._mesh_wanted = self._marker is not None and self._mesh.get_subscription_count() > 0
        self._source = self._readback if self._cloud_wanted else self._positions if self._mesh_wanted else None
        if self._source is not None:
            self._source.request()
        if self._surface is not None:
            self._surface.request()
        for ends in self._ends:
            ends.request()

    def wait(self, stamp: tuple[int, int]) -> None:
        """Waits for what was requested; it will be sent stamped (seconds, nanoseconds)."""
        self._stamp = stamp
        if self._source is not None:
            self._source.wait()
        if self._surface is not None:
            triangles = self._surface.triangles()
            if len(triangles) != self._triangles:
                self._send_topology(triangles)
        for ends in self._ends:
            ends.wait(stamp)

    @property
    def size(self) -> int:
        """Bytes of what is to be sent, but for headers."""
        cloud = self._cloud.payload.nbytes if self._cloud_wanted else 0
        return cloud + (self._marker.payload.nbytes if self._mesh_wanted else 0)

    def publish(self) -> None:
        """Sends it."""
        if self._cloud_wanted:
            self._cloud.payload[:] = self._source.particles()
            self._particles.publish(self._cloud.stamped(self._stamp))
        if self._mesh_wanted:
            corners = self._source.mesh()
            if len(corners) != len(self._marker.payload):
                self._marker = self._make_marker(len(corners))
            self._marker.payload[:] = corners
            self._mesh.publish(self._marker.stamped(self._stamp))
        for ends in self._ends:
            ends.publish()
