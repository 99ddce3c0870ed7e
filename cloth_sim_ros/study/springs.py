"""A system of masses and springs in float64: the equations themselves, straight from Newton and Hooke.

Particle i of mass m_i, spring s between a_s and b_s with rest length L_s, constant k_s and a dashpot c_s = tau k_s that
feels only the rate of its length. Nothing here is shared with the solver that it judges.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from scipy import sparse


@dataclass(frozen=True)
class SpringSystem:
    """Constants of motion. `fixed` particles stay where they start, whatever pulls them.

    masses (N,) [kg], fixed (N,) bool, pairs (S, 2), rest_length (S,) [m], constant (S,) [N/m], damping tau [s],
    global_damping [1/s]: a drag relative to each particle's momentum, gravity (3,) [m/s^2].
    """

    masses: np.ndarray
    fixed: np.ndarray
    pairs: np.ndarray
    rest_length: np.ndarray
    constant: np.ndarray
    damping: float = 0.0
    global_damping: float = 0.0
    gravity: tuple[float, float, float] = (0.0, 0.0, -9.81)
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
        """All kinds of `springs` (kind -> pairs, rest lengths, constants) as one system; `pins` are fixed indices."""
        pairs, rest, constant = (np.concatenate([kind[k] for kind in springs.values()]) for k in range(3))
        fixed = np.zeros(len(masses), dtype=bool)
        fixed[np.asarray(pins, dtype=np.int64)] = True
        as_float = (np.asarray(a, dtype=np.float64) for a in (masses, rest, constant))
        masses, rest, constant = as_float
        return cls(masses, fixed, np.asarray(pairs, dtype=np.int64), rest, constant, **more)

    def lengths(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Lengths (S,) [m] and unit directions (S, 3) of the springs at positions x (N, 3); no length: no direction."""
        edge = x[self.pairs[:, 1]] - x[self.pairs[:, 0]]
        length = np.sqrt(np.einsum("ij,ij->i", edge, edge))
        return length, edge / np.where(length > 0.0, length, 1.0)[:, None]

    def strains(self, x: np.ndarray) -> np.ndarray:
        """(length - rest) / rest of every spring, (S,); x may be (..., N, 3)."""
        edge = x[..., self.pairs[:, 1], :] - x[..., self.pairs[:, 0], :]
        return np.linalg.norm(edge, axis=-1) / self.rest_length - 1.0

    def forces(self, x: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Forces (N, 3) [N] of springs, dashpots, gravity and global damping, on fixed particles as well."""
        length, n = self.lengths(x)
        tension = self.constant * (length - self.rest_length)
        if self.damping > 0.0:
            rate = np.einsum("ij,ij->i", n, v[self.pairs[:, 1]] - v[self.pairs[:, 0]])
            tension = tension + self.damping * self.constant * rate
        pull = -(self.incidence @ (tension[:, None] * n))
        return pull + self.masses[:, None] * (np.asarray(self.gravity) - self.global_damping * v)

    def accelerations(self, x: np.ndarray, v: np.ndarray) -> np.ndarray:
        """(N, 3) [m/s^2]: forces over masses, zero for fixed particles."""
        return np.where(self.fixed, 0.0, 1.0 / self.masses)[:, None] * self.forces(x, v)

    def energy(self, x: np.ndarray, v: np.ndarray) -> tuple[float, float, float]:
        """(kinetic, of the springs, of gravity with zero at the origin) [J]; fixed particles carry none."""
        free = np.where(self.fixed, 0.0, self.masses)
        kinetic = 0.5 * float((free * (v * v).sum(axis=1)).sum())
        spring = 0.5 * float((self.constant * (self.lengths(x)[0] - self.rest_length) ** 2).sum())
        return kinetic, spring, -float((free * (x @ np.asarray(self.gravity))).sum())

    def fastest(self) -> float:
        """An upper bound of the highest angular frequency [rad/s]: twice the stiffest row sum of M^-1 K
        (Gershgorin)."""
        stiffness = abs(self.incidence) @ self.constant
        return float(np.sqrt(2.0 * (stiffness / self.masses)[~self.fixed].max(initial=0.0)))

    def jacobian(self, x: np.ndarray, v: np.ndarray, step: float, clamped: bool = False) -> sparse.csc_array:
        """-d forces / dx, (3N, 3N) [N/m], where v = (x - x_before) / step moves along with x; step inf: statics.

        clamped: compression's negative transverse stiffness and the dashpot's geometric terms are left out, which makes
        it positive semi-definite (Teran et al. 2005).
        """
        length, n = self.lengths(x)
        along = n[:, :, None] * n[:, None, :]
        across = np.eye(3) - along
        slack = 1.0 - self.rest_length / np.where(length > 0.0, length, np.inf)
        transverse = self.constant * (np.clip(slack, 0.0, None) if clamped else slack)
        blocks = (self.constant * (1.0 + self.damping / step))[:, None, None] * along + transverse[
            :, None, None
        ] * across
        if self.damping > 0.0 and not clamped:
            w = v[self.pairs[:, 1]] - v[self.pairs[:, 0]]
            aside = np.einsum("ijk,ik->ij", across, w)
            turn = np.einsum("ij,ij->i", n, w)[:, None, None] * across + n[:, :, None] * aside[:, None, :]
            blocks += (self.damping * self.constant / np.where(length > 0.0, length, np.inf))[:, None, None] * turn
        count = len(self.pairs)
        middle = sparse.bsr_array((blocks, np.arange(count), np.arange(count + 1)), shape=(3 * count, 3 * count))
        spread = sparse.kron(self.incidence, sparse.eye_array(3), format="csr")
        drag = sparse.diags_array(np.repeat(self.masses * self.global_damping / step, 3))
        return (spread @ middle @ spread.T + drag).tocsc()
