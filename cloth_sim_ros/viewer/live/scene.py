# SPDX-License-Identifier: Apache-2.0
"""Draws what the topics of a node say: objects, colliders and handles."""

from __future__ import annotations

from typing import Any

import numpy as np
import viser
from sensor_msgs.msg import PointCloud2
from shape_msgs.msg import Mesh
from visualization_msgs.msg import Marker, MarkerArray

from cloth_sim_ros.viewer.drawing import COLOURS, Drawing
from cloth_sim_ros.viewer.live.remote import Known, positions_of

WIDE = 10.0  # [m] from which a box is a ground, so that ours is hidden


class LiveScene:
    """What is drawn of the scene `known`.

    positions: by object its newest particles (N, 3) [m], and stamps the time of each [ns]. places: by collider and
    handle its position (3,) [m].
    """

    def __init__(self, server: viser.ViserServer, drawing: Drawing, known: Known):
        self._server, self._drawing, self._known = server, drawing, known
        self._triangles: dict[str, np.ndarray] = {}
        self._shapes: dict[str, tuple] = {}  # of each marker: what cannot be moved
        self._bodies: dict[str, Any] = {}
        self._ground = server.scene.get_handle_by_name("/ground")
        self.positions: dict[str, np.ndarray] = {}
        self.stamps: dict[str, int] = {}
        self.places: dict[str, np.ndarray] = {}

    def topology(self, name: str, mesh: Mesh) -> None:
        """An object has other particles or triangles from now on; its next cloud is drawn with them."""
        self._triangles[name] = np.array([each.vertex_indices for each in mesh.triangles], np.uint32).reshape(-1, 3)
        if name in self._drawing.handles:
            self._drawing.remove(name)

    def cloud(self, name: str, cloud: PointCloud2) -> None:
        """An object's particles are there now."""
        positions = positions_of(cloud)
        self.positions[name] = positions
        self.stamps[name] = cloud.header.stamp.sec * 1_000_000_000 + cloud.header.stamp.nanosec
        if name not in self._triangles or not len(positions):
            return
        if name not in self._drawing.handles:
            self._draw(name, positions)
        else:
            self._drawing.move(name, positions)

    def _draw(self, name: str, positions: np.ndarray) -> None:
        triangles = self._triangles[name]
        colour = COLOURS[self._known.names("objects").index(name) % len(COLOURS)]
        if len(triangles) and triangles.max() < len(positions):
            self._drawing.cloth(name, positions, triangles, colour)
        elif not len(triangles) and len(positions) > 1:
            self._drawing.rope(name, positions, self._known.values[f"{name}.radius"], colour)

    def markers(self, array: MarkerArray) -> None:
        """All colliders and handles are these."""
        shown = {}
        for marker in array.markers:
            if marker.action == Marker.ADD:
                name = f"{marker.ns}/{marker.id}"
                shown[name] = marker
                self._show(name, marker)
        for name in set(self._bodies) - set(shown):
            self._bodies.pop(name).remove()
            del self._shapes[name]
        wide = any(each.type == Marker.CUBE and each.scale.x >= WIDE for each in shown.values())
        self._ground.visible = not wide

    def close(self) -> None:
        """Takes away what is drawn beside the objects."""
        for body in self._bodies.values():
            body.remove()
        self._ground.visible = True

    def _show(self, name: str, marker: Marker) -> None:
        p, q, s, c = marker.pose.position, marker.pose.orientation, marker.scale, marker.color
        if marker.id == 0:
            self.places[marker.ns] = np.array([p.x, p.y, p.z])
        shape = (marker.type, s.x, s.y, s.z, c.r, c.g, c.b, c.a)
        if self._shapes.get(name) != shape:
            if name in self._bodies:
                self._bodies[name].remove()
            self._bodies[name], self._shapes[name] = self._make(name, marker), shape
        body = self._bodies[name]
        body.position, body.wxyz = (p.x, p.y, p.z), (q.w, q.x, q.y, q.z)

    def _make(self, name: str, marker: Marker) -> Any:
        """The body of a marker: a cube, sphere or cylinder; a handle's has its name beside it."""
        scene, s, c = self._server.scene, marker.scale, marker.color
        path = f"/page/bodies/{name}"
        look = {
            "color": tuple(round(255 * share) for share in (c.r, c.g, c.b)),
            "opacity": c.a if c.a < 1.0 else None,
            "cast_shadow": c.a >= 1.0 and s.x < WIDE,
        }
        if marker.type == Marker.CUBE:
            if s.x >= WIDE:
                look["color"] = (232, 235, 239)
            body = scene.add_box(path, dimensions=(s.x, s.y, s.z), **look)
        elif marker.type == Marker.SPHERE:
            body = scene.add_icosphere(path, radius=0.5, scale=(s.x, s.y, s.z), subdivisions=4, **look)
        else:
            body = scene.add_cylinder(path, radius=0.5, height=1.0, scale=(s.x, s.y, s.z), radial_segments=48, **look)
        if marker.ns in self._known.names("handles"):
            scene.add_label(f"{path}/name", marker.ns, position=(0.0, 0.0, 0.6 * s.z), anchor="bottom-center")
        return body
