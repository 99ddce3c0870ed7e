# SPDX-License-Identifier: Apache-2.0
"""A robot by its description (URDF): its links that collide, and the poses of links at the positions of joints."""

from __future__ import annotations

import io
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from cloth_sim_ros.parameters import shown
from cloth_sim_ros.ros.inputs.pose_track import Pose
from cloth_sim_ros.sim import Box, Cylinder, Mesh, Sphere
from cloth_sim_ros.sim.colliders.collider import Collider
from cloth_sim_ros.sim.input.mesh_reading import MOST_BYTES
from cloth_sim_ros.sim.input.regular_file import open_regular
from cloth_sim_ros.sim.mesh_file import load_mesh, local_path

GROUP = "robot"  # of its parameters, and the first part of the names of its colliders
_TURNS, _SHIFTS = ("revolute", "continuous"), ("prismatic",)


@dataclass(frozen=True)
class Part:
    """A collision geometry of `link`, at `pose` in the axes of the link; make(fields) returns its collider."""

    link: str
    pose: Pose
    make: Callable[[Mapping[str, Any]], Collider]


def read_robot(urdf: str) -> Robot:
    """Return the robot of a description: its text, or the path of its file.

    Raises ValueError, in words that follow "urdf".
    """
    text, folder = urdf.encode(), None
    if not urdf.lstrip().startswith("<"):
        file = local_path(urdf, f"{GROUP}.urdf")
        try:
            with open_regular(file) as source:
                text, folder = source.read(MOST_BYTES), file.parent
        except OSError as error:
            raise ValueError(
                f"{GROUP}.urdf is {shown(urdf)}, which cannot be read: {error.strerror or error}"
            ) from None
    return _robot(text, folder)


@lru_cache(maxsize=4)
def _robot(text: bytes, folder: Path | None) -> Robot:
    try:
        import yourdfpy

        model = yourdfpy.URDF.load(io.BytesIO(text), build_scene_graph=False, load_meshes=False)
        return Robot(model.robot, folder)
    except ImportError as error:
        raise ValueError(f"{GROUP}.urdf needs {error.name}: pip install yourdfpy") from None
    except Exception as error:  # whatever a reader of XML raises, the user gets one sentence
        words = " ".join(str(error).split()) or type(error).__name__
        raise ValueError(f"{GROUP}.urdf is no description of a robot: {shown(words)}") from None


class Robot:
    """Links, joints and collision geometries of a description from yourdfpy. Raises ValueError if it is no tree.

    parts: name robot/<link>/<k> -> collision geometry. joints: names of the movable joints.
    """

    def __init__(self, model: Any, folder: Path | None):
        links, joints = {link.name: link for link in model.links}, {joint.name: joint for joint in model.joints}
        above = {joint.child: joint for joint in joints.values()}
        for joint in joints.values():
            for link in {joint.parent, joint.child} - links.keys():
                raise ValueError(f"joint {joint.name} names a link {link}, which is not there")
            if above[joint.child] is not joint:
                raise ValueError(f"link {joint.child} hangs on two joints")
        roots = [name for name in links if name not in above]
        self._links = roots[:1]  # from the root outwards
        for link in self._links:
            self._links += [joint.child for joint in joints.values() if joint.parent == link]
        if len(roots) != 1 or len(self._links) < len(links):
            raise ValueError(f"its links hang on the roots {', '.join(roots) or 'none'}; allowed is one tree")
        self._above = [self._links.index(above[link].parent) for link in self._links[1:]]
        self._joints = [above[link] for link in self._links[1:]]
        for joint in self._joints:
            if joint.mimic is not None and joint.mimic.joint not in joints:
                raise ValueError(f"joint {joint.name} mimics {joint.mimic.joint}, which is not there")
        self.joints = {joint.name for joint in self._joints if joint.type in (*_TURNS, *_SHIFTS)}
        self._origins = np.array([_matrix(joint.origin) for joint in self._joints]).reshape(-1, 4, 4)
        axes = [(1.0, 0.0, 0.0) if joint.axis is None else joint.axis for joint in self._joints]
        axes = np.array(axes, float).reshape(-1, 3)
        lengths = np.linalg.norm(axes, axis=1)
        if len(axes) and not (np.isfinite(lengths) & (lengths > 0.0)).all():
            raise ValueError(f"joint {self._joints[int(np.argmin(lengths > 0.0))].name} has the axis 0")
        axes /= lengths[:, None]
        x, y, z = axes.T
        none = np.zeros_like(x)
        self._across = np.moveaxis(np.array([[none, -z, y], [z, none, -x], [-y, x, none]]), 2, 0)
        turns, shifts = (np.array([joint.type in kinds for joint in self._joints]) for kinds in (_TURNS, _SHIFTS))
        self._turns, self._ways = turns.astype(float), axes * shifts[:, None]
        self.parts = {
            f"{GROUP}/{name}/{k}": Part(name, *_part(name, collision, folder))
            for name, link in links.items()
            for k, collision in enumerate(link.collisions)
        }

    def chosen(self, patterns: Sequence[str]) -> dict[str, Part]:
        """Return the parts of links whose names match any of `patterns`."""
        return {
            name: part for name, part in self.parts.items() if any(fnmatchcase(part.link, each) for each in patterns)
        }

    def places(self, positions: Mapping[str, float], base: Pose) -> dict[str, Pose]:
        """Return link -> its pose, with the root link at `base`, and joints at `positions` [rad or m] or else at 0."""
        at = np.array([self._position(joint, positions) for joint in self._joints])
        angles, across = (at * self._turns)[:, None, None], self._across
        moves = np.zeros((len(at), 4, 4))
        # Rodrigues' formula.
        moves[:, :3, :3] = np.eye(3) + np.sin(angles) * across + (1.0 - np.cos(angles)) * across @ across
        moves[:, :3, 3], moves[:, 3, 3] = at[:, None] * self._ways, 1.0
        moves = self._origins @ moves
        found = [_matrix_of(base)]
        for above, move in zip(self._above, moves, strict=True):
            found.append(found[above] @ move)
        return dict(zip(self._links, _poses(np.array(found)), strict=True))

    def _position(self, joint: Any, positions: Mapping[str, float]) -> float:
        mimic = joint.mimic
        if mimic is None:
            return positions.get(joint.name, 0.0)
        return (1.0 if mimic.multiplier is None else mimic.multiplier) * positions.get(mimic.joint, 0.0) + (
            mimic.offset or 0.0
        )


