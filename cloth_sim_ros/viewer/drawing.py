# SPDX-License-Identifier: Apache-2.0
"""What is drawn under one name of a viser scene: cloths, ropes, balls, lines and labels, by name."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import viser

from cloth_sim_ros.viewer.tube import tube_faces, tube_vertices

Colour = tuple[int, int, int]
COLOURS: tuple[Colour, ...] = (
    (46, 112, 176), (226, 112, 72), (58, 140, 98), (146, 104, 178), (222, 170, 60), (74, 160, 178),
)  # fmt: skip
STEEL: Colour = (150, 156, 168)


@dataclass(frozen=True)
class Drag:
    """The mouse on an object: `phase` is start, update or end.

    grasped is where on the object it began, pointer where the mouse is now, both (3,) in the world [m].
    """

    name: str
    phase: str
    grasped: np.ndarray
    pointer: np.ndarray


class Drawing:
    """Objects by name. What is drawn anew under a name replaces what was there; `clear` removes all.

    dragged(drag) is called in the server's thread, in order, where somebody drags a cloth or a rope.
    """

    def __init__(self, server: viser.ViserServer, root: str, dragged: Callable[[Drag], None] = lambda drag: None):
        self._server, self._root, self._dragged = server, root, dragged
        self._radii: dict[str, float] = {}
        self.handles: dict[str, Any] = {}
        server.scene.add_frame(root, show_axes=False)

    def cloth(self, name: str, vertices: np.ndarray, triangles: np.ndarray, colour: Colour, **options: Any) -> None:
        """A sheet of `vertices` (N, 3) [m] and `triangles` (T, 3), smooth, seen from both sides."""
        self._radii.pop(name, None)
        self._mesh(name, vertices, triangles, colour, **options)

    def rope(self, name: str, points: np.ndarray, radius: float, colour: Colour) -> None:
        """A tube of `radius` [m] around `points` (N, 3) [m]."""
        self._radii[name] = radius
        self._mesh(name, tube_vertices(np.asarray(points), radius), tube_faces(len(points)), colour)

    def move(self, name: str, positions: np.ndarray) -> None:
        """The particles of a cloth or rope are at `positions` (N, 3) [m] now."""
        radius = self._radii.get(name)
        self.handles[name].vertices = positions if radius is None else tube_vertices(positions, radius)

    def ball(self, name: str, radius: float, position: np.ndarray, colour: Colour, **options: Any) -> None:
        """A ball [m]."""
        self._keep(
            name,
            self._server.scene.add_icosphere(
                self._path(name), radius=radius, position=tuple(position), color=colour, subdivisions=4, **options
            ),
        )

    def place(self, name: str, position: np.ndarray) -> None:
        """Moves a ball or a label to `position` (3,) [m]."""
        self.handles[name].position = tuple(position)

    def lines(self, name: str, points: np.ndarray, colours: np.ndarray, thickness: float = 2.0) -> None:
        """Segments `points` (E, 2, 3) [m], each of a colour (E, 3) of 0 to 255, `thickness` pixels wide."""
        colours = np.repeat(np.asarray(colours, np.uint8)[:, None], 2, axis=1)
        if name in self.handles and len(self.handles[name].points) == len(points):
            self.handles[name].points = points
            self.handles[name].colors = colours
            return
        self._keep(
            name,
            self._server.scene.add_line_segments(
                self._path(name), points=np.asarray(points, np.float32), colors=colours, thickness=thickness
            ),
        )

    def dots(self, name: str, points: np.ndarray, colours: np.ndarray, size: float) -> None:
        """Round points (N, 3) [m], each of a colour (N, 3) of 0 to 255, of `size` [m]."""
        if name in self.handles and len(self.handles[name].points) == len(points):
            self.handles[name].points = points
            self.handles[name].colors = colours
            return
        self._keep(
            name,
            self._server.scene.add_point_cloud(
                self._path(name),
                np.asarray(points),
                np.asarray(colours, np.uint8),
                point_size=size,
                point_shape="circle",
            ),
        )

    def label(self, name: str, text: str, position: np.ndarray) -> None:
        """Words in the scene."""
        if name in self.handles:
            self.handles[name].text = text
            self.place(name, position)
            return
        self._keep(
            name, self._server.scene.add_label(self._path(name), text, position=tuple(position), anchor="bottom-center")
        )

    def remove(self, name: str) -> None:
        """Takes one thing away."""
        self.handles.pop(name).remove()
        self._radii.pop(name, None)

    def clear(self) -> None:
        """Takes all of it away."""
        for name in list(self.handles):
            self.remove(name)

    def _path(self, name: str) -> str:
        return f"{self._root}/{name}"

    def _keep(self, name: str, handle: Any) -> None:
        self.handles[name] = handle

    def _mesh(self, name: str, vertices: np.ndarray, faces: np.ndarray, colour: Colour, **options: Any) -> None:
        mesh = self._server.scene.add_mesh_simple(
            self._path(name), np.asarray(vertices), np.asarray(faces), color=colour, side="double", **options
        )
        self._keep(name, mesh)

        async def on_drag(event: Any) -> None:  # a coroutine, as those run in the order of the events
            start, end = np.array(event.start_position), np.array(event.end_position)
            self._dragged(Drag(name, event.phase, start, end))

        mesh.on_drag(on_drag)
