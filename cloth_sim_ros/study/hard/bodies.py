# SPDX-License-Identifier: Apache-2.0
"""Bodies of the hard cases, and their energy, written from the equations and not from the solver."""

from __future__ import annotations

import math

import numpy as np
from scipy import sparse
from scipy.optimize import minimize

from cloth_sim_ros.sim import Cloth, Rope, Simulation
from cloth_sim_ros.sim.topology import build

BODY = "body"
SEGMENTS = 24
GRAVITY = 9.81
KINDS = ("sheet", "sheet with bending springs", "sheet with bending", "rope", "rope with bending")


def is_rope(kind: str) -> bool:
    """Return True if a kind of body is a rope."""
    return kind.startswith("rope")


def make_body(kind: str, compliance: float = 1e-4, ratio: float = 0.0, pins: str = "hung", **fields) -> Cloth | Rope:
    """Make a sheet of 0.9 m with springs of 0.1 m, or a rope of 1 m, of 0.2 kg, in the plane z = 0 around the origin.

    compliance [m/N]: that of each of its springs. ratio: mass of a load at the end of a rope over its own mass. pins:
    "hung" by two corners or one end, "both" sides or ends, or "none".
    """
    if is_rope(kind):
        masses = np.full(SEGMENTS + 1, 0.2 / SEGMENTS)
        masses[[0, -1]] *= 0.5
        masses[-1] += 0.2 * ratio
        return Rope(
            start=(-0.5, 0.0, 0.0),
            end=(0.5, 0.0, 0.0),
            segments=SEGMENTS,
            particle_masses=masses,
            stretch_compliance=compliance * SEGMENTS,
            bend_compliance=1e2 if kind == "rope with bending" else None,
            pins={"hung": "start", "both": "both", "none": None}[pins],
            **{{"thickness": "radius"}.get(name, name): value for name, value in fields.items()},
        )
    bending = {"sheet with bending springs": ("springs", 1e-1), "sheet with bending": ("dihedral", 1e3)}
    how, bend_compliance = bending.get(kind, ("springs", None))
    sides = tuple(int(i) for i in np.concatenate([np.arange(0, 100, 10), np.arange(9, 100, 10)]))
    return Cloth(
        resolution=(10, 10),
        size=(0.9, 0.9),
        mass=0.2,
        stretch_compliance=compliance,
        shear_compliance=2.0 * compliance,
        bending=how,
        bend_compliance=bend_compliance,
        pins={"hung": "corners", "both": sides, "none": None}[pins],
        **fields,
    )


def bends_by_angles(body: Cloth | Rope) -> bool:
    """Return True if a body is a rope that resists bending, which explicit steps lack."""
    return isinstance(body, Rope) and body.bend_compliance is not None


def inverse_mass(sim: Simulation) -> np.ndarray:
    """Return the inverse mass of every particle (N,) [1/kg], 0 for pinned ones."""
    arrays, span, _ = sim.device_arrays(BODY)
    return arrays.state.positions[span].numpy()[:, 3].astype(np.float64)


def substep_of(sim: Simulation) -> float:
    """Return the length of a substep of the body [s]."""
    return sim.settings.frame_dt / sim.choices[BODY].substeps


