# SPDX-License-Identifier: Apache-2.0
"""What a mesh file holds, or what is wrong with it in one sentence, whatever the reader of its format does."""

from __future__ import annotations

import io
import re
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from cloth_sim_ros.parameters import CLOTH, row, shown
from cloth_sim_ros.sim.input.regular_file import open_regular

Mesh = tuple[np.ndarray, np.ndarray]

URDF = ".urdf"
LINK = f"{URDF}#"  # between a robot's description and the name of a link
MOST_BYTES = 64 << 20  # of a file, and of all that it unpacks to or names
FARTHEST = row(CLOTH, "position").high  # [m] of a vertex from the origin, along an axis
SHORTEST = 1e-6  # of an edge, relative to the mesh: float32 cannot tell its ends apart well below
_DECIMAL_INDICES = re.compile(rb"property\s+list\s+\w+\s+(float|double)\w*\s+vertex_ind")  # a reader would cut them
_PACKED = (".binvox", ".bz2", ".gz")  # formats of trimesh that do not tell how large they are when unpacked


def read(path: str, link: str, load_mesh: Callable[[str, str], Mesh]) -> Mesh | str:
    """The mesh in a file, or what is wrong with it in words that follow its name.

    link: of a robot's description, whose meshes load_mesh(path, parameter) reads; "" of a mesh.
    """
    try:
        import trimesh
    except ImportError:
        return "needs trimesh to be read: pip install trimesh"
    try:
        content = _content(Path(path), MOST_BYTES)
        wrong = _unreadable(path, content)
        if wrong:
            return wrong
        if link:
            mesh = _read_link(path, content, link, load_mesh)
        else:
            kind = Path(path).suffix[1:]
            mesh = trimesh.load(io.BytesIO(content), kind, resolver=_buffers(path), force="mesh", process=False)
        if isinstance(mesh, str):
            return mesh
        wrong = _wrong(np.asarray(mesh.vertices), np.asarray(mesh.faces))
        if wrong:
            return wrong
        mesh.merge_vertices(merge_tex=True, merge_norm=True)
        mesh.remove_unreferenced_vertices()
        vertices, triangles = np.array(mesh.vertices, np.float64), np.array(mesh.faces, np.int32)
    except Exception as error:  # whatever a reader of some format raises, the user gets one sentence
        return f"cannot be read as a triangle mesh: {shown(' '.join(str(error).split()))}"
    return _short(vertices, triangles) or (vertices, triangles)


def _content(path: Path, most: int) -> bytes:
    """The bytes of a regular file. Raises OSError where there is none, or ValueError for more than `most`."""
    with open_regular(path) as file:
        content = file.read(most + 1)
    if len(content) > most:
        raise ValueError(f"{path.name} has more than {most / 1e6:.0f} MB")
    return content


def _unreadable(path: str, content: bytes) -> str:
    """Why a reader is not to have this, in words that follow the file's name; "" where it may."""
    if path.lower().endswith(_PACKED):
        return f"is packed; allowed are meshes as they are, not {', '.join(_PACKED)}"
    if _DECIMAL_INDICES.search(content[:4096]):
        return "names its vertices by decimals; allowed are whole numbers"
    if content.startswith(b"PK"):  # such as .3mf
        with zipfile.ZipFile(io.BytesIO(content)) as box:
            size = sum(info.file_size for info in box.infolist())
        if size > MOST_BYTES:
            return f"unpacks to {size / 1e6:.0f} MB; allowed are at most {MOST_BYTES / 1e6:.0f} MB"
    return ""


def _buffers(path: str) -> Any:
    """How trimesh finds the files that a .gltf names, no more than a file may have in all; others need none."""
    from trimesh.resolvers import FilePathResolver

    class Bounded(FilePathResolver):
        left = MOST_BYTES

        def get(self, name: str) -> bytes:
            content = _content(Path(self.parent) / name, self.left)
            self.left -= len(content)
            return content

    return Bounded(path) if path.lower().endswith(".gltf") else None


def _read_link(path: str, content: bytes, link: str, load_mesh: Callable[[str, str], Mesh]) -> Any:
    """All that collides of a link of a robot as one mesh, or what is wrong in words that follow the file's name."""
    import trimesh

    try:
        import yourdfpy
    except ImportError:
        return "needs yourdfpy to be read: pip install yourdfpy"
    unread = {"build_scene_graph": False, "load_meshes": False}
    links = yourdfpy.URDF.load(io.BytesIO(content), **unread).link_map
    if link not in links:
        return f"has no link {link!r}; allowed are {shown(', '.join(links))}"
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
                return f"has a robot as a mesh of its link {link!r}; allowed are files of meshes"
            beside = name if "://" in name else str(Path(path).parent / name)
            part = trimesh.Trimesh(*load_mesh(beside, f"the mesh of {link}"), process=False)
            part.apply_scale(1.0 if shape.mesh.scale is None else shape.mesh.scale)
        parts.append(part if collision.origin is None else part.apply_transform(collision.origin))
    return trimesh.util.concatenate(parts) if parts else f"has nothing that collides in link {link!r}"


def _wrong(vertices: np.ndarray, triangles: np.ndarray) -> str:
    """What is wrong with the numbers of a file; "" where nothing is."""
    if triangles.ndim != 2 or not len(triangles):
        return "holds no triangles"
    if not np.isfinite(vertices).all() or np.abs(vertices).max() > FARTHEST:
        worst = int(np.argmax(np.where(np.isfinite(vertices), np.abs(vertices), np.inf).max(axis=1)))
        return f"has vertex {worst} at {vertices[worst].tolist()}; allowed is up to {FARTHEST:g} m"
    outside = np.flatnonzero(((triangles < 0) | (triangles >= len(vertices))).any(axis=1))
    if len(outside):
        named = triangles[outside[0]].tolist()
        return f"has triangle {outside[0]} of vertices {named}; allowed are 0 to {len(vertices) - 1}"
    return ""


def _short(vertices: np.ndarray, triangles: np.ndarray) -> str:
    """Which triangle has an edge of no length; "" where none has."""
    lengths = np.linalg.norm(vertices[triangles] - vertices[np.roll(triangles, 1, axis=1)], axis=2).min(axis=1)
    shortest = int(lengths.argmin())
    if lengths[shortest] > SHORTEST * np.ptp(vertices, axis=0).max():
        return ""
    return f"has an edge of no length in triangle {shortest}; allowed are triangles of three distinct vertices"
