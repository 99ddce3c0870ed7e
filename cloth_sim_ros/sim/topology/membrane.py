# SPDX-License-Identifier: Apache-2.0
"""The membrane of a mesh: stretch and shear of each triangle in warp and weft, as springs along edges that are coupled.

The strains s of the edges of a triangle, elongation over rest length, determine its strain tensor. So any energy
A/2 s^T K s of a linear elastic membrane is one of the edges (Delingette 2008, Triangular springs for modeling nonlinear
membranes). Constant strains are exact on any mesh.

Lines of edges need a diagonal matrix. So K = D - R. The diagonal D has the sum of the magnitudes of each row of K, so
that R has no negative eigenvalue (Gershgorin). D is the springs, which are implicit. R s changes their rest lengths, at
the strains s where a substep starts. So it is exact at rest, adds R h to the viscosity, and is stable for any step by
which all springs together are solved (Ascher, Ruuth and Wetton 1995, Implicit-explicit methods for time-dependent
partial differential equations).

Lines are solved one after the other, in one sweep. By the spectral radii of the steps of meshes of silk and cotton that
is stable up to (omega h)^2 of 100, with omega of the fastest mode of D. In longer substeps a part of R stays out, down
to 0.8 R, with which all that were tried are stable. The sheet then shears too little.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cloth_sim_ros.sim.topology.plate_mesh import in_planes
from cloth_sim_ros.sim.topology.springs import numbers_of

# Least height of a triangle over its longest edge. The edges of thinner ones are springs without coupling, as their
# strains say too little of the strain across.
_SLIVER = 0.05


@dataclass(frozen=True)
class Moduli:
    """Young's moduli of warp and weft, shear modulus [N/m], and the contraction of the weft over a pull of the warp."""

    warp: float
    weft: float
    shear: float
    poisson: float

    def matrix(self) -> np.ndarray:
        """(3, 3) [N/m]: tensions of warp, weft and shear over strains e11, e22, 2 e12."""
        rest = 1.0 - self.poisson**2 * self.weft / self.warp
        mixed = self.poisson * self.weft / rest
        return np.array([[self.warp / rest, mixed, 0.0], [mixed, self.weft / rest, 0.0], [0.0, 0.0, self.shear]])


@dataclass(frozen=True)
class Coupling:
    """Rest lengths of springs that follow the lengths around them.

    Spring k from particle i to j has the rest length bases[k] + own[k] l_ij + shares[k] . (l_ip, l_jp, l_iq, l_jq) [m].
    l: lengths [m]. p, q: across[k], the particles opposite, -1 beyond a border. across: (S, 2). shares: (S, 4). own,
    bases: (S,). softness: share of the springs' stiffness that the softest strain of a triangle feels, by the median.
    """

    across: np.ndarray
    shares: np.ndarray
    own: np.ndarray
    bases: np.ndarray
    softness: float


def of_triangles(
    points: np.ndarray, triangles: np.ndarray, edges: np.ndarray, moduli: Moduli, warp: np.ndarray
) -> tuple[np.ndarray, Coupling]:
    """Constants (E,) [N/m] of springs at the edges of a mesh, and their coupling.

    points (N, 3) [m] at rest. triangles (T, 3). edges (E, 2): all of theirs, each once. warp: (3,) or (T, 3), the
    direction of the warp, of which the part in the plane of a triangle counts.
    """
    length, area, energy = _energies(points, triangles, moduli, warp)
    diagonal = np.abs(energy).sum(axis=2)
    left = diagonal[:, :, None] * np.eye(3) - energy
    opposite = np.stack([triangles[:, [1, 2, 0]], triangles[:, [2, 0, 1]]], axis=2)
    number = numbers_of(edges, opposite, len(points))  # of the edge opposite each corner
    # Per unit of elongation instead of strain, and of tension instead of energy.
    size = area[:, None] / length**2
    constants = np.bincount(number.ravel(), (size * diagonal).ravel(), len(edges))
    scaled = area[:, None, None] * left / (length[:, :, None] * length[:, None, :]) / constants[number][:, :, None]
    own = np.bincount(number.ravel(), np.diagonal(scaled, axis1=1, axis2=2).ravel(), len(edges))
    across, shares, lengths = np.full((len(edges), 2), -1), np.zeros((len(edges), 4)), np.zeros((len(edges), 4))
    order = np.argsort(number.ravel(), kind="stable")
    flat = number.ravel()[order]
    second = np.concatenate([[False], flat[1:] == flat[:-1]]).astype(int)
    triangle, corner = np.divmod(order, 3)
    across[flat, second] = triangles[triangle, corner]
    for other in ((corner + 1) % 3, (corner + 2) % 3):  # the edge opposite a corner does not begin at it
        end = (edges[flat, 0] == triangles[triangle, other]).astype(int)
        shares[flat, 2 * second + end] = scaled[triangle, corner, other]
        lengths[flat, 2 * second + end] = length[triangle, other]
    rest = np.zeros(len(edges))
    rest[number] = length
    root = 1.0 / np.sqrt(diagonal)
    softest = np.linalg.eigvalsh(root[:, :, None] * energy * root[:, None, :])[:, 0]
    bases = (1.0 - own) * rest - (shares * lengths).sum(1)
    return constants, Coupling(across, shares, own, bases, float(np.median(softest)))


def _energies(
    points: np.ndarray, triangles: np.ndarray, moduli: Moduli, warp: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Lengths (T, 3) [m] of the edges opposite the corners, areas (T,) [m^2], and matrices K (T, 3, 3) [N/m]."""
    corners = points[triangles]
    edge = corners[:, [2, 0, 1]] - corners[:, [1, 2, 0]]
    length = np.linalg.norm(edge, axis=2)
    normal = np.cross(edge[:, 2], -edge[:, 1])
    double = np.linalg.norm(normal, axis=1)
    sound = double > _SLIVER * length.max(axis=1) ** 2
    normal = normal / np.maximum(double, 1e-300)[:, None]
    first = in_planes(warp, normal)
    unit = edge / length[:, :, None]
    c, s = (unit * first[:, None]).sum(2), (unit * np.cross(normal, first)[:, None]).sum(2)
    strains = np.stack([c * c, s * s, c * s], axis=2)  # of the edges, for e11, e22, 2 e12
    strains[~sound] = np.eye(3)
    back = np.linalg.inv(strains)
    energy = back.transpose(0, 2, 1) @ moduli.matrix() @ back
    energy[~sound] = 0.5 * (moduli.warp + moduli.weft) * np.eye(3)
    return length, 0.5 * double, energy