def _part(link: str, collision: Any, folder: Path | None) -> tuple[Pose, Callable[[Mapping[str, Any]], Collider]]:
    """Return the pose of a collision geometry in the axes of `link`, and a function that makes its collider."""
    shape, pose = collision.geometry, _poses(_matrix(collision.origin)[None])[0]
    if shape.box is not None:
        return pose, lambda fields: Box(half_extents=tuple(0.5 * each for each in shape.box.size), **fields)
    if shape.sphere is not None:
        return pose, lambda fields: Sphere(radius=shape.sphere.radius, **fields)
    if shape.cylinder is not None:
        height = shape.cylinder.length
        return pose, lambda fields: Cylinder(radius=shape.cylinder.radius, half_length=0.5 * height, **fields)
    if shape.mesh is None:
        raise ValueError(f"link {link} has a collision that is no box, sphere, cylinder or mesh")
    name, scale = shape.mesh.filename, np.broadcast_to(1.0 if shape.mesh.scale is None else shape.mesh.scale, 3)
    file = name if folder is None or "://" in name else str(folder / name)

    def make(fields: Mapping[str, Any]) -> Collider:
        if (scale == scale[0]).all():
            return Mesh.from_file(file, float(scale[0]), **fields)
        points, triangles = load_mesh(file, f"the mesh of {link}")
        return Mesh(vertices=points * scale, triangles=triangles, **fields)

    return pose, make


def _matrix(origin: Any) -> np.ndarray:
    """Return a pose of a description as a matrix (4, 4). Raises ValueError if it is not finite."""
    matrix = np.eye(4) if origin is None else np.asarray(origin, float)
    if not np.isfinite(matrix).all():
        raise ValueError("an origin is not finite")
    return matrix


def _matrix_of(pose: Pose) -> np.ndarray:
    """Return a pose as a matrix (4, 4)."""
    x, y, z, w = np.asarray(pose.orientation) / math.hypot(*pose.orientation)
    matrix = np.eye(4)
    matrix[:3, 3] = pose.position
    matrix[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return matrix


def _poses(matrices: np.ndarray) -> list[Pose]:
    """Return matrices (k, 4, 4) as poses.

    There are four formulas for a quaternion. Each matrix uses the one that divides by the largest component.
    """
    turn = matrices[:, :3, :3]
    # Four times each product of two parts, in rows w x y z.
    diagonal = np.einsum("kii->ki", turn)
    total = diagonal.sum(axis=1)
    products = np.empty((len(matrices), 4, 4))
    products[:, 0, 0] = 1.0 + total
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        products[:, i + 1, i + 1] = 1.0 + 2.0 * diagonal[:, i] - total
        products[:, 0, i + 1] = products[:, i + 1, 0] = turn[:, k, j] - turn[:, j, k]
        products[:, i + 1, j + 1] = products[:, j + 1, i + 1] = turn[:, i, j] + turn[:, j, i]
    largest = np.argmax(np.einsum("kii->ki", products), axis=1)
    parts = products[np.arange(len(matrices)), largest]
    parts /= np.linalg.norm(parts, axis=1, keepdims=True)
    rows = zip(matrices[:, :3, 3].tolist(), parts.tolist(), strict=True)
    return [Pose(tuple(place), (x, y, z, w)) for place, (w, x, y, z) in rows]
