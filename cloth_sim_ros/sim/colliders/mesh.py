# SPDX-License-Identifier: Apache-2.0
"""A closed surface of triangles; the first number of its size is its reach."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np
import warp as wp

from cloth_sim_ros import parameters as table
from cloth_sim_ros.sim.colliders import mesh_distance
from cloth_sim_ros.sim.colliders.collider import Collider, Solid
from cloth_sim_ros.sim.colliders.mesh_distance import TREE, WORDS, by_tree
from cloth_sim_ros.sim.colliders.mesh_grid import Grid, grid_of
from cloth_sim_ros.sim.colliders.on_device import OnDevice, content_of, shared
from cloth_sim_ros.sim.input.checks import finite_array
from cloth_sim_ros.sim.input.mesh_repair import areas_of
from cloth_sim_ros.sim.kernels.compiled import compiled
from cloth_sim_ros.sim.kernels.intrinsics import load_address
from cloth_sim_ros.sim.mesh_file import load_mesh


class _OnDevice(OnDevice):
    """OnDevice with the grid that the CPU made."""

    grid: Grid
    width: float


_closed: set[str] = set()  # hashes of surfaces known to be closed
_FLAT = 1.0e-5  # fraction of the size; a surface that bulges inwards by less counts as convex
_ROWS = 7  # rows per triangle in the table of normals: the triangle, its three corners, the edges opposite them


@dataclass(frozen=True)
class Mesh(Collider):
    """The inside of a closed surface of `triangles` (T, 3) over `vertices` (N, 3), in units of `scale` [m].

    Two triangles meet at every edge, and all are counterclockwise seen from outside. The surface may have several parts
    and holes, but parts that cross have walls inside. `file` is the mesh file for viewers.
    """

    vertices: Any = field(default=(), repr=False, compare=False)
    triangles: Any = field(default=(), repr=False, compare=False)
    scale: float = 1.0
    file: str = ""
    content: str = field(init=False, default="", repr=False)
    distance = mesh_distance.signed_distance
    cost = 15
    edged = True
    at_least = mesh_distance.at_least
    width = mesh_distance.width

    def __post_init__(self) -> None:
        super().__post_init__()
        points = finite_array(self.vertices, "Mesh.vertices")
        faces = finite_array(self.triangles, "Mesh.triangles").astype(np.int32)
        content = content_of(points, faces)
        if content not in _closed:  # checked once per surface, as a large one takes a tenth of a second
            if faces.min() < 0 or faces.max() >= len(points):
                raise ValueError(f"Mesh.triangles name vertex {faces.max()}; allowed are 0 to {len(points) - 1}")
            wrong = what_is_open(points, faces)
            if wrong:
                raise ValueError(f"{f'Mesh of {table.shown(self.file)}' if self.file else 'Mesh'} {wrong}")
            _closed.add(content)
        for array in (points, faces):
            array.setflags(write=False)
        object.__setattr__(self, "vertices", points)
        object.__setattr__(self, "triangles", faces)
        object.__setattr__(self, "content", content)

    @classmethod
    def from_file(cls, file: str, scale: float = 1.0, **fields: Any) -> Mesh:
        """The surface in a file that trimesh reads: a plain path, `file:///PATH` or `package://NAME/PATH`.

        scale: length of a unit in the file [m]. Raises ValueError if the file cannot be read or the surface is open.
        """
        vertices, triangles = load_mesh(str(file), "Mesh.from_file", scale)
        return cls(vertices=vertices, triangles=triangles, scale=scale, file=str(file), **fields)

    def points(self) -> np.ndarray:
        """Vertices (N, 3) [m] in local axes."""
        return self.vertices * self.scale

    def solids(self) -> list[Solid]:
        """Its triangles."""
        return [Solid.triangles(self.points(), self.triangles, self.file, self.scale)]

    def size(self) -> tuple[float, float, float]:
        """(reach, 0, 0) [m]."""
        return (self.reach(), 0.0, 0.0)

    def reach(self) -> float:
        """Distance to the farthest vertex [m]."""
        return float(np.linalg.norm(self.points(), axis=1).max())

    def enters(self, needed: float, thickness: float) -> bool:
        """As for a sphere, if balls of its radius fill the mesh up to a quarter of the thickness."""
        return _enters(self, needed, thickness)

    def data(self, device: wp.Device) -> _OnDevice:
        """The triangles in a tree, their normals, and the grid around them, which the CPU makes for all devices."""

        def make() -> _OnDevice:
            rows = wp.array(rows_of(self.points(), self.triangles), dtype=wp.vec4, device=device)
            points = wp.array(self.points(), dtype=wp.vec3, device=device)
            indices = wp.array(self.triangles.ravel(), dtype=int, device=device)
            # The same tree on every device, and a better one than a GPU builds.
            tree = wp.Mesh(points, indices, bvh_constructor="sah")
            words = np.zeros(WORDS + 4, np.uint64)
            words[:2] = tree.id, rows.ptr
            host = None if device.is_cpu else self.data(wp.get_device("cpu"))
            grid = host.grid if host else grid_of(words.ctypes.data, self.points(), self.triangles, self.reach())
            cells = wp.array(grid.cells, dtype=wp.vec2, device=device)
            around = wp.array(grid.around, dtype=float, device=device)
            names = wp.array(grid.names, dtype=int, device=device)
            words[2:5] = cells.ptr, around.ptr, names.ptr
            width = host.width if host else width_of(self.points(), self.triangles)
            words[5:6].view(np.float32)[0] = width
            numbers = words.view(np.float32).reshape(-1, 4)
            numbers[-2:] = [*grid.origin, grid.spacing], [*grid.shape, 1.0 / grid.spacing]
            made = _OnDevice(wp.array(numbers, dtype=wp.vec4, device=device), tree, rows, cells, around, names, host)
            made.grid, made.width = grid, width
            return made

        return shared(f"mesh {self.content} {self.scale}", device, make)


@lru_cache(64)
def _enters(mesh: Mesh, needed: float, thickness: float) -> bool:
    """See Mesh.enters. The surface is within a quarter of the thickness of the balls, which are larger by that."""
    within = 0.25 * thickness
    radius = needed + within
    if radius <= 2.0 * within:
        return False
    points, at = mesh.points(), mesh.data(wp.get_device("cpu"))
    _, first = np.unique(mesh.triangles, return_index=True)
    normals = normals_of(points, mesh.triangles)[:, 1:4, :3].reshape(-1, 3)[first]
    corners = points[mesh.triangles].reshape(-1, 3)[first]
    return not _is_round(at.id, mesh.reach(), corners, normals, radius, within)


@compiled
def _find_sharp(
    data: wp.uint64,
    size: wp.vec3,
    radius: float,
    within: float,
    points: wp.array(dtype=wp.vec3),
    normals: wp.array(dtype=wp.vec3),
    sharp: wp.array(dtype=int),
):
    p, n = points[wp.tid()], normals[wp.tid()]
    # From the first place on the surface is within what must be free of it.
    if by_tree(p - 2.0 * within * n, size, data)[3] >= 0.0:
        sharp[0] = 1
    elif wp.mesh_query_point_no_sign(load_address(data + TREE), p - radius * n, radius - within).result:
        sharp[0] = 1


def _is_round(data: int, reach: float, points: np.ndarray, normals: np.ndarray, radius: float, within: float) -> bool:
    """True if a ball of this radius touches each vertex (N, 3) from inside, and protrudes by `within` [m] at most.

    data: the address of the surface on the CPU, where its tree is.
    """
    device = wp.get_device("cpu")
    sharp = wp.zeros(1, dtype=int, device=device)
    at, out = (wp.array(rows, dtype=wp.vec3, device=device) for rows in (points, normals))
    inputs = [data, wp.vec3(reach, 0.0, 0.0), radius, within, at, out, sharp]
    wp.launch(_find_sharp, dim=len(points), inputs=inputs, device=device)
    return sharp.numpy()[0] == 0


def rows_of(points: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Rows (10 T, 4) of all triangles, ten per triangle, see ROWS."""
    a, b, c = (points[faces[:, k]] for k in range(3))
    rows = np.zeros((len(faces), 10, 4), np.float32)
    rows[:, 0, :3], rows[:, 1, :3], rows[:, 2, :3] = a, b - a, c - a
    ab, ac = rows[:, 1, :3].astype(float), rows[:, 2, :3].astype(float)
    rows[:, 0, 3], rows[:, 1, 3], rows[:, 2, 3] = (ab * ab).sum(1), (ab * ac).sum(1), (ac * ac).sum(1)
    rows[:, 3:] = normals_of(points, faces)
    return rows.reshape(-1, 4)


