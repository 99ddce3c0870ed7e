# SPDX-License-Identifier: Apache-2.0
"""Read a mesh file, or describe in one sentence what is wrong with it, whatever its reader raises."""

from __future__ import annotations

import codecs
import io
import json
import re
import zipfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from cloth_sim_ros.parameters import CLOTH, row, shown
from cloth_sim_ros.sim.input.mesh_repair import Unfit, cut, parts_of, repair
from cloth_sim_ros.sim.input.regular_file import open_regular

Mesh = tuple[np.ndarray, np.ndarray]
Faces = Sequence[Sequence[int]] | np.ndarray  # polygons, each of the numbers of its vertices
Read = tuple[np.ndarray, np.ndarray, str, np.ndarray]

URDF = ".urdf"
PART = "#"  # between a file and the name of a part, or of a link in a robot's description
MOST_BYTES = 64 << 20  # of a file, and of all that it unpacks to or names
FARTHEST = row(CLOTH, "position").high  # [m] of a vertex from the origin, along an axis
_DECIMAL_INDICES = re.compile(rb"property\s+list\s+\w+\s+(float|double)\w*\s+vertex_ind")  # a reader would cut them
_OPTIONAL = ("trimesh", "yourdfpy", "shapely")  # by the same name for pip
_PACKED = (".binvox", ".bz2", ".gz")  # formats of trimesh that do not tell how large they are when unpacked
_UNREAD = "cannot be read as a triangle mesh:"


@dataclass(frozen=True)
class Surface:
    """What a file holds: points (N, 3), faces; of the corners of all faces, one after the other, their u and v (C, 2),
    or None; of each face the names of its parts, or None."""

    points: np.ndarray
    faces: Faces
    texture: np.ndarray | None = None
    names: list[tuple[str, ...]] | None = None


def read(path: str, part: str, scale: float, load_mesh: Callable[[str, str], Mesh]) -> Read | str:
    """Vertices (N, 3), triangles (T, 3), what is to be told, and the vectors (T, 2, 3) along which u and v of a texture
    grow by 1, of a mesh file; or what is wrong with it. Words follow the name of the file.

    There are (0, 2, 3) vectors without a texture, and zeros where it has no area. part: the name of a part, or its
    number where none has a name; of a robot's description a link, whose meshes load_mesh(path, parameter) reads; "" is
    all. scale: length of a unit in the file [m].
    """
    try:
        content = _content(Path(path), MOST_BYTES)
        if not path.lower().endswith(".stl"):  # a binary one may begin with any bytes
            content = content.removeprefix(codecs.BOM_UTF8)
        _check_content(path, content)
        if part and path.lower().endswith(URDF):
            found, part = Surface(*_read_link(path, content, part, load_mesh)), ""
        else:
            found = _READERS.get(Path(path).suffix.lower(), _read_any)(path, content)
        _check_numbers(found.points, found.faces, FARTHEST / scale)
        if part and found.names is not None:
            found, part = _part(found, part), ""
        return _finished(found, part)
    except Unfit as error:
        return str(error)
    except Exception as error:  # whatever a reader of some format raises, the user gets one sentence
        if isinstance(error, ImportError) and error.name in _OPTIONAL:
            return f"needs {error.name} to be read: pip install {error.name}"
        words = shown(" ".join(str(error).split()))
        if isinstance(error, (OSError, MemoryError, NotImplementedError)):
            return f"{_UNREAD} {words}"
        detail = f": {words}" if isinstance(error, ValueError) else ""  # others speak of the code of the reader
        return f"{_UNREAD} it is cut off, damaged or no {Path(path).suffix} file{detail}"


def _finished(found: Surface, part: str) -> Read:
    """As `read`, of the whole or the part of a number. Raises Unfit."""
    points, ways = np.array(found.points, np.float64), np.zeros((0, 2, 3))
    if found.texture is None:
        triangles = cut(points, found.faces)
    else:  # cut by corners, which have a texture each
        lengths = [len(face) for face in found.faces]
        ends = np.cumsum(lengths)
        of = np.array(list(chain.from_iterable(found.faces)), int)
        corners = cut(points[of], [range(end - length, end) for end, length in zip(ends, lengths, strict=True)])
        triangles, ways = of[corners], _ways(points[of][corners], found.texture[corners])
    mesh = repair(points, triangles, welds=True)
    ways = ways[mesh.of] if len(ways) else ways
    if not part:
        return mesh.points, mesh.triangles, mesh.told, ways
    number = parts_of(len(mesh.points), mesh.triangles)
    if not part.isdigit() or int(part) > number.max():
        raise Unfit(f"has no part {part!r}; allowed is a number from 0 to {number.max()}, as no part has a name")
    some = number == int(part)
    used, triangles = np.unique(mesh.triangles[some], return_inverse=True)
    return mesh.points[used], triangles.reshape(-1, 3).astype(np.int32), mesh.told, ways[some] if len(ways) else ways


