# SPDX-License-Identifier: Apache-2.0
"""Named objects under one node of a viser scene: cloths, ropes, balls, lines and labels."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import viser
from trimesh.creation import icosphere

from cloth_sim_ros.drawing.sheet import Shell, checks, strands
from cloth_sim_ros.drawing.tube import tube_faces, tube_vertices

Colour = tuple[int, int, int]
COLOURS: tuple[Colour, ...] = (
    (46, 112, 176), (226, 112, 72), (58, 140, 98), (146, 104, 178), (222, 170, 60), (74, 160, 178),
)  # fmt: skip
TO_LAMP = np.array([-0.3, -0.6, 0.7])  # rough direction to the light
STEEL: Colour = (150, 156, 168)


@dataclass(frozen=True)
class Drag:
    """A drag of the mouse on an object: `phase` is start, update or end.

    grasped is the point on the object where it began, pointer is the mouse's place now, both (3,) in the world [m].
    """

    name: str
    phase: str
    grasped: np.ndarray
    pointer: np.ndarray


@dataclass(frozen=True)
class Click:
    """A click on an object, without a drag: the ray from the eye, its origin [m] and unit direction, both (3,)."""

    name: str
    origin: np.ndarray
    direction: np.ndarray


class Drawing:
    """Objects by name. Drawing under a name again replaces its object; `clear` removes all.

    used(drag or click) is called in the server's thread, in order, for each use of the mouse on a cloth or a rope.
    """

    def __init__(self, server: viser.ViserServer, root: str, used: Callable[[Drag | Click], None] = lambda use: None):
        self._server, self._root, self._used = server, root, used
        self._vertices: dict[str, Callable[[np.ndarray], np.ndarray]] = {}  # of a mesh, from positions
        self.handles: dict[str, Any] = {}
        server.scene.add_frame(root, show_axes=False)

    def cloth(
        self,
        name: str,
        vertices: np.ndarray,
        triangles: np.ndarray,
        colour: Colour,
        half: float = 2e-3,
        rest: np.ndarray | None = None,
    ) -> None:
        """Draw a sheet of `vertices` (N, 3) [m] and `triangles` (T, 3), checked in front and plain behind.

        half: distance [m] of each side from the middle, so that layers do not fight. rest (N, 3) [m]: positions that
        place the checks; None takes the vertices.
        """
        vertices, triangles = np.asarray(vertices), np.asarray(triangles)
        shell = Shell(len(vertices), triangles, half)
        dark = checks(vertices if rest is None else rest, triangles)
        tones = [
            (shell.front[~dark], colour),
            (shell.front[dark], _mixed(colour, 0.45, (255, 255, 255))),
            (np.concatenate([shell.back, shell.hem]), _mixed(colour, 0.35, (40, 30, 50))),
        ]
        self._toned(name, shell.vertices, vertices, tones)

    def rope(self, name: str, points: np.ndarray, radius: float, colour: Colour) -> None:
        """Draw a tube of `radius` [m] around `points` (N, 3) [m], of two strands."""
        faces = tube_faces(len(points))
        dark = strands(faces, len(points))
        tones = [(faces[~dark], colour), (faces[dark], _mixed(colour, 0.6, (255, 255, 255)))]
        self._toned(name, lambda positions: tube_vertices(positions, radius), np.asarray(points), tones)

    def body(self, name: str, shape: Callable, positions: np.ndarray, faces: np.ndarray, colour: Colour) -> None:
        """Draw a body of `faces` (F, 3) whose vertices are shape(positions). The mouse cannot drag it."""
        self._vertices[name] = shape
        path = self._path(name)
        self.handles[name] = self._server.scene.add_mesh_simple(
            path, shape(positions), faces, color=colour, flat_shading=False
        )

    def net(self, name: str, vertices: np.ndarray, pairs: np.ndarray, colour: Colour) -> None:
        """Draw thin lines between `pairs` (E, 2) of `vertices` (N, 3) [m]; `move` moves them at a cloth's cost."""
        count = len(vertices)
        faces = np.concatenate([pairs, count + np.arange(len(pairs))[:, None]], axis=1)
        self._vertices[name] = lambda positions: _slivers(positions, pairs)
        self.handles[name] = self._server.scene.add_mesh_simple(
            self._path(name),
            _slivers(vertices, pairs),
            faces,
            color=colour,
            wireframe=True,
            cast_shadow=False,
            receive_shadow=False,
        )

    def move(self, name: str, positions: np.ndarray) -> None:
        """Move the particles of a cloth, rope, body or net to `positions` (N, 3) [m].

        A browser draws all that is moved so at the same time, but not other things, such as labels.
        """
        vertices, handle = self._vertices[name](positions), self.handles[name]
        if not isinstance(handle, Parts):
            handle.vertices = vertices
            return
        with self._server.atomic():
            for used, mesh in handle.meshes:
                mesh.vertices = vertices[used]

    def ball(self, name: str, radius: float, position: np.ndarray, colour: Colour) -> None:
        """Draw a ball [m]; `move` moves it to another position (3,)."""
        sphere = icosphere(subdivisions=3, radius=radius)
        self._vertices[name] = lambda position: sphere.vertices + position
        path, vertices = self._path(name), sphere.vertices + np.asarray(position)
        self.handles[name] = self._server.scene.add_mesh_simple(path, vertices, sphere.faces, color=colour)

    def lines(self, name: str, points: np.ndarray, colours: np.ndarray, thickness: float = 2.0) -> None:
        """Draw segments `points` (E, 2, 3) [m] with colours (E, 3) from 0 to 255, `thickness` pixels wide."""
        colours = np.repeat(np.asarray(colours, np.uint8)[:, None], 2, axis=1)
        if name in self.handles and len(self.handles[name].points) == len(points):
            self.handles[name].points = points
            self.handles[name].colors = colours
            return
        self.handles[name] = self._server.scene.add_line_segments(
            self._path(name),
            points=np.asarray(points, np.float32),
            colors=colours,
            thickness=thickness,
            thickness_units="screen",
        )

    def dots(self, name: str, points: np.ndarray, colours: np.ndarray, size: float) -> None:
        """Draw round points (N, 3) [m] with colours (N, 3) from 0 to 255, of `size` [m]."""
        if name in self.handles and len(self.handles[name].points) == len(points):
            self.handles[name].points = points
            self.handles[name].colors = colours
            return
        self.handles[name] = self._server.scene.add_point_cloud(
            self._path(name), np.asarray(points), np.asarray(colours, np.uint8), point_size=size, point_shape="circle"
        )

    def label(self, name: str, text: str, position: np.ndarray) -> None:
        """Show a text at a position [m] in the scene."""
        if name in self.handles:
            self.handles[name].text, self.handles[name].position = text, tuple(position)
            return
        self.handles[name] = self._server.scene.add_label(
            self._path(name), text, position=tuple(position), anchor="bottom-center"
        )

    def remove(self, name: str) -> None:
        """Remove one object."""
        self.handles.pop(name).remove()

    def clear(self) -> None:
        """Remove all objects."""
        for name in list(self.handles):
            self.remove(name)

    def _path(self, name: str) -> str:
        return f"{self._root}/{name}"

    def _toned(self, name: str, shape: Callable[[np.ndarray], np.ndarray], positions: np.ndarray, tones: list) -> None:
        """Draw a body of several colours, as viser has one for each mesh. tones: faces and colour of each."""
        self._vertices[name], vertices = shape, shape(positions)
        parts = Parts()
        for k, (faces, colour) in enumerate(each for each in tones if len(each[0])):
            used, own = np.unique(faces, return_inverse=True)
            mesh = self._server.scene.add_mesh_simple(
                f"{self._path(name)}/{k}", vertices[used], own.reshape(-1, 3), color=colour, side="double"
            )
            parts.meshes.append((used, mesh))
            self._listen(name, mesh)
        self.handles[name] = parts

    def _listen(self, name: str, mesh: Any) -> None:
        async def on_drag(event: Any) -> None:  # a coroutine, as those run in the order of the events
            start, end = np.array(event.start_position), np.array(event.end_position)
            self._used(Drag(name, event.phase, start, end))

        async def on_click(event: Any) -> None:
            self._used(Click(name, np.array(event.ray_origin), np.array(event.ray_direction)))

        mesh.on_drag(on_drag)
        mesh.on_click(on_click)


