# SPDX-License-Identifier: Apache-2.0
"""A film as a GIF, an MP4 or numbered PNGs, painted like the pictures of the documents."""

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
from cloth_sim_ros.record.painting import DOTS, INCHES, camera_on, paint_frame
from cloth_sim_ros.sim.physics.quaternion import rotate

NO_FFMPEG = "an MP4 needs ffmpeg; make extras adds it, and so does pip install imageio-ffmpeg; or write a .gif"


def write_movie(film: Film, path: Path, rate: float) -> None:
    """Write .mp4 or .gif, or PNGs into a folder. Raises ValueError if ffmpeg is missing for an .mp4."""
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
    """Paint one frame after the other, and yield its number."""
    bodies = [body for body in film.colliders.values() if not body.is_plane]
    places = np.concatenate([shape.vertices.reshape(-1, 3) for shape in film.objects.values()])
    camera, low, high = camera_on(places), places.min(axis=0), places.max(axis=0)
    below = low[2] - 0.05 * np.linalg.norm(high - low)
    for frame in tqdm(range(len(film.times)), "painting", unit="frames", disable=None):  # silent but on a terminal
        shapes = [(shape.vertices[frame], shape.triangles) for shape in film.objects.values()]
        solids = [
            (np.asarray(rotate(body.orientations[frame], body.vertices) + body.positions[frame]), body.triangles)
            for body in bodies
        ]
        planes = [body.positions[frame][2] for body in film.colliders.values() if body.is_plane]
        paint_frame(figure, camera, shapes, solids, max(planes, default=below))
        yield frame
