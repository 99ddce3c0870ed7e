"""Scene object -> particles and elements in NumPy: grids, meshes, chains, lumped masses, hinges, colours.

Rest shapes are float64. A material compliance times an element's `scale` is the element's own compliance, so that a
live change of the material never touches these arrays. Nothing here knows of a device.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from cloth_sim_ros.sim.objects import Cloth, Rope
from cloth_sim_ros.sim.quaternion import rotate

KINDS = ("structural", "shear", "bending")


@dataclass(frozen=True)
class Elements:
    """Constraints of one kind: particles (E, k), rest (E,), scale (E,) of the compliance and colour (E,)."""

    particles: np.ndarray
    rest: np.ndarray
    scale: np.ndarray
    colour: np.ndarray


@dataclass(frozen=True)
class Topology:
    """One object: rest positions (N, 3) [m] in the world, masses (N,) [kg], pinned (N,), elements, triangles, segments.

    springs: kind -> Elements of pairs, rest [m]; hinges: (H, 4) edge i, j and opposite k, l, rest [rad];
    bends: (B, 3) of a rope, rest is the turn [-], `weights` (B, 2) the inverse lengths [1/m] of its two segments.
    panels: (P, 3) particles that the wind acts on, -1 as the third of a rope's segment. layout: (N, 3) rest positions
    [m] in local axes, along which grids are cut into tiles. grid: particles along x and y, None for what is no grid.
    reel: of a rope on a winch, the last particle at the drum and the rest length [m] of the segment that begins there.
    twists: whether a rope resists twist.
    """

    rest: np.ndarray
    masses: np.ndarray
    pinned: np.ndarray
    springs: dict[str, Elements]
    triangles: np.ndarray
    panels: np.ndarray
    layout: np.ndarray
    reel: tuple[int, float] | None = None
    twists: bool = False
    hinges: Elements | None = None
    bends: Elements | None = None
    bend_weights: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))
    chain: Elements | None = None
    edge_contact: bool = False
    grid: tuple[int, int] | None = None

    def edges(self) -> list[Elements]:
        """What touches colliders between its particles: structural and shear springs, segments; none if not asked."""
        kinds = [self.springs.get("structural"), self.springs.get("shear"), self.chain] if self.edge_contact else []
        return [elements for elements in kinds if elements is not None]

    def others(self) -> list[tuple[str, Elements, np.ndarray]]:
        """(constraint, elements, (E, 2) further numbers) of every constraint that is projected and not a spring."""
        found = []
        if self.hinges is not None:
            found.append(("hinge", self.hinges, np.zeros((len(self.hinges.rest), 2))))
        if self.bends is not None and self.chain is None:
            found.append(("bend", self.bends, self.bend_weights))
        return found


def build(thing: Cloth | Rope, name: str, direct_ropes: bool) -> Topology:
    """The topology of a cloth or rope called `name`. Raises ValueError for a mesh that is not manifold."""
    if isinstance(thing, Rope):
        return _rope(thing, direct_ropes)
    return _grid(thing, name) if thing.vertices is None else _mesh(thing, name)


def colour(particles: np.ndarray, count: int) -> np.ndarray:
    """Colours (E,) so that no two elements of one colour share one of `count` particles.

    Greedy by maximal independent sets: within a colour, the element of the highest random priority among its neighbours
    enters (Luby 1986), until none is left that could. The priorities are seeded: same input, same colours.
    """
    total = len(particles)
    priority = np.random.default_rng(1).permutation(total) + 1
    result = np.full(total, -1)
    current = 0
    while (result < 0).any():
        candidates = np.flatnonzero(result < 0)
        while len(candidates):
            best = np.zeros(count, dtype=np.int64)
            mine = priority[candidates]
            np.maximum.at(best, particles[candidates].ravel(), np.repeat(mine, particles.shape[1]))
            winners = candidates[(best[particles[candidates]] == mine[:, None]).all(axis=1)]
            result[winners] = current
            used = np.zeros(count, dtype=bool)
            used[particles[winners].ravel()] = True
            candidates = candidates[(result[candidates] < 0) & ~used[particles[candidates]].any(axis=1)]
        current += 1
    return result


def _pinned(pins: Any, named: dict[str, np.ndarray], count: int) -> np.ndarray:
    """Which of `count` particles are fixed (N,), by a name of `named` or by indices, as the scene has checked them."""
    fixed = np.zeros(count, dtype=bool)
    if pins is not None and pins != "none":
        fixed[named[pins] if isinstance(pins, str) else list(pins)] = True
    return fixed


def _grid(cloth: Cloth, name: str) -> Topology:
    nx, ny = cloth.resolution
    width, height = cloth.size
    ix, iy = (a.ravel() for a in np.meshgrid(np.arange(nx), np.arange(ny)))
    local = np.stack(
        [ix * width / (nx - 1) - width / 2, iy * height / (ny - 1) - height / 2, np.zeros(nx * ny)], axis=1
    )
    border_x = np.where((ix == 0) | (ix == nx - 1), 0.5, 1.0)
    border_y = np.where((iy == 0) | (iy == ny - 1), 0.5, 1.0)
    masses = cloth.mass * border_x * border_y / ((nx - 1) * (ny - 1))
    index = np.arange(nx * ny).reshape(ny, nx)
    top = index[-1]
    named = {
        "corners": top[[0, -1]],
        "top": top,
        "edges": np.unique(np.concatenate([index[0], top, index[:, 0], index[:, -1]])),
    }
    triangles = np.concatenate(
        [
            np.stack([index[:-1, :-1], index[:-1, 1:], index[1:, 1:]], axis=-1).reshape(-1, 3),
            np.stack([index[:-1, :-1], index[1:, 1:], index[1:, :-1]], axis=-1).reshape(-1, 3),
        ]
    ).astype(np.int32)
    return _sheet(cloth, name, local, masses, named, triangles, _grid_springs(cloth, index, local), (nx, ny))


def _grid_springs(cloth: Cloth, index: np.ndarray, local: np.ndarray) -> dict[str, Elements]:
    ny, nx = index.shape
    ix, iy = np.arange(nx)[None, :], np.arange(ny)[:, None]
    on_x = np.broadcast_to(np.where((iy == 0) | (iy == ny - 1), 2.0, 1.0), (ny, nx))  # springs along x lie on a border
    on_y = np.broadcast_to(np.where((ix == 0) | (ix == nx - 1), 2.0, 1.0), (ny, nx))
    ix, iy = np.broadcast_arrays(ix, iy)

    def lines(step: int, kind_colour: int) -> list[tuple]:
        """Springs over `step` cells along x and y; every second one of a line shares a colour."""
        return [
            (index[:, :-step], index[:, step:], on_x[:, :-step], (ix[:, :-step] // step) % 2 + kind_colour),
            (index[:-step], index[step:], on_y[:-step], (iy[:-step] // step) % 2 + kind_colour + 2),
        ]

    one = np.ones((ny - 1, nx - 1))
    groups = {"structural": lines(1, 0)}
    if cloth.shear_compliance is not None:
        groups["shear"] = [
            (index[:-1, :-1], index[1:, 1:], one, ix[:-1, :-1] % 2),
            (index[:-1, 1:], index[1:, :-1], one, ix[:-1, 1:] % 2 + 2),
        ]
    if cloth.bend_compliance is not None and cloth.bending == "springs" and max(nx, ny) > 2:
        groups["bending"] = lines(2, 0)
    return {kind: _springs(parts, local) for kind, parts in groups.items()}


def _springs(parts: list[tuple], local: np.ndarray) -> Elements:
    first, second, scale, colours = (np.concatenate([part[k].ravel() for part in parts]) for k in range(4))
    pairs = np.stack([first, second], axis=1)
    return Elements(pairs, np.linalg.norm(local[second] - local[first], axis=1), scale, colours)


def _mesh(cloth: Cloth, name: str) -> Topology:
    points, triangles = cloth.vertices, cloth.triangles
    areas = _areas(points, triangles)
    lumped = np.bincount(triangles.ravel(), np.repeat(areas, 3), minlength=len(points))
    if lumped.min() <= 0.0:
        raise ValueError(
            f"{name} has vertex {int(lumped.argmin())} in no triangle with an area; allowed are meshes without such"
        )
    masses = cloth.mass * lumped / lumped.sum()
    edges, opposite, area = _edges(triangles, areas, name)
    length = np.linalg.norm(points[edges[:, 1]] - points[edges[:, 0]], axis=1)
    springs = {"structural": Elements(edges, length, length**2 / area, colour(edges, len(points)))}
    inner = opposite[:, 1] >= 0
    if cloth.bend_compliance is not None and cloth.bending == "springs" and inner.any():
        pairs = opposite[inner]
        rest = np.linalg.norm(points[pairs[:, 1]] - points[pairs[:, 0]], axis=1)
        springs["bending"] = Elements(pairs, rest, np.ones(len(pairs)), colour(pairs, len(points)))
    return _sheet(cloth, name, points, masses, {}, triangles, springs)


def _sheet(cloth, name, local, masses, named, triangles, springs, grid=None) -> Topology:
    """What grids and meshes share: pins, place in the world and hinges."""
    hinges = None
    if cloth.bend_compliance is not None and cloth.bending == "dihedral":
        hinges = _hinges(local, triangles, name)
    return Topology(
        rest=rotate(cloth.orientation, local) + np.asarray(cloth.position),
        masses=masses if cloth.particle_masses is None else cloth.particle_masses,
        pinned=_pinned(cloth.pins, named, len(local)),
        springs=springs,
        triangles=triangles,
        panels=triangles,
        layout=local,
        hinges=hinges,
        edge_contact=cloth.edge_contact,
        grid=grid,
    )


def _areas(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    a, b, c = (points[triangles[:, k]] for k in range(3))
    return 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)


def _edges(triangles: np.ndarray, areas: np.ndarray, name: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Unique edges (E, 2), the vertices opposite (E, 2) with -1 beyond a border, and the area of both triangles
    (E,)."""
    half = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    third = np.concatenate([triangles[:, 2], triangles[:, 0], triangles[:, 1]])
    area = np.tile(areas, 3)
    edges, inverse, count = np.unique(np.sort(half, axis=1), axis=0, return_inverse=True, return_counts=True)
    inverse = inverse.ravel()
    if count.max() > 2:
        a, b = edges[count.argmax()]
        raise ValueError(
            f"{name} has {count.max()} triangles at edge {a}-{b}; allowed are meshes with at most 2 an edge"
        )
    order = np.argsort(inverse, kind="stable")
    start = np.concatenate([[0], np.cumsum(count)[:-1]])
    opposite = np.full((len(edges), 2), -1)
    opposite[:, 0] = third[order[start]]
    two = count == 2
    opposite[two, 1] = third[order[start[two] + 1]]
    return edges, opposite, np.bincount(inverse, area, minlength=len(edges))


