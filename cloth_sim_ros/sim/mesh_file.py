# SPDX-License-Identifier: Apache-2.0
"""Triangle meshes from files, checked before use.

Readers of text formats hold the interpreter for seconds on a large file. So a separate process reads large files.
"""

from __future__ import annotations

import io
import logging
import os
import resource
import subprocess
import sys
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from urllib.parse import unquote

import numpy as np

from cloth_sim_ros.parameters import UNIT, check, shown
from cloth_sim_ros.shared_files import PACKAGE, shared
from cloth_sim_ros.sim.input.mesh_reading import MOST_BYTES, PART, Mesh, Read, read
from cloth_sim_ros.sim.input.regular_file import check_regular

APART_BYTES = 4 << 20  # file size [bytes] above which a separate process reads the file
APART = (".glb", ".gltf")  # formats always read so, as a few bytes of them may ask for any amount of memory
FORMATS = ".obj, .off, .ply, .stl, .glb and what else trimesh reads"
_MOST_MEMORY = 8 << 30  # memory limit of such a process [bytes]

_LOG = logging.getLogger(__name__)
_readers: set[subprocess.Popen] = set()


def load_mesh(path: str, parameter: str, scale: float = 1.0) -> Mesh:
    """Return vertices (N, 3) in units of `scale` [m] and triangles (T, 3) of a mesh file.

    The file is read again only when it has changed. Triangles without area are dropped, which the log reports. Vertices
    on open edges are welded, see mesh_repair. path: as `local_path` takes it. FILE#PART is a part of a file: an object
    or group of an .obj, a node of a scene, or a number where none has a name. FILE.urdf#LINK is the collision geometry
    of a robot's link, in the axes of the link. Raises ValueError, in one sentence about `parameter`.
    """
    return _found(path, parameter, scale)[:2]


def load_warp(path: str, parameter: str, scale: float, along: Sequence[float]) -> np.ndarray:
    """Return directions (T, 3) in which the texture of a mesh file grows along `along`, its u and v, for each triangle.

    Triangles without an area in the texture have that of the nearest one. Raises ValueError likewise, also without a
    texture.
    """
    ways = _found(path, parameter, scale)[3]
    warp = np.tensordot(ways, np.asarray(along[:2], dtype=float), axes=(1, 0))
    sound = np.linalg.norm(warp, axis=1) > 0.0
    if not sound.any():
        raise ValueError(
            f"{parameter} is {shown(path)}, which has no texture with an area; allowed are files with u and v"
        )
    if not sound.all():
        points, triangles = _found(path, parameter, scale)[:2]
        middles = points[triangles].mean(axis=1)
        for k in np.flatnonzero(~sound):
            warp[k] = warp[sound][np.linalg.norm(middles[sound] - middles[k], axis=1).argmin()]
    return warp


def _found(path: str, parameter: str, scale: float) -> Read:
    """What mesh_reading.read finds, told once. Raises ValueError."""
    check(UNIT, scale, f"{parameter} scale")
    try:
        file, part = local_path(path, parameter), ""
        if PART in path and not file.exists():
            name, _, part = path.rpartition(PART)
            file = local_path(name, parameter)
        status = file.stat()
        check_regular(status)
        found = _load(str(file), part, scale, status.st_size, status.st_mtime_ns)
    except (FileNotFoundError, NotADirectoryError):
        raise ValueError(f"{parameter} is {shown(path)}; {absent(file, FORMATS)}") from None
    except _Unresolved:
        raise
    except (OSError, ValueError, RuntimeError) as error:
        found = f"cannot be read: {getattr(error, 'strerror', '') or error}"
    if isinstance(found, str):
        raise ValueError(f"{parameter} is {shown(path)}, which {found}")
    if found[2]:
        tell_once(f"{parameter} is {shown(path)}, which {found[2]}")
    return found


def absent(file: Path, formats: str) -> str:
    """Return where a file was looked for in vain, and which formats are allowed, in words for a sentence about it."""
    folder = file.absolute().parent
    where = shown(str(folder)) + ("" if folder.is_dir() else ", which is no folder")
    return f"no such file is in {where}; allowed are {formats}"


@lru_cache(maxsize=1024)
def tell_once(sentence: str) -> None:
    """Log a sentence once, as a scene is checked whenever a parameter is set."""
    _LOG.warning(sentence)


class _Unresolved(ValueError):
    """A package is not installed."""


def local_path(path: str, parameter: str) -> Path:
    """Return the local path of `package://NAME/PATH`, `file:///PATH` or a plain path.

    Raises ValueError, in one sentence about `parameter`.
    """
    scheme, there, rest = path.partition("://")
    if not there or scheme not in ("package", "file"):
        return Path(path).expanduser()
    rest = unquote(rest)
    if scheme == "file":
        return Path("/" + rest.partition("/")[2])
    package, _, inside = rest.partition("/")
    if package == PACKAGE:  # also found without a ROS installation
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
def _load(path: str, part: str, scale: float, size: int, modified_ns: int) -> Read | str:
    """Return the result of mesh_reading.read, or why there is none."""
    if size > MOST_BYTES:
        return f"has {size / 1e6:.0f} MB; allowed are at most {MOST_BYTES / 1e6:.0f} MB"
    if size <= APART_BYTES and not path.lower().endswith(APART):
        return read(path, part, scale, load_mesh)
    command = [sys.executable, "-m", "cloth_sim_ros.sim.mesh_file", path, part, str(scale)]
    env = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}  # each thread would use up part of the memory limit
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, env=env) as reader:
        _readers.add(reader)
        output, _ = reader.communicate()
        _readers.discard(reader)
    if reader.returncode:
        return output.decode().strip() or "cannot be read as a triangle mesh: its reader failed"
    with np.load(io.BytesIO(output)) as arrays:
        return arrays["vertices"], arrays["triangles"], str(arrays["told"]), arrays["ways"]


def stop_reading() -> None:
    """Kill the processes that read meshes."""
    for reader in tuple(_readers):
        reader.kill()


if __name__ == "__main__":
    resource.setrlimit(resource.RLIMIT_AS, (_MOST_MEMORY, _MOST_MEMORY))
    path, part, scale = sys.argv[1:]
    mesh_or_words = read(path, part, float(scale), load_mesh)
    if isinstance(mesh_or_words, str):
        print(mesh_or_words)
        sys.exit(1)
    np.savez(sys.stdout.buffer, **dict(zip(("vertices", "triangles", "told", "ways"), mesh_or_words, strict=True)))
