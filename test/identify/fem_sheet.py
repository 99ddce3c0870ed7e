# SPDX-License-Identifier: Apache-2.0
"""A sheet by another model, in float64: finite elements for stretch, finite differences for bending, small steps."""

import numpy as np
from scipy import sparse


class FemSheet:
    """A square sheet of linear triangles of St. Venant and Kirchhoff's material that bends as Kirchhoff's plate.

    rest (M, M, 3): vertices of a square grid [m]. modulus: Young's times thickness [N/m]. rigidity [N m]. damping: [s]
    of all strain, as by Kelvin and Voigt. fixed (M, M): which vertices do not move.
    """

    def __init__(self, rest, mass, modulus, poisson, rigidity, damping, fixed):
        side = len(rest)
        self._rest, self._damping = rest.reshape(-1, 3), damping
        self._free = ~fixed.ravel()
        self._triangles = alternating(side)
        corners = self._rest[self._triangles]
        sides = np.stack([corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]], axis=2)[:, :2]
        self._inverse, self._areas = np.linalg.inv(sides), 0.5 * np.abs(np.linalg.det(sides))
        lumped = np.bincount(self._triangles.ravel(), np.repeat(self._areas / 3.0, 3))
        self._masses = mass * lumped / lumped.sum()
        self._shear, self._bulk = modulus / (2 * (1 + poisson)), modulus * poisson / (1 - poisson**2)
        self._plate = rigidity * plate(side, np.linalg.norm(self._rest[1] - self._rest[0]), poisson)

    def run(self, gravity, frames, rate=60.0, steps=120):
        """Positions (frames, M, M, 3) after each frame, by symplectic Euler."""
        x, v, h, seen = self._rest.copy(), np.zeros_like(self._rest), 1.0 / rate / steps, []
        for _ in range(frames):
            for _ in range(steps):
                v[self._free] += h * (self._forces(x, v) / self._masses[:, None] + gravity)[self._free]
                x += h * v
            seen.append(x.copy())
        side = round(len(x) ** 0.5)
        return np.array(seen).reshape(frames, side, side, 3)

    def _forces(self, x, v):
        gradient, rate = self._gradients(x), self._gradients(v)
        strain = 0.5 * (gradient.transpose(0, 2, 1) @ gradient - np.eye(2))
        strain += 0.5 * self._damping * (gradient.transpose(0, 2, 1) @ rate + rate.transpose(0, 2, 1) @ gradient)
        trace = np.trace(strain, axis1=1, axis2=2)[:, None, None]
        stress = 2.0 * self._shear * strain + self._bulk * trace * np.eye(2)
        pull = -self._areas[:, None, None] * gradient @ stress @ self._inverse.transpose(0, 2, 1)
        forces = -self._plate @ (x + self._damping * v)
        for corner, each in ((0, -pull.sum(axis=2)), (1, pull[:, :, 0]), (2, pull[:, :, 1])):
            np.add.at(forces, self._triangles[:, corner], each)
        return forces

    def _gradients(self, x):
        corners = x[self._triangles]
        return np.stack([corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]], axis=2) @ self._inverse


def alternating(side):
    """The triangles of a grid of side x side vertices, with diagonals that alternate."""
    found = []
    for i in range(side - 1):
        for j in range(side - 1):
            a, b, c, d = i * side + j, i * side + j + 1, (i + 1) * side + j, (i + 1) * side + j + 1
            found += [(a, b, d), (a, d, c)] if (i + j) % 2 else [(a, b, c), (b, d, c)]
    return np.array(found)


def plate(side, h, poisson):
    """The stiffness matrix of a plate of rigidity 1 on a square grid of spacing h [m], by differences.

    Of kappa_xx^2 + kappa_yy^2 + 2 poisson kappa_xx kappa_yy + 2 (1 - poisson) kappa_xy^2 (Timoshenko).
    """
    second = sparse.diags([1.0, -2.0, 1.0], [0, 1, 2], shape=(side - 2, side)) / h**2
    first = sparse.diags([-1.0, 1.0], [0, 1], shape=(side - 1, side)) / h
    whole, inner = sparse.identity(side), sparse.identity(side).tocsr()[1:-1]
    half = sparse.diags(np.r_[0.5, np.ones(side - 2), 0.5])  # an edge has half the area
    along, across = sparse.kron(whole, second), sparse.kron(second, whole)
    mixed = sparse.kron(inner, second).T @ sparse.kron(second, inner)
    found = along.T @ sparse.kron(half, sparse.identity(side - 2)) @ along
    found += across.T @ sparse.kron(sparse.identity(side - 2), half) @ across
    found += poisson * (mixed + mixed.T)
    twist = sparse.kron(first, first)
    return (h**2 * (found + 2.0 * (1.0 - poisson) * twist.T @ twist)).tocsr()