def _hinges(points: np.ndarray, triangles: np.ndarray, name: str) -> Elements | None:
    edges, opposite, area = _edges(triangles, _areas(points, triangles), name)
    inner = opposite[:, 1] >= 0
    if not inner.any():
        return None
    particles = np.concatenate([edges[inner], opposite[inner]], axis=1)
    i, j, k, m = (points[particles[:, c]] for c in range(4))
    first, second = np.cross(j - i, k - i), np.cross(m - i, j - i)
    edge = (j - i) / np.linalg.norm(j - i, axis=1, keepdims=True)
    angle = np.arctan2((np.cross(first, second) * edge).sum(1), (first * second).sum(1))
    scale = area[inner] / ((j - i) ** 2).sum(1)
    return Elements(particles, angle, scale, colour(particles, len(points)))


def _rope(rope: Rope, direct: bool) -> Topology:
    points = rope.points
    count = len(points)
    length = np.linalg.norm(np.diff(points, axis=0), axis=1)
    halves = 0.5 * (np.append(length, 0.0) + np.insert(length, 0, 0.0))
    masses = rope.mass * halves / halves.sum() if rope.particle_masses is None else rope.particle_masses
    masses = masses + np.where(np.arange(count) == count - 1, rope.end_mass, 0.0)
    named = {"start": np.array([0]), "end": np.array([count - 1]), "both": np.array([0, count - 1])}
    reel = _reel(rope, length)
    if reel is not None:
        points = _paid_out(points, length, reel)
    index = np.arange(count)
    pairs = np.stack([index[:-1], index[1:]], axis=1)
    stretch = Elements(pairs, length, length, index[:-1] % 2)
    pinned = _pinned(rope.pins, named, count)
    bends, weights = _bends(rope, points, length, pinned)
    return Topology(
        rest=rotate(rope.orientation, points) + np.asarray(rope.position),
        masses=masses,
        pinned=pinned,
        springs={} if direct else {"structural": stretch},
        triangles=np.zeros((0, 3), dtype=np.int32),
        panels=np.concatenate([pairs, np.full((count - 1, 1), -1)], axis=1),
        layout=points,
        reel=reel,
        twists=rope.twist_compliance is not None,
        bends=bends,
        bend_weights=weights,
        chain=stretch if direct else None,
        edge_contact=rope.edge_contact,
    )