def _part(found: Surface, part: str) -> Surface:
    """The faces of a part. Raises Unfit."""
    chosen = [part in names for names in found.names]
    if not any(chosen):
        known = ", ".join(dict.fromkeys(chain.from_iterable(found.names)))
        raise Unfit(f"has no part {part!r}; allowed are {shown(known)}")
    texture = found.texture
    if texture is not None:
        texture = texture[np.repeat(chosen, [len(face) for face in found.faces])]
    faces = [face for face, takes in zip(found.faces, chosen, strict=True) if takes]
    return Surface(found.points, faces, texture)


def _ways(corners: np.ndarray, texture: np.ndarray) -> np.ndarray:
    """Vectors (T, 2, 3) along which u and v grow by 1, of triangles (T, 3, 3) with `texture` (T, 3, 2); 0 for those
    without an area in the texture."""
    sides, (a, b) = corners[:, 1:] - corners[:, :1], np.moveaxis(texture[:, 1:] - texture[:, :1], 1, 0)
    double = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    sound = np.abs(double) > 1e-9 * np.maximum((a * a).sum(1), (b * b).sum(1))
    inverse = np.stack([b[:, 1], -a[:, 1], -b[:, 0], a[:, 0]], axis=1) * sound[:, None]
    return (inverse / np.where(sound, double, 1.0)[:, None]).reshape(-1, 2, 2) @ sides


def _content(path: Path, most: int) -> bytes:
    """The bytes of a regular file. Raises OSError where there is none, or for more than `most`."""
    with open_regular(path) as file:
        content = file.read(most + 1)
    if len(content) > most:
        raise OSError(f"{path.name} has more than {most / 1e6:.0f} MB")
    return content


def _check_content(path: str, content: bytes) -> None:
    """Raise Unfit where no reader is to have this, and JSONDecodeError for a .gltf that is cut off."""
    if not content:
        raise Unfit("is empty")
    if path.lower().endswith(".gltf"):
        json.loads(content)
    if path.lower().endswith(_PACKED):
        raise Unfit(f"is packed; allowed are meshes as they are, not {', '.join(_PACKED)}")
    if _DECIMAL_INDICES.search(content[:4096]):
        raise Unfit("names its vertices by decimals; allowed are whole numbers")
    if content.startswith(b"PK"):  # such as .3mf
        with zipfile.ZipFile(io.BytesIO(content)) as box:
            size = sum(info.file_size for info in box.infolist())
        if size > MOST_BYTES:
            raise Unfit(f"unpacks to {size / 1e6:.0f} MB; allowed are at most {MOST_BYTES / 1e6:.0f} MB")


def _read_obj(path: str, content: bytes) -> Surface:
    """What a Wavefront file holds, by its own numbers. Parts are its objects and groups.

    A reader for drawing parts vertices along the seams of a texture, and makes fans of polygons that are not convex.
    """
    points, places, polygons, corners, names = [], [], [], [], []
    thing, groups = (), ()
    for line in content.replace(b"\\\r\n", b" ").replace(b"\\\n", b" ").splitlines():
        word, *rest = line.partition(b"#")[0].split() or [b""]
        if word == b"v":
            points.append(rest[:3])
        elif word == b"vt":
            places.append([*rest[:2], b"0"][:2])
        elif word == b"o":
            thing = (b" ".join(rest).decode(errors="replace"),)
        elif word == b"g":
            groups = tuple(group.decode(errors="replace") for group in rest)
        elif word == b"f":
            parts = [corner.split(b"/") for corner in rest]
            polygons.append([_counted(each[0], len(points)) for each in parts])
            corners += [(each[1] if len(each) > 1 else b"", len(places)) for each in parts]
            names.append(thing + groups)
    try:
        texture = np.array(places, float)[[_counted(*each) for each in corners]] if places else None
    except (ValueError, IndexError):  # some corners have none, or one that is not there
        texture = None
    return Surface(_places(points), polygons, texture, names if any(names) else None)


def _places(rows: Sequence[Sequence[bytes]]) -> np.ndarray:
    """Points (N, 3) of rows of words. Raises Unfit for a row of fewer than three."""
    for k, each in enumerate(rows):
        if len(each) < 3:
            raise Unfit(f"has vertex {k} of {len(each)} coordinate{'s' * (len(each) != 1)}; allowed are 3")
    return np.array(rows, float)


def _counted(number: bytes, rows: int) -> int:
    """The place among `rows` that a Wavefront file counts from 1, or from the last one backwards."""
    found = int(number)
    return found - 1 if found > 0 else rows + found


