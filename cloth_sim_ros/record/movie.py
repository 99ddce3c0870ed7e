# SPDX-License-Identifier: Apache-2.0
"""A film as a GIF, an MP4 or numbered PNGs, painted as the pictures of the documents are."""

from __future__ import annotations

import importlib.util
from collections.abc import Iterator
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.animation import FFMpegWriter, PillowWriter
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from tqdm import tqdm

from cloth_sim_ros.record.film import Film
from cloth_sim_ros.sim.quaternion import rotate
from cloth_sim_ros.study.pictures.camera import Camera, Surface, paint

COLOURS = (("#f2785c", "#f7a48c"), ("#3d7f6b", "#7fb5a4"), ("#c9973f", "#e3c387"))
STEEL, SHADE = "#3d6b8c", "#e9e6e1"
INCHES, DOTS = (6.4, 4.8), 100
AWAY = np.array([-0.55, -0.75, 0.42])  # of the camera from what it shows
NO_FFMPEG = "an MP4 needs ffmpeg: pip install imageio-ffmpeg, or write a .gif"


def write_movie(film: Film, path: Path, rate: float) -> None:
    """Writes .mp4 or .gif, or PNGs into a folder. Raises ValueError where there is no ffmpeg for an .mp4."""
    figure = Figure(figsize=INCHES, dpi=DOTS, facecolor="white")
    FigureCanvasAgg(figure)
    if path.suffix not in (".mp4", ".gif"):
        path.mkdir(parents=True, exist_ok=True)
        for frame in _painted(film, figure):
            figure.savefig(path / f"{frame:05d}.png")
        return
    writer = PillowWriter(rate) if path.suffix == ".gif" else _ffmpeg(rate)
    with writer.saving(figure, str(path), DOTS):
        for _ in _painted(film, figure):
            writer.grab_frame()


def _ffmpeg(rate: float) -> FFMpegWriter:
    if not FFMpegWriter.isAvailable() and importlib.util.find_spec("imageio_ffmpeg"):
        import imageio_ffmpeg

        matplotlib.rcParams["animation.ffmpeg_path"] = imageio_ffmpeg.get_ffmpeg_exe()
    if not FFMpegWriter.isAvailable():
        raise ValueError(NO_FFMPEG)
    return FFMpegWriter(rate, extra_args=["-pix_fmt", "yuv420p"])


def _painted(film: Film, figure: Figure) -> Iterator[int]:
    """Paints one frame after the other, and gives its number."""
    bodies = {name: body for name, body in film.colliders.items() if not body.is_plane}
    places = [shape.vertices.reshape(-1, 3) for shape in film.objects.values()]
    low, high = np.concatenate(places).min(axis=0), np.concatenate(places).max(axis=0)
    middle, reach = 0.5 * (low + high), np.linalg.norm(high - low)
    camera = Camera(tuple(middle + 1.35 * reach * AWAY / np.linalg.norm(AWAY)), tuple(middle))
    for frame in tqdm(range(len(film.times)), "painting", unit="frames", disable=None):  # silent but on a terminal
        figure.clear()
        axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
        surfaces = [
            Surface(shape.vertices[frame], shape.triangles, *COLOURS[k % len(COLOURS)])
            for k, shape in enumerate(film.objects.values())
        ]
        for body in bodies.values():
            corners = rotate(body.orientations[frame], body.vertices) + body.positions[frame]
            surfaces.append(Surface(np.asarray(corners), body.triangles, STEEL, STEEL, gloss=0.3))
        planes = [body.positions[frame][2] for body in film.colliders.values() if body.is_plane]
        paint(axes, camera, surfaces, max(planes, default=low[2] - 0.05 * reach), SHADE)
        axes.set(xlim=(-0.45, 0.45), ylim=(-0.3375, 0.3375))
        yield frame
