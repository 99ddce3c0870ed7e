# SPDX-License-Identifier: Apache-2.0
"""The lines into which the springs of a grid and of a mesh are joined, as the solver builds them."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from scipy.spatial import Delaunay

from cloth_sim_ros.sim import Cloth
from cloth_sim_ros.sim.topology import Topology, build
from cloth_sim_ros.sim.topology.lines import Family

PALETTE = ("#e4572e", "#2e86ab", "#f2b134", "#3b8f5a", "#8e5aa8", "#5fbcd3", "#c2637a", "#7d8c4a", "#d9863d", "#4b5d8a")
INK, FAINT = "#2c3440", "#d8dade"


def draw_topology(device: str) -> Figure:
    """The families of lines of a 5 x 5 grid: each line is solved as a whole, all lines of a family at the same time."""
    cloth = Cloth(resolution=(5, 5), bending="springs", bend_compliance=1.0)
    topology = build(cloth, "grid", direct_ropes=True)
    figure = Figure(figsize=(10.5, 7.4), layout="constrained")
    for axes, (place, family) in zip(figure.subplots(2, 3).flat, enumerate(topology.families), strict=True):
        _draw_family(axes, topology, family, 0.16 if family.kind == "bending" else 0.0)
        lines, springs = len(family.particles), int((family.springs >= 0).sum())
        axes.set_title(f"{place + 1}: {springs} {family.kind} springs in {lines} lines", fontsize=11, color=INK)
    return figure


def draw_mesh_lines(device: str) -> Figure:
    """The lines of a triangle mesh: its longest family, then two more of those that are solved after it."""
    points, triangles = disk()
    mesh = Cloth.from_mesh(np.pad(points, ((0, 0), (0, 1))), triangles)
    topology = build(mesh, "disk", direct_ropes=True)
    found = topology.families
    figure = Figure(figsize=(12.5, 4.4), layout="constrained")
    for axes, place in zip(figure.subplots(1, 3), (0, 1, len(found) // 2), strict=True):
        _draw_family(axes, topology, found[place])
        lines = len(found[place].particles)
        axes.set_title(f"family {place + 1} of {len(found)}: {lines} lines at once", fontsize=11, color=INK)
    return figure


def springs_of(topology: Topology, family: Family) -> tuple[np.ndarray, np.ndarray]:
    """The springs (S, 2) of a family and the line (S,) that each is part of."""
    line, place = np.nonzero(family.springs >= 0)
    return topology.springs[family.kind].particles[family.springs[line, place]], line


def disk(rings: int = 7) -> tuple[np.ndarray, np.ndarray]:
    """Points (N, 2) [m] in rings around the origin and the triangles between them."""
    radius = [np.full(max(6 * ring, 1), ring / rings) for ring in range(rings + 1)]
    turn = [2.0 * np.pi * (np.arange(len(r)) / len(r) + 0.07 * k) for k, r in enumerate(radius)]
    radius, turn = np.concatenate(radius), np.concatenate(turn)
    points = radius[:, None] * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    triangles = Delaunay(points).simplices
    a, b, c = (points[triangles[:, k]] for k in range(3))
    area = 0.5 * np.abs((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])
    return points, triangles[area > 1e-6].astype(np.int32)


def _draw_family(axes: Axes, topology: Topology, family: Family, bow: float = 0.0) -> None:
    """All springs faintly, those of a family in the colour of their line, bent by `bow` of their length, every second
    one of neighbouring lines to the other side."""
    points = topology.layout[:, :2]
    every = np.concatenate([elements.particles for elements in topology.springs.values()])
    axes.add_collection(LineCollection(points[every], color=FAINT, lw=0.7))
    pairs, line = springs_of(topology, family)
    pairs = np.sort(pairs, axis=1)
    first, along = points[pairs[:, 0]], points[pairs[:, 1]] - points[pairs[:, 0]]
    across = np.stack([-along[:, 1], along[:, 0]], axis=1)
    side = np.where(2 * line >= len(family.particles), -bow, bow)[:, None, None]
    t = np.linspace(0.0, 1.0, 12 if bow else 2)[None, :, None]
    curves = first[:, None] + t * along[:, None] + 4.0 * side * t * (1.0 - t) * across[:, None]
    colours = [PALETTE[number % len(PALETTE)] for number in line]
    axes.add_collection(LineCollection(curves, color=colours, lw=2.4, capstyle="round"))
    axes.scatter(*points.T, s=30 if len(points) < 50 else 6, color=INK, zorder=3)
    _frame(axes)


def _frame(axes: Axes) -> None:
    axes.set_aspect("equal")
    axes.autoscale_view()
    axes.margins(0.06)
    axes.axis("off")