class Energy:
    """Kinetic, elastic and gravitational energy [J] of the one body of a simulation, in float64."""

    def __init__(self, sim: Simulation) -> None:
        self._sim, self._body = sim, sim.scene.objects[BODY]
        self._masses, self.inverse_mass = sim.masses(BODY), inverse_mass(sim)
        kinds = sim.springs(BODY)
        self.pairs, self.rest, constant = (np.concatenate([kind[k] for kind in kinds.values()]) for k in range(3))
        self._rigid, self._constant = np.isinf(constant), constant
        self._h = substep_of(sim)
        self._bends = _bending_matrix(sim)
        self._stretch = np.repeat([name != "bending" for name in kinds], [len(kind[1]) for kind in kinds.values()])

    def lengths(self, x: np.ndarray) -> np.ndarray:
        """Return the lengths of all springs (S,) [m]."""
        return np.linalg.norm(x[self.pairs[:, 1]] - x[self.pairs[:, 0]], axis=1)

    def strain(self, x: np.ndarray) -> float:
        """Return the RMS strain [-] of structural and shear springs."""
        return float(np.sqrt((self._strains(x) ** 2).mean()))

    def _strains(self, x: np.ndarray) -> np.ndarray:
        return np.abs(self.lengths(x) / self.rest - 1.0)[self._stretch]

    def fold(self, x: np.ndarray) -> float:
        """Return the strain of the equilibrium of springs and weight downhill from x, by L-BFGS in float64.

        Nothing keeps a sheet from passing through itself. A crumpled sheet may come to rest in a fold in which its
        springs hold one another strained, as a sheet of real springs would. The strain is 0 if only the rest shape
        holds it.
        """
        free = self.inverse_mass > 0.0
        finite = np.where(self._rigid, 0.0, self._constant)
        stiffest = max(1e3 * finite.max(), 1e5) if self._rigid.any() else finite.max()
        constant = np.where(self._rigid, 1.0, finite / stiffest)
        weight = self._masses[:, None] * np.asarray(self._sim.scene.gravity) / stiffest

        def energy(moved: np.ndarray) -> tuple[float, np.ndarray]:
            at = x.copy()
            at[free] = moved.reshape(-1, 3)
            edge, length = at[self.pairs[:, 1]] - at[self.pairs[:, 0]], np.maximum(self.lengths(at), 1e-12)
            pull = (constant * (1.0 - self.rest / length))[:, None] * edge
            force = weight.copy()
            np.add.at(force, self.pairs[:, 0], pull)
            np.add.at(force, self.pairs[:, 1], -pull)
            value = 0.5 * float(constant @ (length - self.rest) ** 2) - float((weight * at).sum())
            return value, -force[free].ravel()

        options = {"maxiter": 5000, "maxfun": 10000, "ftol": 0.0, "gtol": 1e-9}
        found = minimize(energy, x[free].ravel(), jac=True, method="L-BFGS-B", options=options)
        at = x.copy()
        at[free] = found.x.reshape(-1, 3)
        return self.strain(at)

    def at_start(self, x: np.ndarray, v: np.ndarray) -> tuple[float, float]:
        """Return the two energies [J] of `of`, with all that springs can release.

        A rigid body has to regain its shape within one substep; the kinetic energy of that counts.
        """
        kinetic = 0.5 * float(self._masses @ (v * v).sum(1))
        constant = np.where(self._rigid, 0.0, self._constant)
        elastic = 0.5 * float(constant @ (self.lengths(x) - self.rest) ** 2) + self._bending(x)
        if self._rigid.any():
            elastic += 0.5 * float(self._masses @ ((x - self._sim.rest_positions(BODY)) ** 2).sum(1)) / self._h**2
        return kinetic + elastic, self.height(x)

    def of(self, x: np.ndarray, v: np.ndarray, residual: float = 0.0) -> tuple[float, float]:
        """Return kinetic plus elastic energy, and the energy of gravity with zero at the origin [J].

        residual [m]: error that iterations leave in C + compliance x force. A spring of constant k that is C too long
        then pulls by no more than k C and by no less than k (|C| - residual). Only force releases energy, so a sweep
        that leaves a residual acts as a softer spring. A first-order step is x' = 2 p x - p x_before, which keeps (1 -
        p) x^2 + p (x - x_before)^2. There 1 - p is below that of the spring's own constant.
        """
        if self._sim.choices[BODY].method == "verlet":
            v = v + 0.5 * self._h * self._acceleration(x)  # leapfrog's velocities are half a substep old
        kinetic = 0.5 * float(self._masses @ (v * v).sum(1))
        pulled = np.maximum(np.abs(self.lengths(x) - self.rest) - residual, 0.0)
        elastic = 0.5 * float(np.where(self._rigid, 0.0, self._constant) @ pulled**2) + self._bending(x)
        return kinetic + elastic, self.height(x)

    def height(self, x: np.ndarray) -> float:
        """Return the energy of gravity with zero at the origin [J]."""
        return float(self._masses @ -(x @ np.asarray(self._sim.scene.gravity)))

    def _acceleration(self, x: np.ndarray) -> np.ndarray:
        edge = x[self.pairs[:, 1]] - x[self.pairs[:, 0]]
        length = np.linalg.norm(edge, axis=1)
        pull = (self._constant * (1.0 - self.rest / np.maximum(length, 1e-12)))[:, None] * edge
        force = np.zeros_like(x)
        np.add.at(force, self.pairs[:, 0], pull)
        np.add.at(force, self.pairs[:, 1], -pull)
        force -= self._bends @ x
        return (self.inverse_mass > 0.0)[:, None] * (force / self._masses[:, None] + self._sim.scene.gravity)

    def momentum(self, v: np.ndarray) -> float:
        """Return the momentum along z [kg m/s]."""
        return float(self._masses @ v[:, 2])

    def scale(self) -> float:
        """Return the energy that gravity releases over a metre [J]."""
        return float(self._masses.sum() * np.linalg.norm(self._sim.scene.gravity))

    def longest_step(self, damping: float) -> float:
        """Return the longest substep [s] at which leapfrog is stable: w^2 (h^2 + 2 h tau) < 4, tau = `damping` [s].

        It holds near the rest shape. With wind, which crumples the body, it holds in any shape, as if all springs were
        collinear.
        """
        x = self._sim.rest_positions(BODY).astype(np.float64)
        n = (x[self.pairs[:, 1]] - x[self.pairs[:, 0]]) / self.lengths(x)[:, None]
        if self._sim.scene.wind is not None:
            n = np.ones((len(n), 1))
        root = np.sqrt(np.repeat(self.inverse_mass, n.shape[1]))
        rows = np.zeros((len(self.pairs), len(x), n.shape[1]))
        index = np.arange(len(self.pairs))
        rows[index, self.pairs[:, 0]], rows[index, self.pairs[:, 1]] = -n, n
        scaled = np.sqrt(self._constant)[:, None] * rows.reshape(len(index), -1) * root
        square = float(np.linalg.norm(scaled, 2)) ** 2
        return 4.0 / square / (damping + math.sqrt(damping**2 + 4.0 / square))

    def rounding_heat(self) -> float:
        """Return the kinetic energy per mass and second [m^2/s^3] that float32 lengths add in explicit steps."""
        highest = 2.0 / self.longest_step(0.0)
        return (float(self.rest.mean()) * 2.0**-24) ** 2 / 3.0 * highest**3 / 8.0

    def _bending(self, x: np.ndarray) -> float:
        """Return the energy of bending [J], of the share of the rigidity that acts."""
        return 0.5 * self._sim.choices[BODY].bending_share * float((x * (self._bends @ x)).sum())


def _bending_matrix(sim: Simulation) -> sparse.csr_array:
    """Return the matrix (N, N) [N/m] whose quadratic form is twice the energy of bending [J].

    It is that of the joints of a rope, or the plate operator of a flat sheet.
    """
    body = sim.scene.objects[BODY]
    count = len(sim.masses(BODY))
    if not body.bend_compliance or (isinstance(body, Cloth) and body.bending == "springs"):
        return sparse.csr_array((count, count))
    if isinstance(body, Rope):
        turns = sparse.diags_array([1.0, -2.0, 1.0], offsets=[0, 1, 2], shape=(count - 2, count))
        return sparse.csr_array(turns.T @ turns) * (SEGMENTS**3 / body.bend_compliance)
    plate = build(body, BODY, False).plate
    rows = np.repeat(np.arange(count), plate.neighbours.shape[1])
    weights = sparse.csr_array((plate.weights.ravel(), (rows, plate.neighbours.ravel())), (count, count))
    return (weights - sparse.diags_array(weights.sum(axis=1))) / body.bend_compliance
