# SPDX-License-Identifier: Apache-2.0
"""Fittings of an object: clamps at its pins, the drum of a winch, the load at a rope's end."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from trimesh.creation import cylinder, icosphere
from trimesh.util import concatenate

STEEL_DENSITY = 7800.0  # [kg/m^3] of a load
DRUM = (0.1, 0.16)  # [m] radius and width
_LEAST = 0.012  # [m] radius of a clamp


def pinned(values: Mapping[str, Any], name: str, count: int) -> np.ndarray:
    """Return the indices of the pinned particles among `count` of an object with these parameters."""
    pins = values[f"{name}.pins"]
    if not isinstance(pins, str):
        return np.array(pins, int)
    if values[f"{name}.type"] == "rope":
        return np.array({"start": [0], "end": [count - 1], "both": [0, count - 1]}.get(pins, []), int)
    nx, ny = values[f"{name}.resolution"]
    index = np.arange(nx * ny).reshape(ny, nx)
    rim = np.unique(np.concatenate([index[0], index[-1], index[:, 0], index[:, -1]]))
    return {"top": index[-1], "corners": index[-1, [0, -1]], "edges": rim}.get(pins, np.array([], int))


class Fittings:
    """One mesh of all fittings of an object: `faces` (F, 3), and `vertices` that follow its particles."""

    def __init__(self, values: Mapping[str, Any], name: str, count: int):
        rope = values[f"{name}.type"] == "rope"
        thick = values[f"{name}.radius"] if rope else values[f"{name}.thickness"]
        drum = rope and values[f"{name}.winch.enabled"]
        parts = [(k, icosphere(1, max(_LEAST, 1.6 * thick))) for k in pinned(values, name, count) if k or not drum]
        if drum:
            turned = np.array([[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]], float)
            parts.append((0, cylinder(DRUM[0], DRUM[1], sections=32, transform=turned)))
            parts[-1][1].apply_translation((-DRUM[0], 0.0, 0.0))  # the rope leaves it at its side
        load = values[f"{name}.end_mass"] if rope else 0.0
        if load > 0.0:
            parts.append((count - 1, icosphere(3, (3.0 * load / (4.0 * np.pi * STEEL_DENSITY)) ** (1.0 / 3.0))))
        sizes = [len(part.vertices) for _, part in parts]
        self._of = np.repeat([k for k, _ in parts], sizes).astype(int)
        whole = concatenate([part for _, part in parts])
        self._corners, self.faces = np.asarray(whole.vertices), np.asarray(whole.faces)

    def vertices(self, positions: np.ndarray) -> np.ndarray:
        """Return vertices (V, 3) [m] for particles at `positions` (N, 3) [m]."""
        return positions[self._of] + self._corners


def hand(size: float) -> tuple[np.ndarray, np.ndarray]:
    """Return vertices (V, 3) [m] and faces (F, 3) of a hand that comes from above and pinches at the origin.

    size: scale of the hand [m].
    """
    tips = ((0.35, 0.0), (-0.35, 0.45), (-0.35, 0.0), (-0.35, -0.45))  # a thumb and three fingers
    meshes = [cylinder(0.16, segment=[(0.7 * x, y, 1.5), (0.35 * x, 0.7 * y, 0.1)], sections=12) for x, y in tips]
    meshes += [icosphere(2, 0.17) for _ in tips]
    for (x, y), ball in zip(tips, meshes[len(tips) :], strict=True):
        ball.apply_translation((0.35 * x, 0.7 * y, 0.1))
    palm, wrist = icosphere(2, 1.0), cylinder(0.38, segment=[(0, 0, 1.9), (0, 0, 3.2)], sections=16)
    palm.apply_scale((0.45, 0.75, 0.62))
    palm.apply_translation((0.0, 0.0, 1.75))
    meshes += [palm, wrist]
    whole = concatenate(meshes)
    return size * np.asarray(whole.vertices), np.asarray(whole.faces)