def _read_off(path: str, content: bytes) -> Surface:
    """The same of an Object File Format. Raises Unfit where lines are missing."""
    lines = [line.partition(b"#")[0].split() for line in content.splitlines()]
    words = [line for line in lines if line]
    if words[0][0].endswith(b"OFF"):  # the numbers may follow on the same line
        words = ([words[0][1:]] if len(words[0]) > 1 else []) + words[1:]
    points, faces = int(words[0][0]), int(words[0][1])
    _check_whole("lines of vertices and faces", len(words) - 1, points + faces)
    rows = words[1 + points : 1 + points + faces]
    polygons = [[int(number) for number in row[1 : 1 + int(row[0])]] for row in rows]
    return Surface(_places([row[:3] for row in words[1 : 1 + points]]), polygons)


def _read_ply(path: str, content: bytes) -> Surface:
    """The same of a Stanford file: trimesh keeps what it has read as it was. Raises Unfit where some is missing."""
    whole = _load(path, content, force="mesh").metadata.get("_ply_raw", {})
    if "face" not in whole:
        raise Unfit("holds no triangles")
    points, faces = (whole[name]["data"] for name in ("vertex", "face"))
    name = next(name for name in ("vertex_indices", "vertex_index") if name in whole["face"]["properties"])
    polygons = faces[name] if isinstance(faces, dict) else faces[name]["f1"]
    _check_whole("vertices", len(points["x"]), whole["vertex"]["length"])
    _check_whole("faces", len(polygons), whole["face"]["length"])
    return Surface(np.column_stack([points[axis] for axis in "xyz"]), [row.ravel().tolist() for row in polygons])


def _read_stl(path: str, content: bytes) -> Surface:
    """The same of an STL file. Raises Unfit for one that is cut off, in which trimesh finds nothing."""
    text, count = content.lower(), int.from_bytes(content[80:84], "little")
    size, last = 84 + 50 * count, text.rfind(b"vertex")
    if len(content) != size and last < 0:
        has = f"it has {len(content)} bytes, where a binary one of {count} triangles has {size}"
        raise Unfit(f"{_UNREAD} it is cut off or no .stl file, as {has}")
    if len(content) != size and text.rfind(b"endsolid") < last:
        raise Unfit(f"{_UNREAD} it is cut off, as its last solid has no endsolid")
    return _read_any(path, content)


def _read_any(path: str, content: bytes) -> Surface:
    """The same of any format that trimesh reads. Parts are the nodes of a scene and their geometries."""
    scene = _load(path, content, force="scene")
    points, faces, texture, names = [], [], [], []
    for node in scene.graph.nodes_geometry:
        place, name = scene.graph[node]
        mesh = scene.geometry[name]
        if not hasattr(mesh, "faces"):
            continue
        mesh = mesh.copy().apply_transform(place)
        faces.append(np.asarray(mesh.faces) + sum(map(len, points)))
        points.append(np.asarray(mesh.vertices))
        flat = getattr(mesh.visual, "uv", None)
        texture.append(None if flat is None else np.asarray(flat)[np.asarray(mesh.faces).ravel()])
        names += [(str(node), str(name))] * len(mesh.faces)
    if not points:
        raise Unfit("holds no triangles")
    whole = None if any(each is None for each in texture) else np.concatenate(texture)
    return Surface(np.concatenate(points), np.concatenate(faces), whole, names if len(points) > 1 else None)


def _load(path: str, content: bytes, force: str) -> Any:
    import trimesh

    kind = Path(path).suffix[1:]
    return trimesh.load(io.BytesIO(content), kind, resolver=_buffers(path), force=force, process=False)


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
            if f"{URDF}{PART}" in name:
                raise Unfit(f"has a robot as a mesh of its link {link!r}; allowed are files of meshes")
            beside = name if "://" in name else str(Path(path).parent / name)
            try:
                part = trimesh.Trimesh(*load_mesh(beside, f"the mesh of {link}"), process=False)
            except ValueError as error:
                raise Unfit(f"cannot be read: {error}") from None
            part.apply_scale(1.0 if shape.mesh.scale is None else shape.mesh.scale)
        parts.append(part if collision.origin is None else part.apply_transform(collision.origin))
    if not parts:
        raise Unfit(f"has nothing that collides in link {link!r}")
    whole = trimesh.util.concatenate(parts)
    return np.asarray(whole.vertices), np.asarray(whole.faces)


def _check_whole(what: str, found: int, wanted: int) -> None:
    """Raise Unfit for a file with fewer of `what` than its header wants."""
    if found < wanted:
        raise Unfit(f"{_UNREAD} it is cut off, as it has {found} of {wanted} {what}")


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


_READERS = {".obj": _read_obj, ".off": _read_off, ".ply": _read_ply, ".stl": _read_stl}
