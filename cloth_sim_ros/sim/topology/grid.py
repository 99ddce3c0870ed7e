# SPDX-License-Identifier: Apache-2.0
"""A cloth that is a rectangular grid: its particles row by row, and its springs."""

from __future__ import annotations

import numpy as np

from cloth_sim_ros.sim.scene.objects import Cloth
from cloth_sim_ros.sim.topology.elements import Topology
from cloth_sim_ros.sim.topology.mesh import of_sheet
from cloth_sim_ros.sim.topology.springs import Elements


def of_grid(cloth: Cloth, in_air: bool) -> Topology:
    """A grid of nx x ny particles, each cell cut into two triangles along its diagonal (0, 0)-(1, 1).

    A corner has the mass of a quarter cell, as its springs have half the constant. `in_air` it has a third of each of
    its one or two triangles, as of their air, so that a flat sheet falls flat.
    """
    nx, ny = cloth.resolution
    width, height = cloth.size
    ix, iy = (a.ravel() for a in np.meshgrid(np.arange(nx), np.arange(ny)))
    local = np.stack(
        [ix * width / (nx - 1) - width / 2, iy * height / (ny - 1) - height / 2, np.zeros(nx * ny)], axis=1
    )
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
    masses = cloth.mass * np.bincount(triangles.ravel()) / triangles.size
    if not in_air:
        masses[index[[0, 0, -1, -1], [0, -1, 0, -1]]] = 0.25 * cloth.mass / ((nx - 1) * (ny - 1))
    return of_sheet(cloth, local, masses, named, triangles, _grid_springs(cloth, index, local), (nx, ny))


def _grid_springs(cloth: Cloth, index: np.ndarray, local: np.ndarray) -> dict[str, Elements]:
    """Springs by kind, from the indices (ny, nx) of particles at `local` (N, 3) [m]; on a border twice as compliant."""
    ny, nx = index.shape
    ix, iy = np.arange(nx)[None, :], np.arange(ny)[:, None]
    on_x = np.broadcast_to(np.where((iy == 0) | (iy == ny - 1), 2.0, 1.0), (ny, nx))  # springs along x lie on a border
    on_y = np.broadcast_to(np.where((ix == 0) | (ix == nx - 1), 2.0, 1.0), (ny, nx))

    def lines(step: int) -> list[tuple]:
        """Springs over `step` cells along x and y."""
        return [(index[:, :-step], index[:, step:], on_x[:, :-step]), (index[:-step], index[step:], on_y[:-step])]

    one = np.ones((ny - 1, nx - 1))
    along, across = lines(1)
    groups = {"structural": [along, (*across[:2], across[2] * cloth.weft_over_warp)]}
    if cloth.shear_compliance is not None:
        groups["shear"] = [(index[:-1, :-1], index[1:, 1:], one), (index[:-1, 1:], index[1:, :-1], one)]
    if cloth.bend_compliance is not None and cloth.bending == "springs" and max(nx, ny) > 2:
        groups["bending"] = lines(2)
    return {kind: _springs(parts, local) for kind, parts in groups.items()}


def _springs(parts: list[tuple], local: np.ndarray) -> Elements:
    """Springs of one kind from parts (first, second, scale), each an array a number."""
    first, second, scale = (np.concatenate([part[k].ravel() for part in parts]) for k in range(3))
    pairs = np.stack([first, second], axis=1)
    return Elements(pairs, np.linalg.norm(local[second] - local[first], axis=1), scale)
