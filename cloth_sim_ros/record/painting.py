# SPDX-License-Identifier: Apache-2.0
"""A picture of a scene: objects in colours, colliders in steel, on a floor with shadows."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from cloth_sim_ros.drawing.camera import Camera, Surface, paint

COLOURS = (("#f2785c", "#f7a48c"), ("#3d7f6b", "#7fb5a4"), ("#c9973f", "#e3c387"))
STEEL, SHADE = "#3d6b8c", "#e9e6e1"
INCHES, DOTS = (6.4, 4.8), 100
AWAY = np.array([-0.55, -0.75, 0.42])  # direction from the middle of the scene to the camera

Shape = tuple[np.ndarray, np.ndarray]  # vertices (V, 3) [m] and triangles (F, 3)


def camera_on(places: np.ndarray) -> Camera:
    """Return a camera that sees all of `places` (N, 3) [m]."""
    low, high = places.min(axis=0), places.max(axis=0)
    middle, reach = 0.5 * (low + high), np.linalg.norm(high - low)
    return Camera(tuple(middle + 1.35 * reach * AWAY / np.linalg.norm(AWAY)), tuple(middle))


def paint_frame(figure: Figure, camera: Camera, objects: list[Shape], bodies: list[Shape], floor: float) -> None:
    """Clear the figure and paint objects and bodies above the plane z = floor [m]."""
    figure.clear()
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    surfaces = [Surface(*shape, *COLOURS[k % len(COLOURS)]) for k, shape in enumerate(objects)]
    surfaces += [Surface(*body, STEEL, STEEL, gloss=0.3) for body in bodies]
    paint(axes, camera, surfaces, floor, SHADE)
    axes.set(xlim=(-0.45, 0.45), ylim=(-0.3375, 0.3375))