def _ways(faces: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Directed edges (3 T, 2): first, second, third of all triangles; and keys of each in both directions."""
    ways = np.concatenate([faces[:, [k, (k + 1) % 3]] for k in range(3)]).astype(np.int64)
    return ways, ways[:, 0] * count + ways[:, 1], ways[:, 1] * count + ways[:, 0]


def what_is_open(points: np.ndarray, faces: np.ndarray) -> str:
    """Describe why a surface has no inside, as text that follows its name; "" if it has one."""
    ways, there, back = _ways(faces, len(points))
    known, place, count = np.unique(there, return_inverse=True, return_counts=True)
    bad = np.flatnonzero((count[place] > 1) | ~np.isin(back, known))
    if len(bad):
        a, b = ways[bad[0]].tolist()
        edges = len(np.unique(np.sort(ways[bad], axis=1), axis=0))
        return (
            f"is open at {edges} edges, such as {a}-{b}; allowed is a closed surface: two triangles at every edge, "
            "which turn alike"
        )
    corners = points[faces] - points.mean(axis=0)
    if np.linalg.det(corners).sum() <= 0.0:
        return "turns its inside out; allowed are triangles that turn counterclockwise as seen from outside"
    return ""


def is_convex(points: np.ndarray, faces: np.ndarray) -> bool:
    """True if a closed surface is one piece without holes and bulges outwards at every edge."""
    if len(np.unique(faces)) - len(faces) // 2 != 2:  # Euler's formula
        return False
    _, there, back = _ways(faces, len(points))
    order = np.argsort(there)
    beside = order[np.searchsorted(there[order], back)] % len(faces)  # the triangle across from each edge
    corners, of = points[faces], np.tile(np.arange(len(faces)), 3)
    above = np.einsum("eki,ei->ek", corners[beside] - corners[of][:, :1], _flat_normals(corners)[of])
    return bool(above.max() <= _FLAT * np.abs(points).max())


def width_of(points: np.ndarray, faces: np.ndarray) -> float:
    """Twice the volume over the surface of a closed surface [m]; 0 if it is convex."""
    if is_convex(points, faces):
        return 0.0
    around = points - points.mean(axis=0)
    return float(2.0 * (np.linalg.det(around[faces]).sum() / 6.0) / areas_of(around, faces).sum())


def _flat_normals(corners: np.ndarray) -> np.ndarray:
    """Unit normals of triangles (T, 3, 3); 0 for triangles without an area."""
    flat = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return flat / np.maximum(np.linalg.norm(flat, axis=1, keepdims=True), 1e-300)


def normals_of(points: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Normals (T, 7, 4): a triangle's unit normal and height, then normals of its corners and of the opposite edges.

    Angle-weighted normals distinguish inside from outside wherever the nearest point lies (Baerentzen and Aanaes 2005,
    Signed distance computation using the angle weighted pseudonormal).
    """
    corners = points[faces]
    flat = _flat_normals(corners)
    of_points, of_edges = np.zeros_like(points), {}
    for k in range(3):
        a, b = corners[:, (k + 1) % 3] - corners[:, k], corners[:, (k + 2) % 3] - corners[:, k]
        angle = np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), (a * b).sum(axis=1))
        np.add.at(of_points, faces[:, k], angle[:, None] * flat)
    found = np.zeros((len(faces), _ROWS, 4))
    found[:, 0, :3], found[:, 0, 3] = flat, (flat * corners[:, 0]).sum(axis=1)
    found[:, 1:4, :3] = of_points[faces]
    across = np.stack([np.sort(faces[:, [(k + 1) % 3, (k + 2) % 3]], axis=1) for k in range(3)], axis=1)
    _, of_edges = np.unique(across.reshape(-1, 2), axis=0, return_inverse=True)
    sums = np.zeros((of_edges.max() + 1, 3))
    np.add.at(sums, of_edges.ravel(), np.repeat(flat, 3, axis=0))
    found[:, 4:, :3] = sums[of_edges].reshape(-1, 3, 3)
    found[:, 1:, :3] /= np.maximum(np.linalg.norm(found[:, 1:, :3], axis=2, keepdims=True), 1e-300)
    return found
