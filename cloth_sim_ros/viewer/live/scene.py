# SPDX-License-Identifier: Apache-2.0
"""Draw the objects, colliders and handles that a node's topics report."""

from __future__ import annotations

import logging
from functools import partial
from typing import Any

import numpy as np
import viser
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import PointCloud2
from shape_msgs.msg import Mesh
from trimesh.creation import box, cylinder, icosphere
from visualization_msgs.msg import Marker, MarkerArray

from cloth_sim_ros.sim.mesh_file import load_mesh
from cloth_sim_ros.viewer.drawing import COLOURS, STEEL, Drawing
from cloth_sim_ros.viewer.live.fittings import Fittings, hand
from cloth_sim_ros.viewer.live.remote import Known, positions_of
from cloth_sim_ros.viewer.look import LINES

SHOWN = 0.7  # drawn share of a cloth's thickness: layers that touch stay apart in the picture
HAND = 0.03  # [m] size of a hand
WIDE = 10.0  # [m] least size of a box that stands for a plane, which replaces our ground
MOST_MOVED = 3000  # most vertices of a body that moves by its vertices
_log = logging.getLogger(__name__)


class LiveScene:
    """Picture of the scene `known`.

    By object: triangles (T, 3), newest positions (N, 3) [m], starts (its first positions), and stamps [ns] of the
    newest. places: position (3,) [m] of each collider and handle. bodies: the drawn object of each marker, by
    namespace/id.
    """

    def __init__(self, server: viser.ViserServer, drawing: Drawing, known: Known):
        self._server, self._drawing, self._known = server, drawing, known
        self.triangles: dict[str, np.ndarray] = {}
        self._shapes: dict[str, tuple] = {}  # of each marker: what cannot be moved
        self._corners: dict[str, np.ndarray] = {}  # of a body at the origin (N, 3) [m]
        self._labels: dict[str, Any] = {}
        self.bodies: dict[str, Any] = {}
        self._ground = server.scene.get_handle_by_name("/ground")
        self.positions: dict[str, np.ndarray] = {}
        self.starts: dict[str, np.ndarray] = {}
        self.stamps: dict[str, int] = {}
        self.places: dict[str, np.ndarray] = {}

    def topology(self, name: str, mesh: Mesh) -> None:
        """Take new particles or triangles of an object; its next cloud is drawn with them."""
        self.triangles[name] = np.array([each.vertex_indices for each in mesh.triangles], np.uint32).reshape(-1, 3)
        self.starts[name] = np.array([(each.x, each.y, each.z) for each in mesh.vertices]).reshape(-1, 3)
        for drawn in {name, _held(name)} & set(self._drawing.handles):
            self._drawing.remove(drawn)

    def cloud(self, name: str, cloud: PointCloud2) -> None:
        """Draw an object's particles at their new positions.

        A cloud of another topology is late or early, and is left out.
        """
        positions = positions_of(cloud)
        if len(positions) != len(self.starts.get(name, ())):
            return
        self.positions[name] = positions
        self.stamps[name] = cloud.header.stamp.sec * 1_000_000_000 + cloud.header.stamp.nanosec
        if name in self._drawing.handles:
            for drawn in {name, _held(name)} & set(self._drawing.handles):
                self._drawing.move(drawn, positions)
            return
        values = self._known.values
        colour = COLOURS[self._known.names("objects").index(name) % len(COLOURS)]
        if len(self.triangles[name]):
            half = SHOWN * values[f"{name}.thickness"]
            self._drawing.cloth(name, positions, self.triangles[name], colour, half, self.starts[name])
        else:
            self._drawing.rope(name, positions, values[f"{name}.radius"], colour)
        fittings = Fittings(values, name, len(positions))
        if len(fittings.faces):
            self._drawing.body(_held(name), fittings.vertices, positions, fittings.faces, STEEL)

    def markers(self, array: MarkerArray) -> None:
        """Draw all colliders and handles, and remove those that are not among the markers."""
        shown = {}
        for marker in array.markers:
            if marker.action == Marker.ADD:
                name = f"{marker.ns}/{marker.id}"
                shown[name] = marker
                self._show(name, marker)
        for name in set(self.bodies) - set(shown):
            self._remove(name)
        wide = any(each.type == Marker.CUBE and each.scale.x >= WIDE for each in shown.values())
        self._ground.visible = not wide

    def close(self) -> None:
        """Remove everything drawn beside the objects."""
        for name in list(self.bodies):
            self._remove(name)
        self._ground.visible = True

    def _show(self, name: str, marker: Marker) -> None:
        p, q, s, c = marker.pose.position, marker.pose.orientation, marker.scale, marker.color
        place, turn = np.array([p.x, p.y, p.z]), Rotation.from_quat((q.x, q.y, q.z, q.w))
        if marker.id == 0:
            self.places[marker.ns] = place
        shape = (marker.type, s.x, s.y, s.z, c.r, c.g, c.b, c.a, marker.mesh_resource, _sketch(marker.points))
        if self._shapes.get(name) != shape:
            if name in self.bodies:
                self._remove(name)
            self._make(name, marker)
            self._shapes[name] = shape
        if name in self._corners:
            self.bodies[name].vertices = turn.apply(self._corners[name]) + place
        else:
            self.bodies[name].position, self.bodies[name].wxyz = place, (q.w, q.x, q.y, q.z)
        if name in self._labels:
            self._labels[name].position = place + (0.0, 0.0, np.ptp(self._corners[name][:, 2]) + 0.01)

    def _remove(self, name: str) -> None:
        for things in (self.bodies, self._labels):
            if name in things:
                things.pop(name).remove()
        self._corners.pop(name, None)
        del self._shapes[name]

    def _make(self, name: str, marker: Marker) -> None:
        """Draw the body of a marker; that of a handle has its name beside it.

        Bodies are moved by their vertices, as cloths are, so that a browser shows both at the same time. A plane and a
        large mesh are moved by their pose.
        """
        scene, s, c, path = self._server.scene, marker.scale, marker.color, f"/page/bodies/{name}"
        if marker.type == Marker.CUBE and s.x >= WIDE:
            self.bodies[name] = scene.add_frame(path, show_axes=False)
            surface = {"position": (0.0, 0.0, 0.5 * s.z), "plane_color": (240, 242, 245), "plane_opacity": 1.0}
            scene.add_grid(f"{path}/surface", width=s.x, height=s.y, **surface, **LINES)
            return
        handle = marker.ns in self._known.names("handles")
        if handle and marker.type == Marker.SPHERE:  # whose colour says whether it holds
            corners, faces = hand(HAND)
            c.a = 1.0
        else:
            corners, faces = _surface(marker)
        if len(corners) <= MOST_MOVED:
            self._corners[name] = corners
        self.bodies[name] = scene.add_mesh_simple(
            path,
            corners,
            faces,
            color=tuple(round(255 * share) for share in (c.r, c.g, c.b)),
            opacity=c.a if c.a < 1.0 else None,
            cast_shadow=c.a >= 1.0,
            flat_shading=marker.type != Marker.SPHERE,
        )
        if handle:
            self._labels[name] = scene.add_label(f"/page/labels/{name}", marker.ns, anchor="bottom-center")


