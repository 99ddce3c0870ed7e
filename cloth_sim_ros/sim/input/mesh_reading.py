# SPDX-License-Identifier: Apache-2.0
"""Read a mesh file, or describe in one sentence what is wrong with it, whatever its reader raises."""

from __future__ import annotations

import io
import re
import zipfile
from collections.abc import Callable, Sequence
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from cloth_sim_ros.parameters import CLOTH, row, shown
from cloth_sim_ros.sim.input.mesh_repair import Unfit, cut, repair
from cloth_sim_ros.sim.input.regular_file import open_regular

Mesh = tuple[np.ndarray, np.ndarray]
Faces = Sequence[Sequence[int]] | np.ndarray  # polygons, each of the numbers of its vertices
Read = tuple[np.ndarray, np.ndarray, str]

URDF = ".urdf"
LINK = f"{URDF}#"  # between a robot's description and the name of a link
MOST_BYTES = 64 << 20  # of a file, and of all that it unpacks to or names
FARTHEST = row(CLOTH, "position").high  # [m] of a vertex from the origin, along an axis
_DECIMAL_INDICES = re.compile(rb"property\s+list\s+\w+\s+(float|double)\w*\s+vertex_ind")  # a reader would cut them
_OPTIONAL = ("trimesh", "yourdfpy", "shapely")  # by the same name for pip
_PACKED = (".binvox", ".bz2", ".gz")  # formats of trimesh that do not tell how large they are when unpacked


def read(path: str, link: str, scale: float, load_mesh: Callable[[str, str], Mesh]) -> Read | str:
    """Vertices (N, 3), triangles (T, 3) and what is to be told of a mesh file, or what is wrong with it; both in words
    that follow its name.

    link: of a robot's description, whose meshes load_mesh(path, parameter) reads; "" of a mesh. scale: length of a unit
    in the file [m].
    """
    try:
        content = _content(Path(path), MOST_BYTES)
        _check_content(path, content)
        if link:
            points, faces = _read_link(path, content, link, load_mesh)
        else:
            points, faces = _READERS.get(Path(path).suffix.lower(), _read_any)(path, content)
        _check_numbers(points, faces, FARTHEST / scale)
        mesh = repair(np.array(points, np.float64), cut(points, faces), welds=True)
        return mesh.points, mesh.triangles, mesh.told
    except Unfit as error:
        return str(error)
    except Exception as error:  # whatever a reader of some format raises, the user gets one sentence
        if isinstance(error, ImportError) and error.name in _OPTIONAL:
            return f"needs {error.name} to be read: pip install {error.name}"
        return f"cannot be read as a triangle mesh: {shown(' '.join(str(error).split()))}"


def _content(path: Path, most: int) -> bytes:
    """The bytes of a regular file. Raises OSError where there is none, or ValueError for more than `most`."""
    with open_regular(path) as file:
        content = file.read(most + 1)
    if len(content) > most:
        raise ValueError(f"{path.name} has more than {most / 1e6:.0f} MB")
    return content


def _check_content(path: str, content: bytes) -> None:
    """Raise Unfit where no reader is to have this."""
    if path.lower().endswith(_PACKED):
        raise Unfit(f"is packed; allowed are meshes as they are, not {', '.join(_PACKED)}")
    if _DECIMAL_INDICES.search(content[:4096]):
        raise Unfit("names its vertices by decimals; allowed are whole numbers")
    if content.startswith(b"PK"):  # such as .3mf
        with zipfile.ZipFile(io.BytesIO(content)) as box:
            size = sum(info.file_size for info in box.infolist())
        if size > MOST_BYTES:
            raise Unfit(f"unpacks to {size / 1e6:.0f} MB; allowed are at most {MOST_BYTES / 1e6:.0f} MB")


def _read_obj(path: str, content: bytes) -> tuple[np.ndarray, Faces]:
    """Vertices (N, 3) and faces of a Wavefront file, by its own numbers.

    A reader for drawing parts vertices along the seams of a texture, and makes fans of polygons that are not convex.
    """
    points, polygons = [], []
    for line in content.replace(b"\\\r\n", b" ").replace(b"\\\n", b" ").splitlines():
        word, *rest = line.partition(b"#")[0].split() or [b""]
        if word == b"v":
            points.append(rest[:3])
        elif word == b"f":
            numbers = [int(corner.partition(b"/")[0]) for corner in rest]
            polygons.append([number - 1 if number > 0 else len(points) + number for number in numbers])
    return np.array(points, float), polygons


