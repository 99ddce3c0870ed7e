# SPDX-License-Identifier: Apache-2.0
"""Messages of each object from device arrays: a particle cloud, a mesh to draw and, once, its topology."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from rclpy.node import Node
from sensor_msgs.msg import PointCloud2
from shape_msgs.msg import Mesh
from visualization_msgs.msg import Marker

from cloth_sim_ros.ros.outputs import cdr
from cloth_sim_ros.ros.outputs.output import LATCHED, LATEST, Output, Stamp
from cloth_sim_ros.ros.world import World
from cloth_sim_ros.sim import Readback, Rope, Simulation, Surface


class ObjectOutput(Output):
    """The topics of one object. Only what has a subscriber is computed, copied or sent.

    Particles and mesh share one copy; for a mesh alone it holds only positions.
    """

    def __init__(self, node: Node, values: Mapping[str, Any], name: str):
        self._name, self._frame_id = name, values["frame_id"]
        self._particles = node.create_publisher(PointCloud2, f"~/{name}/particles", LATEST)
        self._mesh = node.create_publisher(Marker, f"~/{name}/mesh", LATEST)
        self._topology = node.create_publisher(Mesh, f"~/{name}/topology", LATCHED)
        self._cloud_wanted = self._mesh_wanted = False
        self._stamp = (0, 0)
        self._detach()

    @classmethod
    def each(cls, node: Node, values: Mapping[str, Any]) -> Iterable[Output]:
        """Return one output for each object."""
        return [cls(node, values, name) for name in values["objects"]]

    @property
    def publishers(self) -> list:
        """Publishers of topics that may change in every frame; an object that tears has its topology among them."""
        tears = self._surface is not None and self._surface.tears
        return [self._particles, self._mesh, *([self._topology] if tears else [])]

    @property
    def owned(self) -> list:
        """All publishers."""
        return [self._particles, self._mesh, self._topology]

    def _detach(self) -> None:
        """Send nothing until the next attach(), as the object does not exist."""
        self._cloud = self._marker = self._source = self._surface = None

    def attach(self, sim: Simulation | None, values: Mapping[str, Any]) -> None:
        """Prepare messages and readbacks for another simulation and send the topology. A cloth has no tensions."""
        name, frame = self._name, self._frame_id
        if sim is None or name not in sim.scene.objects:
            self._detach()
            return
        thing, rest = sim.scene.objects[name], sim.rest_positions(name)
        normals, velocities, mesh = (values[f"publish.{what}"] for what in ("normals", "velocities", "mesh"))
        tensions = values["publish.tensions"] and isinstance(thing, Rope)
        columns = {"normals": normals, "velocities": velocities, "tensions": tensions}
        self._readback, self._positions = Readback(sim, name, mesh=mesh, **columns), Readback(sim, name, mesh=mesh)
        self._cloud = cdr.particle_cloud(frame, len(rest), cdr.cloud_fields(normals, velocities, tensions))
        width = 2 * thing.radius if isinstance(thing, Rope) else None
        self._make_marker = lambda count: cdr.mesh_marker(frame, name, width, count)
        triangles = sim.triangles(name)
        self._marker = self._make_marker(len(rest) if width else 3 * len(triangles)) if mesh else None
        self._surface, self._rest = Surface(sim, name), rest
        self._send_topology(triangles)

    def _send_topology(self, triangles: np.ndarray) -> None:
        self._triangles = len(triangles)
        self._topology.publish(cdr.topology_mesh(triangles, self._rest))

    def request(self, world: World, stamp: Stamp) -> None:
        """Start computing and copying the wanted data; the device goes on while other objects request theirs."""
        self._cloud_wanted = self._cloud is not None and self._particles.get_subscription_count() > 0
        self._mesh_wanted = self._marker is not None and self._mesh.get_subscription_count() > 0
        self._source = self._readback if self._cloud_wanted else self._positions if self._mesh_wanted else None
        if self._source is not None:
            self._source.request()
        if self._surface is not None:
            self._surface.request()

    def read(self, world: World, stamp: Stamp) -> None:
        """Wait for the requested data, which will be sent with `stamp`; send the topology if it has changed."""
        self._stamp = stamp
        if self._source is not None:
            self._source.wait()
        if self._surface is not None:
            triangles = self._surface.triangles()
            if len(triangles) != self._triangles:
                self._send_topology(triangles)

    @property
    def size(self) -> int:
        """Bytes to send, without headers."""
        cloud = self._cloud.payload.nbytes if self._cloud_wanted else 0
        return cloud + (self._marker.payload.nbytes if self._mesh_wanted else 0)

    def publish(self) -> None:
        """Send the data that was read."""
        if self._cloud_wanted:
            self._cloud.payload[:] = self._source.particles()
            self._particles.publish(self._cloud.stamped(self._stamp))
        if self._mesh_wanted:
            corners = self._source.mesh()
            if len(corners) != len(self._marker.payload):
                self._marker = self._make_marker(len(corners))
            self._marker.payload[:] = corners
            self._mesh.publish(self._marker.stamped(self._stamp))
