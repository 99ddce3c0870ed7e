# SPDX-License-Identifier: Apache-2.0
"""Colliders as triangles, for drawing."""

from __future__ import annotations

import numpy as np
from trimesh import Trimesh
from trimesh.creation import box, cylinder, icosphere
from trimesh.util import concatenate

from cloth_sim_ros.sim.colliders.collider import Collider, Solid

_UNIT = {"box": box, "ball": lambda: icosphere(3, 0.5), "cylinder": lambda: cylinder(0.5, 1.0, sections=48)}


def mesh_of(collider: Collider) -> Trimesh | None:
    """Return the triangles of a collider in its axes; None if it has none."""
    parts = [_mesh(solid) for solid in collider.solids() if solid.kind != "cells"]
    return concatenate(parts) if parts else None


def _mesh(solid: Solid) -> Trimesh:
    if solid.kind == "triangles":
        return Trimesh(solid.points, np.arange(len(solid.points)).reshape(-1, 3))
    unit = _UNIT[solid.kind]()
    return Trimesh(unit.vertices * solid.scale + solid.middle, unit.faces, process=False)
