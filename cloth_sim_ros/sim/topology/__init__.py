# SPDX-License-Identifier: Apache-2.0
"""Particles and elements of a scene's objects, in NumPy: one file per kind of object."""

from cloth_sim_ros.sim.scene.objects import Cloth, Rope
from cloth_sim_ros.sim.topology.elements import Topology
from cloth_sim_ros.sim.topology.grid import of_grid
from cloth_sim_ros.sim.topology.mesh import of_mesh
from cloth_sim_ros.sim.topology.rope import of_rope
from cloth_sim_ros.sim.topology.springs import KINDS, Elements

__all__ = ["KINDS", "Elements", "Topology", "build"]


def build(thing: Cloth | Rope, name: str, direct_ropes: bool, in_air: bool = False) -> Topology:
    """Build the topology of a cloth or rope called `name`.

    With `direct_ropes`, the segments of a rope are a chain for a direct solve, and no springs. in_air: True if the
    scene has wind. Raises ValueError for a mesh that is not manifold or has a vertex without area.
    """
    if isinstance(thing, Rope):
        return of_rope(thing, direct_ropes)
    return of_grid(thing, in_air) if thing.vertices is None else of_mesh(thing, name)
