# SPDX-License-Identifier: Apache-2.0
"""The curtain of the tour: a gathered cloth on a rail, a ball pushed through it, and a breeze."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from cloth_sim_ros.drawing.camera import Camera, Surface, ball, paint
from cloth_sim_ros.sim import Cloth, Scene, Settings, Simulation, Sphere, Wind

SIZE = (1.9, 1.5)  # [m] of the cloth, gathered to WIDTH on the rail
WIDTH = 1.35
FOLDS = 5
RADIUS = 0.22  # [m] of the ball
HEIGHT = 0.62
SETTLE = 1.5  # [s] before the ball comes
SHOTS = (0.0, 0.65, 1.15, 1.75)  # [s] after that
PATH = ((0.0, 0.5, 1.2, 2.2), (-0.62, -0.2, 0.42, 1.3))  # times [s] and places [m] of the ball along y


def scene(resolution: int) -> Scene:
    """The cloth hangs in the x-z plane by its whole upper edge."""
    turn = (np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5))
    cloth = Cloth(
        resolution=(resolution, resolution),
        size=SIZE,
        mass=0.35,
        position=(0.0, 0.0, 0.95),
        orientation=turn,
        pins="top",
        bending="springs",
        bend_compliance=0.2,
        damping=0.005,
        thickness=0.015,
    )
    colliders = {"ball": Sphere(position=(0.08, PATH[1][0], HEIGHT), radius=RADIUS)}
    return Scene(objects={"cloth": cloth}, colliders=colliders, wind=Wind())


def gathered(rest: np.ndarray) -> np.ndarray:
    """The flat cloth (N, 3) pushed together along x into sine folds as long as before, to leading order."""
    share = WIDTH / SIZE[0]
    wave = 2.0 * np.pi * FOLDS / WIDTH
    depth = 2.0 / wave * np.sqrt(1.0 / share - 1.0)  # length of a sine of small slope: 1 + (wave depth)^2 / 4
    points = rest.copy()
    points[:, 0] *= share
    points[:, 1] += depth * np.sin(wave * points[:, 0] + 0.6)
    return points


def shots(resolution: int, device: str) -> tuple[list[np.ndarray], list[np.ndarray], np.ndarray]:
    """Positions (N, 3) [m] of the cloth and of the ball (3,) at SHOTS, and the triangles."""
    sim = Simulation(
        scene(resolution),
        Settings(method="xpbd", order=1, substeps=20, iterations=2, global_damping=0.3),
        device=device,
    )
    sim.set_positions("cloth", gathered(sim.rest_positions("cloth").astype(np.float64)))
    cloths, balls = [], []
    frame_dt = sim.settings.frame_dt
    for frame in range(round((SETTLE + SHOTS[-1]) / frame_dt) + 1):
        time = frame * frame_dt - SETTLE
        place = np.array([0.08, np.interp(time, *PATH), HEIGHT])
        if any(abs(time - shot) < 0.5 * frame_dt for shot in SHOTS):
            cloths.append(sim.positions("cloth").astype(np.float64))
            balls.append(place)
        gust = 0.7 + 0.5 * np.sin(2.0 * np.pi * 0.8 * time)
        sim.set_wind((0.25, 0.55 * gust, 0.0))
        sim.set_collider_pose("ball", (place[0], np.interp(time + frame_dt, *PATH), place[2]))
        sim.step()
    return cloths, balls, sim.triangles("cloth")


def draw(device: str, resolution: int = 72) -> Figure:
    """The frames side by side."""
    cloths, balls, triangles = shots(resolution, device)
    figure = Figure(figsize=(13.0, 3.9), facecolor="white")
    for k, (points, centre) in enumerate(zip(cloths, balls, strict=True)):
        axes = figure.add_axes((k / len(cloths), 0.0, 1.0 / len(cloths), 1.0))
        surfaces = [
            Surface(points, triangles, "#f2785c", "#f7a48c"),
            Surface(*ball(centre, RADIUS), "#3d6b8c", "#3d6b8c", gloss=0.3),
            Surface(*_rail(), "#5a6068", "#5a6068"),
        ]
        paint(axes, Camera((-2.9, -3.0, 1.9), (0.0, 0.12, 0.83)), surfaces, 0.0, "#e9e6e1")
        axes.set(xlim=(-0.18, 0.2), ylim=(-0.23, 0.225))
    return figure


def _rail() -> tuple[np.ndarray, np.ndarray]:
    """A thin bar over the curtain."""
    x = np.linspace(-0.5, 0.5, 40) * (WIDTH + 0.12)
    turn = np.linspace(0.0, 2.0 * np.pi, 13)
    x, turn = np.meshgrid(x, turn, indexing="ij")
    points = np.stack([x, 0.016 * np.cos(turn), 0.016 * np.sin(turn) + SIZE[1] / 2 + 0.965], axis=-1)
    index = np.arange(x.size).reshape(x.shape)
    upper = np.stack([index[:-1, :-1], index[1:, 1:], index[1:, :-1]], axis=-1).reshape(-1, 3)
    lower = np.stack([index[:-1, :-1], index[:-1, 1:], index[1:, 1:]], axis=-1).reshape(-1, 3)
    return points.reshape(-1, 3), np.concatenate([upper, lower])
