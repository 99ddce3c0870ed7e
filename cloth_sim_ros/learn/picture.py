# SPDX-License-Identifier: Apache-2.0
"""Pictures of worlds, painted like those of the documents."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from trimesh.creation import icosphere

from cloth_sim_ros.drawing.tube import tube_faces, tube_vertices
from cloth_sim_ros.record.painting import DOTS, INCHES, camera_on, paint_frame
from cloth_sim_ros.record.solids import mesh_of
from cloth_sim_ros.sim import Plane, Rope, Simulation
from cloth_sim_ros.sim.physics.quaternion import rotate

_HAND = icosphere(2, 0.012)


def pictures(sim: Simulation, hands: np.ndarray) -> tuple[np.ndarray, ...]:
    """Return a picture (480, 640, 3) uint8 of each world; hands (worlds, H, 3) [m] are small balls."""
    figure = Figure(figsize=INCHES, dpi=DOTS, facecolor="white")
    canvas = FigureCanvasAgg(figure)
    rest = np.concatenate([sim.rest_positions(name) for name in sim.scene.objects])
    planes = [collider.position[2] for collider in sim.scene.colliders.values() if isinstance(collider, Plane)]
    floor = max(planes, default=float(rest[:, 2].min()) - 0.1)
    places = {name: sim.positions(name, None) for name in sim.scene.objects}
    solids = [_solids(sim, w) for w in range(sim.worlds)]
    camera, found = camera_on(np.concatenate([rest, hands[0], *(points for points, _ in solids[0])])), []
    for w in range(sim.worlds):
        shapes = [_shape(sim, name, rows[w].astype(np.float64)) for name, rows in places.items()]
        balls = [(_HAND.vertices + place, _HAND.faces) for place in hands[w]]
        paint_frame(figure, camera, shapes, [*solids[w], *balls], floor)
        canvas.draw()
        found.append(np.asarray(canvas.buffer_rgba())[:, :, :3].copy())
    return tuple(found)


def _solids(sim: Simulation, world: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return vertices and triangles of the colliders of a world, except planes, with their current sizes and poses."""
    found = []
    for name, collider in sim.scene.colliders.items():
        size = {row.name: sim.get(f"{name}.{row.name}", world) for row in collider.dimensions if row.live}
        mesh = None if isinstance(collider, Plane) else mesh_of(replace(collider, **size))
        if mesh is not None:
            turn = np.array(sim.get(f"{name}.orientation", world))
            found.append((rotate(turn, mesh.vertices) + sim.get(f"{name}.position", world), np.asarray(mesh.faces)))
    return found


def _shape(sim: Simulation, name: str, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return vertices and triangles of an object whose particles are at `points` (N, 3)."""
    thing = sim.scene.objects[name]
    if isinstance(thing, Rope):
        return tube_vertices(points, thing.radius), tube_faces(len(points))
    return points, sim.triangles(name)
