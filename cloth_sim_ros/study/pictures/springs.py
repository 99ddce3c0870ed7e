"""The passes of a grid's springs and the colours of a mesh, as the solver builds them."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from scipy.spatial import Delaunay

from cloth_sim_ros.sim import Cloth, cells
from cloth_sim_ros.sim.topology import Elements, build

PALETTE = ("#e4572e", "#2e86ab", "#f2b134", "#3b8f5a", "#8e5aa8", "#5fbcd3", "#c2637a", "#7d8c4a", "#d9863d", "#4b5d8a")
INK, FAINT = "#2c3440", "#d8dade"


def draw_topology(device: str) -> Figure:
    """The six passes of the springs of a 5 x 5 grid: each cell by one thread, all cells of a pass at the same time."""
    topology = build(Cloth(resolution=(5, 5), bending="springs", bend_compliance=1.0), "grid", direct_ropes=True)
    points, passes = topology.rest[:, :2], cells.passes(topology)
    figure = Figure(figsize=(10.5, 7.4), layout="constrained")
    for axes, (place, one) in zip(figure.subplots(2, 3).flat, enumerate(passes), strict=True):
        pairs, cell = springs_of(one)
        bow = 0.16 if one.kind == "bending" else 0.0
        faint = np.concatenate([elements.particles for elements in topology.springs.values()])
        axes.add_collection(LineCollection(points[faint], color=FAINT, lw=0.7))
        _draw_springs(axes, points, Elements(pairs, np.zeros(len(pairs)), np.ones(len(pairs)), cell), bow)
        axes.scatter(*points.T, s=30, color=INK, zorder=3)
        axes.set_title(f"pass {place + 1}: {len(pairs)} springs in {cell.max() + 1} cells", fontsize=11, color=INK)
    return figure


def springs_of(one: cells.Pass) -> tuple[np.ndarray, np.ndarray]:
    """The springs (S, 2) of a pass and the cell (S,) of each."""
    held = np.r_[np.arange(4) if one.holds & cells.SIDES else [], [4, 5] if one.holds & cells.DIAGONALS else []]
    pairs, owner = [], []
    for place, particles in enumerate(one.particles):
        mine = cells.PAIRS[held.astype(int)] if place < one.whole else cells.PAIRS[:2]
        chosen = np.unique(np.sort(particles[mine], axis=1), axis=0)
        pairs.append(chosen)
        owner.append(np.full(len(chosen), place))
    return np.concatenate(pairs), np.concatenate(owner)


def draw_colouring(device: str) -> Figure:
    """A triangle mesh: all edges by colour, then single colours, in which no two edges share a particle."""
    points, triangles = disk()
    mesh = Cloth.from_mesh(np.pad(points, ((0, 0), (0, 1))), triangles)
    edges = build(mesh, "disk", direct_ropes=True).springs["structural"]
    count = int(edges.colour.max()) + 1
    figure = Figure(figsize=(12.5, 3.4), layout="constrained")
    panels = figure.subplots(1, 4)
    _draw_springs(panels[0], points, edges)
    panels[0].scatter(*points.T, s=5, color=INK, zorder=3)
    panels[0].set_title(f"{len(edges.rest)} edges in {count} colours", fontsize=11, color=INK)
    for axes, colour in zip(panels[1:], (0, 1, count - 1), strict=True):
        chosen = edges.colour == colour
        axes.add_collection(LineCollection(points[edges.particles], color=FAINT, lw=0.7))
        axes.add_collection(LineCollection(points[edges.particles[chosen]], color=PALETTE[colour], lw=2.5))
        axes.scatter(*points[edges.particles[chosen].ravel()].T, s=7, color=INK, zorder=3)
        axes.set_title(f"colour {colour + 1}: {chosen.sum()} at once", fontsize=11, color=INK)
        _frame(axes)
    return figure


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


def _draw_springs(axes: Axes, points: np.ndarray, elements: Elements, bow: float = 0.0) -> None:
    """Every spring in its colour, bent by `bow` of its length to a side that alternates with the colour."""
    first, second = points[elements.particles[:, 0]], points[elements.particles[:, 1]]
    along = second - first
    across = np.stack([-along[:, 1], along[:, 0]], axis=1)
    side = np.where(elements.colour % 2, -bow, bow)[:, None, None]
    t = np.linspace(0.0, 1.0, 12 if bow else 2)[None, :, None]
    lines = first[:, None] + t * along[:, None] + 4.0 * side * t * (1.0 - t) * across[:, None]
    colours = [PALETTE[c % len(PALETTE)] for c in elements.colour]
    axes.add_collection(LineCollection(lines, color=colours, lw=2.0, capstyle="round"))
    _frame(axes)


def _frame(axes: Axes) -> None:
    axes.set_aspect("equal")
    axes.autoscale_view()
    axes.margins(0.06)
    axes.axis("off")
