# SPDX-License-Identifier: Apache-2.0
"""Shaded triangles in perspective: a camera, one lamp, a shadow on the floor, painted from far to near."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import to_rgb

LAMP = np.array([-0.45, -0.75, 0.95])  # direction towards the lamp


@dataclass(frozen=True)
class Surface:
    """Triangles (T, 3) of points (N, 3) [m], with the colour `front` where they turn counter-clockwise, else `back`."""

    points: np.ndarray
    triangles: np.ndarray
    front: str
    back: str
    gloss: float = 0.15


@dataclass(frozen=True)
class Camera:
    """A camera that looks from `eye` at `target` [m], z up."""

    eye: tuple[float, float, float]
    target: tuple[float, float, float]

    def see(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return points (..., 3) in the image plane at distance 1, (..., 2), and their depths along the view (...)."""
        forward = np.subtract(self.target, self.eye)
        forward = forward / np.linalg.norm(forward)
        right = np.cross(forward, (0.0, 0.0, 1.0))
        right /= np.linalg.norm(right)
        seen = (points - np.asarray(self.eye)) @ np.stack([right, np.cross(right, forward), forward], axis=1)
        return seen[..., :2] / seen[..., 2:], seen[..., 2]


def paint(axes: Axes, camera: Camera, surfaces: list[Surface], floor: float, shade: str) -> None:
    """Draw `surfaces` and their shadow of colour `shade` on the plane z = floor [m], the farthest triangles first."""
    lamp = LAMP / np.linalg.norm(LAMP)
    shadows, corners, colours = [], [], []
    for surface in surfaces:
        drop = (surface.points[:, 2:] - floor) / lamp[2]
        shadows.append((surface.points - drop * lamp)[surface.triangles])
        corners.append(surface.points[surface.triangles])
        colours.append(_lit(surface, camera, lamp))
    flat = camera.see(np.concatenate(shadows))[0]
    axes.add_collection(PolyCollection(flat, facecolor=shade, edgecolor=shade, linewidth=0.3))
    seen, distance = camera.see(np.concatenate(corners))
    order = np.argsort(-distance.mean(axis=1))
    colour = np.concatenate(colours)[order]
    axes.add_collection(PolyCollection(seen[order], facecolor=colour, edgecolor=colour, linewidth=0.35))
    axes.set_aspect("equal")
    axes.axis("off")


def _lit(surface: Surface, camera: Camera, lamp: np.ndarray) -> np.ndarray:
    """Return colours (T, 3): ambient, Lambert's cosine and a highlight (Blinn 1977), with normals of neighbours
    averaged."""
    a, b, c = (surface.points[surface.triangles[:, k]] for k in range(3))
    normal = _unit(np.cross(b - a, c - a))
    at_points = np.zeros_like(surface.points)
    for k in range(3):
        np.add.at(at_points, surface.triangles[:, k], normal)
    smooth = _unit(_unit(at_points)[surface.triangles].sum(axis=1))
    view = _unit(np.asarray(camera.eye) - (a + b + c) / 3.0)
    towards = (smooth * view).sum(axis=1, keepdims=True) >= 0.0
    smooth = np.where(towards, smooth, -smooth)
    cosine = smooth @ lamp
    base = np.where(towards, to_rgb(surface.front), to_rgb(surface.back))
    diffuse = 0.56 + 0.12 * smooth[:, 2] + 0.62 * np.clip(cosine, 0.0, None) - 0.2 * np.clip(-cosine, 0.0, None)
    highlight = surface.gloss * np.clip((smooth * _unit(view + lamp)).sum(axis=1), 0.0, None) ** 24
    return np.clip(base * diffuse[:, None] + highlight[:, None], 0.0, 1.0)


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12)


def ball(centre: np.ndarray, radius: float, rings: int = 48) -> tuple[np.ndarray, np.ndarray]:
    """Return points and triangles of a sphere with its normals outward."""
    polar, around = np.meshgrid(np.linspace(0.0, np.pi, rings), np.linspace(0.0, 2.0 * np.pi, 2 * rings), indexing="ij")
    points = np.stack([np.sin(polar) * np.cos(around), np.sin(polar) * np.sin(around), np.cos(polar)], axis=-1)
    index = np.arange(polar.size).reshape(polar.shape)
    upper = np.stack([index[:-1, :-1], index[1:, :-1], index[1:, 1:]], axis=-1).reshape(-1, 3)
    lower = np.stack([index[:-1, :-1], index[1:, 1:], index[:-1, 1:]], axis=-1).reshape(-1, 3)
    return centre + radius * points.reshape(-1, 3), np.concatenate([upper, lower])
