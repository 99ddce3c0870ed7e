# SPDX-License-Identifier: Apache-2.0
"""A system of masses and springs in float64: the equations themselves, straight from Newton and Hooke.

Particle i has the mass m_i. Spring s lies between a_s and b_s with rest length L_s, constant k_s and a dashpot c_s =
tau k_s. The dashpot feels only the rate of its length. The code shares nothing with the solver that it judges.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from scipy import sparse


@dataclass(frozen=True)
class SpringSystem:
    """Constants of motion. `fixed` particles stay at their start under any force.

    masses (N,) [kg], fixed (N,) bool, pairs (S, 2), rest_length (S,) [m], constant (S,) [N/m], damping tau [s], gravity
    (3,) [m/s^2]. global_damping [1/s]: a drag relative to each particle's momentum. bending (N, N) [N/m]: a stiffness
    that acts on every coordinate alike, or None.
    """

    masses: np.ndarray
    fixed: np.ndarray
    pairs: np.ndarray
    rest_length: np.ndarray
    constant: np.ndarray
    damping: float = 0.0
    global_damping: float = 0.0
    gravity: tuple[float, float, float] = (0.0, 0.0, -9.81)
    bending: sparse.csr_array | None = field(default=None, repr=False)
    incidence: sparse.csr_array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        if not np.isfinite(self.constant).all():
            raise ValueError("a spring is rigid; allowed are finite spring constants")
        count = len(self.pairs)
        rows = self.pairs.T.ravel()
        signs = np.concatenate([-np.ones(count), np.ones(count)])
        shape = (len(self.masses), count)
        object.__setattr__(self, "incidence", sparse.csr_array((signs, (rows, np.tile(np.arange(count), 2))), shape))

    @classmethod
    def from_springs(
        cls,
        masses: np.ndarray,
        pins: np.ndarray,
        springs: Mapping[str, tuple[np.ndarray, np.ndarray, np.ndarray]],
        **more: object,
    ) -> SpringSystem:
        """Return `springs` (kind -> pairs, rest lengths, constants) as one system; `pins` are fixed indices."""
        pairs, rest, constant = (np.concatenate([kind[k] for kind in springs.values()]) for k in range(3))
        fixed = np.zeros(len(masses), dtype=bool)
        fixed[np.asarray(pins, dtype=np.int64)] = True
        as_float = (np.asarray(a, dtype=np.float64) for a in (masses, rest, constant))
        masses, rest, constant = as_float
        return cls(masses, fixed, np.asarray(pairs, dtype=np.int64), rest, constant, **more)

    def lengths(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return lengths (S,) [m] and unit directions (S, 3) of the springs at x (N, 3); 0 for springs of no length."""
        edge = x[self.pairs[:, 1]] - x[self.pairs[:, 0]]
        length = np.sqrt(np.einsum("ij,ij->i", edge, edge))
        return length, edge / np.where(length > 0.0, length, 1.0)[:, None]

    def strains(self, x: np.ndarray) -> np.ndarray:
        """Return (length - rest) / rest of every spring, (S,); x may be (..., N, 3)."""
        edge = x[..., self.pairs[:, 1], :] - x[..., self.pairs[:, 0], :]
        return np.linalg.norm(edge, axis=-1) / self.rest_length - 1.0

    def pull(self, directions: np.ndarray, tension: np.ndarray) -> np.ndarray:
        """Return forces (N, 3) [N] of springs along `directions` (S, 3) under `tension` (S,) [N]."""
        return -(self.incidence @ (tension[:, None] * directions))

    def forces(self, x: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return forces (N, 3) [N] of springs, dashpots, gravity and global damping, on fixed particles as well."""
        length, n = self.lengths(x)
        tension = self.constant * (length - self.rest_length)
        if self.damping > 0.0:
            rate = np.einsum("ij,ij->i", n, v[self.pairs[:, 1]] - v[self.pairs[:, 0]])
            tension = tension + self.damping * self.constant * rate
        weight = self.masses[:, None] * np.asarray(self.gravity)
        if self.bending is not None:
            weight = weight - self.bending @ x
        return self.pull(n, tension) + weight - self.global_damping * self.masses[:, None] * v

    def accelerations(self, x: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return accelerations (N, 3) [m/s^2]: forces over masses, zero for fixed particles."""
        return np.where(self.fixed, 0.0, 1.0 / self.masses)[:, None] * self.forces(x, v)

    def energy(self, x: np.ndarray, v: np.ndarray) -> tuple[float, float, float]:
        """Return the energies [J]: kinetic, elastic, and of gravity with zero at the origin.

        Fixed particles have none.
        """
        free = np.where(self.fixed, 0.0, self.masses)
        kinetic = 0.5 * float((free * (v * v).sum(axis=1)).sum())
        spring = 0.5 * float((self.constant * (self.lengths(x)[0] - self.rest_length) ** 2).sum())
        if self.bending is not None:
            spring += 0.5 * float((x * (self.bending @ x)).sum())
        return kinetic, spring, -float((free * (x @ np.asarray(self.gravity))).sum())

    def fastest(self) -> float:
        """Return an upper bound of the angular frequency [rad/s]: twice the stiffest row sum of M^-1 K (Gershgorin)."""
        stiffness = 2.0 * (abs(self.incidence) @ self.constant)
        if self.bending is not None:
            stiffness = stiffness + abs(self.bending).sum(axis=1)
        return float(np.sqrt((stiffness / self.masses)[~self.fixed].max(initial=0.0)))

    def stiffness(self, x: np.ndarray, tension: np.ndarray, slope: np.ndarray, clamped: bool) -> sparse.csc_array:
        """Return -d pull / dx, (3N, 3N) [N/m], of springs under `tension` (S,) [N].

        slope (S,) [N/m]: growth of the tension with length. clamped: True leaves out the negative transverse stiffness
        of compression, which makes the matrix positive semi-definite (Teran et al. 2005).
        """
        length, n = self.lengths(x)
        along = n[:, :, None] * n[:, None, :]
        transverse = (np.clip(tension, 0.0, None) if clamped else tension) / np.where(length > 0.0, length, np.inf)
        blocks = slope[:, None, None] * along + transverse[:, None, None] * (np.eye(3) - along)
        count = len(self.pairs)
        middle = sparse.bsr_array((blocks, np.arange(count), np.arange(count + 1)), shape=(3 * count, 3 * count))
        spread = sparse.kron(self.incidence, sparse.eye_array(3), format="csr")
        found = spread @ middle @ spread.T
        if self.bending is not None:
            found = found + sparse.kron(self.bending, sparse.eye_array(3))
        return found.tocsc()