def _reel(rope: Rope, length: np.ndarray) -> tuple[int, float] | None:
    """The particle at the drum of a rope of segments `length` (S,) [m] and how much of its segment is out [m]."""
    if rope.winch is None:
        return None
    ends = np.cumsum(length)
    hidden = max(float(ends[-1]) - rope.winch.length, 0.0)
    index = min(int(np.searchsorted(ends, hidden, side="right")), len(length) - 1)
    out = float(ends[index]) - hidden
    if out < 0.5 * length[index] and index + 1 < len(length):  # part of the next, as after being hauled in
        index, out = index + 1, out + float(length[index + 1])
    return index, max(out, 0.5 * float(length[index]))


def _paid_out(points: np.ndarray, length: np.ndarray, reel: tuple[int, float]) -> np.ndarray:
    """Where particles lie when what is out begins at the start of the path through `points` (N, 3)."""
    index, out = reel
    along = np.concatenate([[0.0], np.cumsum(length)])
    place = np.maximum(along - along[index + 1] + out, 0.0)
    place[: index + 1] = 0.0
    return np.stack([np.interp(place, along, points[:, axis]) for axis in range(3)], axis=1)


def _bends(
    rope: Rope, points: np.ndarray, length: np.ndarray, pinned: np.ndarray
) -> tuple[Elements | None, np.ndarray]:
    """Joints between segments. Half of each segment bends at a joint; a segment held at both ends does not bend, so a
    clamp of two pinned particles is twice as stiff as a joint (Hencky 1920)."""
    if rope.bend_compliance is None or len(points) < 3:
        return None, np.zeros((0, 2))
    index = np.arange(1, len(points) - 1)
    tangents = np.diff(points, axis=0) / length[:, None]
    turn = np.linalg.norm(np.diff(tangents, axis=0), axis=1)
    bending = np.where(pinned[:-1] & pinned[1:], 0.0, length)
    span = 0.5 * np.where(bending[:-1] + bending[1:] > 0.0, bending[:-1] + bending[1:], length[:-1] + length[1:])
    particles = np.stack([index - 1, index, index + 1], axis=1)
    return Elements(particles, turn, span, (index - 1) % 3), np.stack([1.0 / length[:-1], 1.0 / length[1:]], axis=1)
