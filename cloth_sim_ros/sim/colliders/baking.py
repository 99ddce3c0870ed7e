# SPDX-License-Identifier: Apache-2.0
"""The signed distance of a mesh on a grid: computed once, and kept on disk under a hash of the mesh."""

from __future__ import annotations

import logging
import os
import tempfile
import time
import zipfile
from pathlib import Path

import numpy as np
import warp as wp

from cloth_sim_ros.sim.colliders import mesh_distance
from cloth_sim_ros.sim.colliders.mesh import Mesh
from cloth_sim_ros.sim.kernels.compiled import compiled
from cloth_sim_ros.status_line import show

CELLS = 64  # along the longest side of a mesh
_MOST_CELLS = 400
_MARGIN = 2  # cells around it
_LOG = logging.getLogger(__name__)
_BY_MESH = mesh_distance.signed_distance

Baked = tuple[np.ndarray, tuple[float, ...], float]


def bake(mesh: Mesh, cells: int) -> Baked:
    """Values (X, Y, Z) [m], origin and spacing [m] of a grid around a mesh, with `cells` along its longest side.

    Raises ValueError for a number of cells that is not allowed.
    """
    if isinstance(cells, bool) or not isinstance(cells, int) or not 2 <= cells <= _MOST_CELLS:
        raise ValueError(f"cells is {cells!r}; allowed is a whole number from 2 to {_MOST_CELLS}")
    low, high = mesh.points().min(axis=0), mesh.points().max(axis=0)
    spacing = float((high - low).max() / cells)
    origin = low - _MARGIN * spacing
    shape = tuple(int(n) for n in np.ceil((high - low) / spacing - 1e-6) + 1 + 2 * _MARGIN)
    file = cache() / f"{mesh.content}-{mesh.scale:.9g}-{cells}.npz"
    values = _read(file, shape)
    if values is None:
        values = _compute(mesh, origin, spacing, shape)
        _write(file, values)
    return values, tuple(origin.tolist()), spacing


def cache() -> Path:
    """The cache folder: cloth_sim_ros in XDG_CACHE_HOME, or else in ~/.cache."""
    return Path(os.environ.get("XDG_CACHE_HOME") or "~/.cache").expanduser() / "cloth_sim_ros"


@compiled(module="unique")
def _measure(first: wp.vec3, spacing: float, wide: int, size: wp.vec3, data: wp.uint64, values: wp.array(dtype=float)):
    k = wp.tid()
    p = first + spacing * wp.vec3(0.0, float(k / wide), float(k % wide))
    values[k] = _BY_MESH(p, size, data)[3]


def _compute(mesh: Mesh, origin: np.ndarray, spacing: float, shape: tuple[int, ...]) -> np.ndarray:
    """Compute the values slice by slice on the CPU."""
    device = wp.get_device("cpu")
    data, values = mesh.data(device), np.empty(shape, np.float32)
    of_slice = wp.empty(shape[1] * shape[2], dtype=float, device=device)
    begin = time.monotonic()
    for i in range(shape[0]):
        first = origin + (i * spacing, 0.0, 0.0)
        inputs = [wp.vec3(*first), spacing, shape[2], wp.vec3(*mesh.size()), data.id, of_slice]
        wp.launch(_measure, dim=len(of_slice), inputs=inputs, device=device)
        values[i] = of_slice.numpy().reshape(shape[1:])
        left = (time.monotonic() - begin) * (shape[0] / (i + 1) - 1.0)
        show(f"signed distances: {(i + 1) / shape[0]:4.0%}, {left:.0f} s left")
    show("")
    return values


def _read(file: Path, shape: tuple[int, ...]) -> np.ndarray | None:
    """Read cached values; None if there are none, or the file is damaged."""
    try:
        with np.load(file) as arrays:
            values = arrays["values"]
    except (OSError, ValueError, LookupError, EOFError, zipfile.BadZipFile):
        return None
    return values if values.shape == shape and values.dtype == np.float32 else None


def _write(file: Path, values: np.ndarray) -> None:
    """Write values to the cache atomically; if that fails, they are computed again the next time."""
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=file.parent, suffix=".part", delete=False) as part:
            np.savez(part, values=values)
        os.replace(part.name, file)
    except OSError as error:
        _LOG.info("signed distances are not kept in %s: %s", file, error)