class Parts:
    """Meshes that form one object: `meshes` holds the indices of its vertices that each mesh uses, and the mesh."""

    def __init__(self) -> None:
        self.meshes: list[tuple[np.ndarray, Any]] = []

    @property
    def faces(self) -> np.ndarray:
        """All faces (F, 3), as indices of the object's vertices."""
        return np.concatenate([used[mesh.faces] for used, mesh in self.meshes])

    @property
    def vertices(self) -> np.ndarray:
        """All vertices (V, 3) [m]."""
        found = np.zeros((1 + max(used[-1] for used, _ in self.meshes), 3), np.float32)
        for used, mesh in self.meshes:
            found[used] = mesh.vertices
        return found

    @property
    def visible(self) -> bool:
        """True if all meshes are visible."""
        return all(mesh.visible for _, mesh in self.meshes)

    @visible.setter
    def visible(self, on: bool) -> None:
        for _, mesh in self.meshes:
            mesh.visible = on

    def remove(self) -> None:
        """Remove all meshes."""
        for _, mesh in self.meshes:
            mesh.remove()


def _mixed(colour: Colour, share: float, other: Colour) -> Colour:
    return tuple(round((1.0 - share) * a + share * b) for a, b in zip(colour, other, strict=True))


def _slivers(positions: np.ndarray, pairs: np.ndarray) -> np.ndarray:
    """Return the vertices of a net: the positions, and one beside the middle of each line to light it."""
    a, b = positions[pairs[:, 0]], positions[pairs[:, 1]]
    return np.concatenate([positions, 0.5 * (a + b) + 1e-3 * np.cross(TO_LAMP, b - a)])