def _surface(marker: Marker) -> tuple[np.ndarray, np.ndarray]:
    """Return vertices (V, 3) [m] and faces (F, 3) of a marker at the origin; none of a file that cannot be read."""
    scale = (marker.scale.x, marker.scale.y, marker.scale.z)
    points = np.array([(each.x, each.y, each.z) for each in marker.points]).reshape(-1, 3)
    if marker.type == Marker.MESH_RESOURCE:
        try:
            vertices, faces = load_mesh(marker.mesh_resource, f"the mesh of {marker.ns}")
        except ValueError as error:
            _log.warning("cloth_sim_viewer: a collider is not drawn: %s", error)
            return np.zeros((0, 3)), np.zeros((0, 3), int)
        return vertices * scale, faces
    if marker.type == Marker.TRIANGLE_LIST:
        return points * scale, np.arange(len(points)).reshape(-1, 3)
    if marker.type == Marker.CUBE_LIST:
        unit = box(scale)
        faces = unit.faces + len(unit.vertices) * np.arange(len(points))[:, None, None]
        return (unit.vertices + points[:, None]).reshape(-1, 3), faces.reshape(-1, 3)
    shapes = {Marker.CUBE: box, Marker.SPHERE: partial(icosphere, 4, 0.5)}
    unit = shapes.get(marker.type, partial(cylinder, 0.5, 1.0, sections=64))()
    return unit.vertices * scale, unit.faces


def _sketch(points: list) -> tuple:
    """Return the number of points and some of them, which identify a list of points at little cost."""
    return len(points), *((each.x, each.y, each.z) for each in points[:: 1 + len(points) // 8])


def _held(name: str) -> str:
    """Return the name under which an object's fittings are drawn."""
    return f"{name} fittings"
