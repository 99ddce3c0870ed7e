# SPDX-License-Identifier: Apache-2.0
"""Bending of sheets as plates: arrays of a batch, and their sizes."""

import warp as wp

from cloth_sim_ros.sim.arrays.model import Counts, Features


@wp.struct
class PlateState:
    """State of sheets that bend as plates; see State for the letters."""

    damped: wp.array(dtype=wp.vec4)  # (N,) displacements before bending [m], and their dashpots' part, see bending.py
    curve_normals: wp.array(dtype=wp.vec4)  # (C,) normals of triangles that are curved at rest, and `rest_square`
    curve_pulls: wp.array(dtype=wp.vec3)  # (C,) weights with which these push their corners along the normal [1/m]


def sizes(features: Features, n: Counts) -> dict[str, int]:
    return {"damped": n.particles * features.plate, "curve_normals": n.curves, "curve_pulls": n.curves}