def _read_off(path: str, content: bytes) -> tuple[np.ndarray, Faces]:
    """The same of an Object File Format."""
    lines = [line.partition(b"#")[0].split() for line in content.splitlines()]
    words = [line for line in lines if line]
    if words[0][0].endswith(b"OFF"):  # the numbers may follow on the same line
        words = ([words[0][1:]] if len(words[0]) > 1 else []) + words[1:]
    points, faces = int(words[0][0]), int(words[0][1])
    rows = words[1 + points : 1 + points + faces]
    polygons = [[int(number) for number in row[1 : 1 + int(row[0])]] for row in rows]
    return np.array([row[:3] for row in words[1 : 1 + points]], float), polygons


def _read_ply(path: str, content: bytes) -> tuple[np.ndarray, Faces]:
    """The same of a Stanford file: trimesh keeps what it has read as it was."""
    whole = _load(path, content).metadata["_ply_raw"]
    points, faces = (whole[name]["data"] for name in ("vertex", "face"))
    name = next(name for name in ("vertex_indices", "vertex_index") if name in whole["face"]["properties"])
    polygons = faces[name] if isinstance(faces, dict) else faces[name]["f1"]
    return np.column_stack([points[axis] for axis in "xyz"]), [row.ravel().tolist() for row in polygons]


def _read_any(path: str, content: bytes) -> tuple[np.ndarray, Faces]:
    """The same of any format that trimesh reads."""
    mesh = _load(path, content)
    return np.asarray(mesh.vertices), np.asarray(mesh.faces)


def _load(path: str, content: bytes) -> Any:
    import trimesh

    kind = Path(path).suffix[1:]
    return trimesh.load(io.BytesIO(content), kind, resolver=_buffers(path), force="mesh", process=False)


def _buffers(path: str) -> Any:
    """The resolver by which trimesh finds the files that a .gltf names, of limited total size; None for others."""
    from trimesh.resolvers import FilePathResolver

    class Bounded(FilePathResolver):
        left = MOST_BYTES

        def get(self, name: str) -> bytes:
            content = _content(Path(self.parent) / name, self.left)
            self.left -= len(content)
            return content

    return Bounded(path) if path.lower().endswith(".gltf") else None


def _read_link(path: str, content: bytes, link: str, load_mesh: Callable[[str, str], Mesh]) -> Mesh:
    """All that collides of a link of a robot as one mesh."""
    import trimesh
    import yourdfpy

    unread = {"build_scene_graph": False, "load_meshes": False}
    links = yourdfpy.URDF.load(io.BytesIO(content), **unread).link_map
    if link not in links:
        raise Unfit(f"has no link {link!r}; allowed are {shown(', '.join(links))}")
    parts = []
    for collision in links[link].collisions:
        shape = collision.geometry
        if shape.box is not None:
            part = trimesh.creation.box(shape.box.size)
        elif shape.sphere is not None:
            part = trimesh.creation.icosphere(subdivisions=3, radius=shape.sphere.radius)
        elif shape.cylinder is not None:
            part = trimesh.creation.cylinder(shape.cylinder.radius, shape.cylinder.length)
        else:
            name = shape.mesh.filename
            if LINK in name:
                raise Unfit(f"has a robot as a mesh of its link {link!r}; allowed are files of meshes")
            beside = name if "://" in name else str(Path(path).parent / name)
            part = trimesh.Trimesh(*load_mesh(beside, f"the mesh of {link}"), process=False)
            part.apply_scale(1.0 if shape.mesh.scale is None else shape.mesh.scale)
        parts.append(part if collision.origin is None else part.apply_transform(collision.origin))
    if not parts:
        raise Unfit(f"has nothing that collides in link {link!r}")
    whole = trimesh.util.concatenate(parts)
    return np.asarray(whole.vertices), np.asarray(whole.faces)


def _check_numbers(points: np.ndarray, faces: Faces, farthest: float) -> None:
    """Raise Unfit for numbers that are no mesh, or farther from the origin along an axis."""
    if points.ndim != 2 or points.shape[1] != 3 or not len(faces):
        raise Unfit("holds no triangles")
    if not np.isfinite(points).all() or np.abs(points).max() > farthest:
        worst = int(np.argmax(np.where(np.isfinite(points), np.abs(points), np.inf).max(axis=1)))
        raise Unfit(f"has vertex {worst} at {points[worst].tolist()}; allowed is up to {farthest:g}")
    numbers = np.array(list(chain.from_iterable(faces)))
    if len(numbers) and not 0 <= numbers.min() <= numbers.max() < len(points):
        bad = next(k for k, face in enumerate(faces) if len(face) and not 0 <= min(face) <= max(face) < len(points))
        named = shown([int(number) for number in faces[bad]])
        raise Unfit(f"has face {bad} of vertices {named}; allowed are 0 to {len(points) - 1}")


_READERS = {".obj": _read_obj, ".off": _read_off, ".ply": _read_ply}  # of formats that have polygons
