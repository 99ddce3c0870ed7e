# SPDX-License-Identifier: Apache-2.0
"""Cloths from triangle meshes, and the properties that every cloth gets from its triangles and its pose."""

from __future__ import annotations

import numpy as np

from cloth_sim_ros.sim.input.mesh_repair import areas_of, edges_of
from cloth_sim_ros.sim.physics.quaternion import rotate
from cloth_sim_ros.sim.scene.objects import Cloth
from cloth_sim_ros.sim.topology import membrane, plate
from cloth_sim_ros.sim.topology.elements import Topology, pinned_particles
from cloth_sim_ros.sim.topology.springs import Elements


def of_mesh(cloth: Cloth, name: str) -> Topology:
    """Build a mesh with a spring at each edge (Van Gelder 1998) and its mass lumped by area.

    Raises ValueError if a vertex has no triangle with an area, or an edge more than two triangles.
    """
    points, triangles = cloth.vertices, cloth.triangles
    areas = areas_of(points, triangles)
    lumped = np.bincount(triangles.ravel(), np.repeat(areas, 3), minlength=len(points))
    if lumped.min() <= 0.0:
        raise ValueError(
            f"{name} has vertex {int(lumped.argmin())} in no triangle with an area; allowed are meshes without such"
        )
    masses = cloth.mass * lumped / lumped.sum()
    edges, opposite, area = _edges(triangles, areas, len(points), name)
    length = np.linalg.norm(points[edges[:, 1]] - points[edges[:, 0]], axis=1)
    coupling = None
    if cloth.shear_compliance is None or cloth.tear_strain > 0.0:
        springs = {"structural": Elements(edges, length, length**2 / area)}
    else:
        constants, coupling = membrane.of_triangles(points, triangles, edges, _moduli(cloth), cloth.warp)
        springs = {"structural": Elements(edges, length, 1.0 / (constants * cloth.stretch_compliance))}
    inner = opposite[:, 1] >= 0
    if cloth.bend_compliance is not None and cloth.bending == "springs" and inner.any():
        pairs = opposite[inner]
        rest = np.linalg.norm(points[pairs[:, 1]] - points[pairs[:, 0]], axis=1)
        springs["bending"] = Elements(pairs, rest, np.ones(len(pairs)))
    return of_sheet(cloth, points, masses, {}, triangles, springs, coupling=coupling)


def of_sheet(
    cloth: Cloth,
    local: np.ndarray,
    masses: np.ndarray,
    named: dict[str, np.ndarray],
    triangles: np.ndarray,
    springs: dict[str, Elements],
    grid: tuple[int, int] | None = None,
    coupling: membrane.Coupling | None = None,
) -> Topology:
    """Build the topology of a grid or mesh: pins, pose in the world, and bending of the triangles.

    local: (N, 3) [m]. masses: (N,) [kg], unless the cloth has its own. named: name of pins -> particles. triangles:
    (T, 3). Raises ValueError if an edge has more than two triangles.
    """
    pinned = pinned_particles(cloth.pins, named, len(local))
    bending = None
    if cloth.bend_compliance is not None and cloth.bending == "dihedral":
        bending = plate.of_triangles(local, triangles, pinned, cloth.tear_strain > 0.0, _weave(cloth))
    return Topology(
        rest=rotate(cloth.orientation, local) + np.asarray(cloth.position),
        masses=masses if cloth.particle_masses is None else cloth.particle_masses,
        pinned=pinned,
        springs=springs,
        triangles=triangles,
        panels=triangles,
        layout=local,
        plate=bending,
        coupling=coupling,
        grid=grid,
        tear_strain=cloth.tear_strain,
        origin=np.asarray(cloth.position),
    )


def _weave(cloth: Cloth) -> plate.Weave:
    """Of the compliances of strips along warp, weft and the diagonal between them.

    Under a moment of 1 N a strip along the diagonal has the curvature (1/warp + 1/weft + 2/twist) / 4, by the moments
    along warp, weft and of twist, half a newton each.
    """
    weft, diagonal = (
        1.0 if each is None else each / cloth.bend_compliance
        for each in (cloth.weft_bend_compliance, cloth.diagonal_bend_compliance)
    )
    if cloth.diagonal_bend_compliance is None:
        diagonal = 0.5 * (1.0 + weft)
    return plate.Weave(1.0 / weft, 2.0 / (4.0 * diagonal - 1.0 - weft), cloth.warp)


def _moduli(cloth: Cloth) -> membrane.Moduli:
    warp = 1.0 / cloth.stretch_compliance
    return membrane.Moduli(warp, warp / cloth.weft_over_warp, 1.0 / cloth.shear_compliance, cloth.poisson)


def _edges(
    triangles: np.ndarray, areas: np.ndarray, count: int, name: str
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Unique edges (E, 2), the vertices opposite (E, 2) with -1 beyond a border, and the area of both triangles (E,).

    count: of vertices. Raises ValueError where an edge has more than two triangles.
    """
    edges, times, of = edges_of(triangles, count)
    if times.max() > 2:
        a, b = edges[times.argmax()]
        raise ValueError(
            f"{name} has {times.max()} triangles at edge {a}-{b}; allowed are meshes with at most 2 an edge"
        )
    third = np.roll(triangles, 1, axis=1).T.ravel()[np.argsort(of, kind="stable")]
    start, two = np.cumsum(times) - times, times == 2
    opposite = np.full((len(edges), 2), -1)
    opposite[:, 0], opposite[two, 1] = third[start], third[start[two] + 1]
    return edges, opposite, np.bincount(of, np.tile(areas, 3), minlength=len(edges))
