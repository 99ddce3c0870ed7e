# SPDX-License-Identifier: Apache-2.0
"""A simulation that is drawn, and a handle by which the mouse drags its particles."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from cloth_sim_ros.sim import Cloth, Handle, Scene, Settings, Simulation, Sphere
from cloth_sim_ros.viewer.drawing import COLOURS, STEEL, Colour, Drag, Drawing

HAND = "hand"
REACH = 0.02  # [m] of the hand that drags

THIN = 3e-4  # [m] half of what a cloth is thick, so that lines on it are seen


class Stage:
    """Simulates `scene` with one handle, the hand, and draws its objects and balls; `sim` is the simulation."""

    def __init__(self, drawing: Drawing, scene: Scene, settings: Settings | None = None):
        hand = Handle(reach=REACH, position=(0.0, 0.0, 100.0))
        self.sim = Simulation(dataclasses.replace(scene, handles={HAND: hand}), settings)
        self._drawing = drawing
        self._vertex: tuple[str, int] | None = None
        self._set: dict[str, Any] = {}
        self._colours: dict[str, Colour] = {}
        self._triangles: dict[str, int] = {}  # how many are drawn
        self.refused = ""
        for k, (name, thing) in enumerate(scene.objects.items()):
            colour, positions = COLOURS[k % len(COLOURS)], self.sim.positions(name)
            if isinstance(thing, Cloth):
                self._colours[name] = colour
                self._draw_cloth(name)
            else:
                drawing.rope(name, positions, thing.radius, colour)
        for name, thing in scene.colliders.items():
            if isinstance(thing, Sphere):
                drawing.ball(name, thing.radius, thing.position, STEEL)

    def apply(self, name: str, value: Any) -> None:
        """Set a live parameter if its value differs. `refused` is the sentence if it is not allowed, else ""."""
        if self._set.get(name) == value:
            return
        self._set[name], self.refused = value, ""
        try:
            self.sim.set(name, value)
        except ValueError as error:
            self.refused = str(error)

    def step(self) -> None:
        """Simulate and draw one frame."""
        self.sim.step()
        self.draw()

    def draw(self) -> None:
        """Move the drawn objects to their current positions."""
        for name in self.sim.scene.objects:
            if self.sim.tears(name) and len(self.sim.triangles(name)) != self._triangles[name]:
                self._draw_cloth(name)
            self._drawing.move(name, self.sim.positions(name))

    def _draw_cloth(self, name: str) -> None:
        triangles = self.sim.triangles(name)
        self._triangles[name] = len(triangles)
        rest = self.sim.rest_positions(name)
        self._drawing.cloth(name, self.sim.positions(name), triangles, self._colours[name], THIN, rest)

    def drag(self, drag: Drag) -> None:
        """Let the hand grasp the particle at the mouse, follow the mouse, and let go."""
        if drag.phase == "start" and drag.name in self.sim.scene.objects:
            positions = self.sim.positions(drag.name)
            vertex = int(np.linalg.norm(positions - drag.grasped, axis=1).argmin())
            self.sim.set_handle_pose(HAND, positions[vertex], sweep=False)
            self._vertex = (drag.name, vertex) if self.sim.attach(HAND) else None
        elif self._vertex is not None:
            self.sim.set_handle_pose(HAND, drag.pointer)
            if drag.phase == "end":
                self.sim.release(HAND)
                self._vertex = None

    @property
    def dragged(self) -> tuple[str, int] | None:
        """Object and index of the dragged particle, or None."""
        return self._vertex
