# SPDX-License-Identifier: Apache-2.0
"""Triangle meshes from files: read apart from the thread that answers requests, and checked before they are used.

Readers of text formats hold the interpreter for seconds on a large file. So a process of its own reads a large one.
"""

from __future__ import annotations

import io
import re
import stat
import subprocess
import sys
from functools import lru_cache
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np

from cloth_sim_ros.parameters import CLOTH, row, shown
from cloth_sim_ros.shared_files import PACKAGE, shared

Mesh = tuple[np.ndarray, np.ndarray]

URDF = ".urdf"
LINK = f"{URDF}#"  # between a robot's description and the name of a link
MOST_BYTES = 64 << 20
APART_BYTES = 4 << 20  # beyond this another process reads it
FARTHEST = row(CLOTH, "position").high  # [m] of a vertex from the origin, along an axis
SHORTEST = 1e-6  # of an edge, relative to the mesh: float32 cannot tell its ends apart well below
_DECIMAL_INDICES = re.compile(rb"property\s+list\s+\w+\s+(float|double)\w*\s+vertex_ind")  # a reader would cut them

_readers: set[subprocess.Popen] = set()


def load_mesh(path: str, parameter: str) -> Mesh:
    """Vertices (N, 3) [m] and triangles (T, 3) of a mesh file, read again only when the file has changed.

    path: as `local_path` takes it. FILE.urdf#LINK is what of a robot's link collides, in the axes of the link. Raises
    ValueError, in one sentence about `parameter`.
    """
    try:
        name, _, link = path.partition(LINK) if LINK in path else (path, "", "")
        name += URDF if link else ""
        file = local_path(name, parameter)
        status = file.stat()
        known = (status.st_size, status.st_mtime_ns)
        found = _load(str(file), link, *known) if stat.S_ISREG(status.st_mode) else "is no mesh file"
    except (FileNotFoundError, NotADirectoryError):
        raise ValueError(f"{parameter} is {shown(path)}; no such file is there") from None
    except _Unresolved:
        raise
    except (OSError, ValueError, RuntimeError) as error:
        found = f"cannot be read: {getattr(error, 'strerror', '') or error}"
    if isinstance(found, str):
        raise ValueError(f"{parameter} is {shown(path)}, which {found}")
    return found


class _Unresolved(ValueError):
    """A package is not there."""


def local_path(path: str, parameter: str) -> Path:
    """Where a file lies that is named by `package://NAME/PATH`, `file:///PATH` or a plain path.

    Raises ValueError, in one sentence about `parameter`.
    """
    scheme, there, rest = path.partition("://")
    if not there or scheme not in ("package", "file"):
        return Path(path).expanduser()
    rest = unquote(rest)
    if scheme == "file":
        return Path("/" + rest.partition("/")[2])
    package, _, inside = rest.partition("/")
    if package == PACKAGE:  # which also runs where no ROS has installed it
        return shared(inside)
    try:
        from ament_index_python.packages import get_package_share_directory

        return Path(get_package_share_directory(package)) / inside
    except ImportError:
        why = "which needs ament_index_python of ROS; allowed is a plain path"
    except (LookupError, ValueError, OSError):
        why = f"and no package {package!r} is installed; allowed is one of those that `ros2 pkg list` shows"
    raise _Unresolved(f"{parameter} is {shown(path)}, {why}")


@lru_cache(maxsize=32)
def _load(path: str, link: str, size: int, modified_ns: int) -> Mesh | str:
    """The mesh, or what is wrong with it in words that follow its name."""
    if size > MOST_BYTES:
        return f"has {size / 1e6:.0f} MB; allowed are at most {MOST_BYTES / 1e6:.0f} MB"
    if size <= APART_BYTES:
        return _read(path, link)
    command = [sys.executable, "-m", "cloth_sim_ros.sim.mesh_file", path, link]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) as reader:
        _readers.add(reader)
        output, _ = reader.communicate()
        _readers.discard(reader)
    if reader.returncode:
        return output.decode().strip() or "cannot be read as a triangle mesh: its reader failed"
    with np.load(io.BytesIO(output)) as arrays:
        return arrays["vertices"], arrays["triangles"]


def stop_reading() -> None:
    """Ends the processes that read meshes."""
    for reader in tuple(_readers):
        reader.kill()


def _read(path: str, link: str) -> Mesh | str:
    try:
        import trimesh
    except ImportError:
        return "needs trimesh to be read: pip install trimesh"
    try:
        with open(path, "rb") as file:
            if _DECIMAL_INDICES.search(file.read(4096)):
                return "names its vertices by decimals; allowed are whole numbers"
        mesh = _read_link(path, link) if link else trimesh.load(path, force="mesh", process=False)
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


def _read_link(path: str, link: str) -> Any:
    """All that collides of a link of a robot as one mesh, or what is wrong in words that follow the file's name."""
    import trimesh

    try:
        import yourdfpy
    except ImportError:
        return "needs yourdfpy to be read: pip install yourdfpy"
    unread = {"build_scene_graph": False, "load_meshes": False}
    links = yourdfpy.URDF.load(path, **unread).link_map
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


if __name__ == "__main__":
    mesh_or_words = _read(*sys.argv[1:])
    if isinstance(mesh_or_words, str):
        print(mesh_or_words)
        sys.exit(1)
    np.savez(sys.stdout.buffer, vertices=mesh_or_words[0], triangles=mesh_or_words[1])
