# SPDX-License-Identifier: Apache-2.0
"""A closed surface of triangles; the first number of its size is its reach."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
import warp as wp

from cloth_sim_ros import parameters as table
from cloth_sim_ros.sim.checks import finite_array
from cloth_sim_ros.sim.colliders.collider import Collider
from cloth_sim_ros.sim.colliders.on_device import OnDevice, content_of, shared
from cloth_sim_ros.sim.intrinsics import load4, load_address, xyz
from cloth_sim_ros.sim.mesh_file import load_mesh

_closed: set[str] = set()  # hashes of surfaces that are
_ROWS = 7  # of a triangle in the table of normals: of itself, of its three corners, of the edges across from them


@dataclass(frozen=True)
class Mesh(Collider):
    """What is inside of `triangles` (T, 3) over `vertices` (N, 3), which `scale` turns into lengths [m].

    The surface is closed: two triangles meet at every edge, and all turn counterclockwise as seen from outside. It may
    have several parts and holes, but parts that cross have walls inside. `file` is where viewers find it.
    """

    vertices: Any = field(default=(), repr=False, compare=False)
    triangles: Any = field(default=(), repr=False, compare=False)
    scale: float = 1.0
    file: str = ""
    content: str = field(init=False, default="", repr=False)
    convex: ClassVar[bool] = False

    def __post_init__(self) -> None:
        super().__post_init__()
        points = finite_array(self.vertices, 3, "Mesh.vertices")
        faces = finite_array(self.triangles, 3, "Mesh.triangles").astype(np.int32)
        content = content_of(points, faces)
        if content not in _closed:  # once for all that are made of it: a large one takes a tenth of a second
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

        scale: [m] of a unit in the file. Raises ValueError for a file that is none, or whose surface is not closed.
        """
        vertices, triangles = load_mesh(str(file), "Mesh.from_file")
        return cls(vertices=vertices, triangles=triangles, scale=scale, file=str(file), **fields)

    def points(self) -> np.ndarray:
        """Where the vertices are, in local axes, (N, 3) [m]."""
        return self.vertices * self.scale

    def size(self) -> tuple[float, float, float]:
        """(reach, 0, 0) [m]."""
        return (self.reach(), 0.0, 0.0)

    def reach(self) -> float:
        """To the farthest vertex [m]."""
        return float(np.linalg.norm(self.points(), axis=1).max())

    def data(self, device: wp.Device) -> OnDevice:
        """The triangles in a tree, and their normals."""

        def make() -> OnDevice:
            points = wp.array(self.points(), dtype=wp.vec3, device=device)
            indices = wp.array(self.triangles.ravel(), dtype=int, device=device)
            # The same tree on every device, and a better one than a GPU builds.
            tree = wp.Mesh(points, indices, bvh_constructor="sah")
            rows = np.zeros((1 + _ROWS * len(self.triangles), 4), np.float32)
            rows[0, :2] = np.array([tree.id], np.uint64).view(np.float32)
            rows[1:] = normals_of(self.points(), self.triangles).reshape(-1, 4)
            return OnDevice(wp.array(rows, dtype=wp.vec4, device=device), tree)

        return shared(f"mesh {self.content} {self.scale}", device, make)


def what_is_open(points: np.ndarray, faces: np.ndarray) -> str:
    """Why a surface has no inside, in words that follow its name; "" where it has one."""
    ways = np.concatenate([faces[:, [k, (k + 1) % 3]] for k in range(3)]).astype(np.int64)
    there, back = ways[:, 0] * len(points) + ways[:, 1], ways[:, 1] * len(points) + ways[:, 0]
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


def normals_of(points: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(T, 7, 4) of each triangle: its unit normal and height, those of its corners, and of the edges across from them.

    Weighted by angles, they tell inside from outside wherever the nearest point lies (Baerentzen and Aanaes 2005,
    Signed distance computation using the angle weighted pseudonormal).
    """
    corners = points[faces]
    flat = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    flat /= np.maximum(np.linalg.norm(flat, axis=1, keepdims=True), 1e-300)
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


@wp.func
def row_of(u: float, v: float) -> int:
    """Which of the rows of a triangle holds for its point of barycentric coordinates u, v of the first two corners."""
    near = 1.0e-6
    first, second, third = u <= near, v <= near, 1.0 - u - v <= near
    row = wp.where(first, 4, wp.where(second, 5, wp.where(third, 6, 0)))
    if first and second:
        row = 3
    elif first and third:
        row = 2
    elif second and third:
        row = 1
    return row


@wp.func
def signed_distance(p: wp.vec3, size: wp.vec3, data: wp.uint64) -> wp.vec4:
    """Outward normal (x, y, z) and signed distance [m], positive outside, of local point p [m].

    A point whose distance is more than the reach is told a smaller one, and the way from the origin.
    """
    tree = load_address(data)
    found = wp.mesh_query_point_no_sign(tree, p, size[0])
    away = wp.length(p)
    n = p / wp.max(away, 1.0e-9)
    distance = wp.max(size[0], away - size[0])
    if found.result:
        row = row_of(found.u, found.v)
        normal = load4(data, 1 + wp.static(_ROWS) * found.face + row)
        n = xyz(normal)
        if row == 0:
            distance = wp.dot(n, p) - normal[3]
        else:
            offset = p - wp.mesh_eval_position(tree, found.face, found.u, found.v)
            distance = wp.length(offset)
            side = wp.where(wp.dot(offset, n) < 0.0, -1.0, 1.0)
            # Nearer than this, the way to the surface is rounding.
            if distance > 1.0e-5 * size[0]:
                n = (side / distance) * offset
            distance *= side
    return wp.vec4(n[0], n[1], n[2], distance)
