# SPDX-License-Identifier: Apache-2.0
"""Masses of a batch's bodies in each world: live numbers, and the particle masses that follow from them."""

from __future__ import annotations

import numpy as np
import warp as wp

from cloth_sim_ros.sim.arrays.live_array import LiveArray
from cloth_sim_ros.sim.input.checks import WorldSelection, worlds_of
from cloth_sim_ros.sim.kernels.compiled import compiled
from cloth_sim_ros.sim.topology import Topology

_SAME = 1e-12  # relative difference below which masses are exactly those of the topology
BYTES_A_PARTICLE = 8  # memory per particle and world [bytes]: a mass and its inverse
MASSES = {"mass": 0, "end_mass": 1}  # column of each live number


@compiled
def weigh(
    whole: wp.array(dtype=wp.float64),
    own: wp.array(dtype=wp.float64),
    shares: wp.array2d(dtype=wp.float64),
    chosen: wp.array(dtype=int),
    first: int,
    masses: wp.array2d(dtype=float),
    inverse: wp.array2d(dtype=float),
):
    """Compute the mass of particle i of a body in world chosen[k], and its inverse, 0 if it is pinned.

    whole: masses of the topology [kg], negative for pinned particles. own: the same without the load, positive. shares:
    rows of the factor of the own masses, the load [kg], and 1 if both are those of the topology.
    """
    k, i = wp.tid()
    w = chosen[k]
    mass = wp.abs(whole[i])
    if shares[k, 2] == wp.float64(0.0):
        mass = own[i] * shares[k, 0]
        if i == whole.shape[0] - 1:
            mass += shares[k, 1]
    masses[w, first + i] = float(mass)
    inverse[w, first + i] = wp.where(whole[i] < wp.float64(0.0), 0.0, float(wp.float64(1.0) / mass))


@compiled
def put_inverse(inverse: wp.array2d(dtype=float), chosen: wp.array(dtype=int), positions: wp.array2d(dtype=wp.vec4)):
    """Write the inverse mass of particle i of world chosen[k], if it is free."""
    k, i = wp.tid()
    w = chosen[k]
    p = positions[w, i]
    if p[3] > 0.0:
        positions[w, i] = wp.vec4(p[0], p[1], p[2], inverse[w, i])


class Masses:
    """Mass and end mass [kg] of a batch's bodies in every world, and the particle masses on the device.

    spans: slices of each body's particles. masses, inverse: (worlds, N) float32 [kg] and [1/kg] of all particles; the
    inverse is 0 for pinned ones. Material.largest_inverse_mass in `materials` is kept up to date.
    """

    def __init__(
        self, topologies: list[Topology], spans: list[slice], materials: LiveArray, worlds: int, device: wp.Device
    ) -> None:
        self._materials, self._device = materials, device
        self._topologies, self._spans = topologies, spans
        self._kg = np.zeros((worlds, len(topologies), len(MASSES)))
        self.masses, self.inverse = (wp.zeros((worlds, spans[-1].stop), dtype=float, device=device) for _ in range(2))
        self._own = [np.append(t.masses[:-1], t.masses[-1] - t.load) for t in topologies]  # without the load [kg]
        self._mass = [float(own.sum()) for own in self._own]
        whole = [np.where(t.pinned, -t.masses, t.masses) for t in topologies]
        self._given = [
            tuple(wp.array(rows, dtype=wp.float64, device=device) for rows in each)
            for each in zip(whole, self._own, strict=True)
        ]
        for b, topology in enumerate(topologies):
            self.write(b, None, np.array([self._mass[b], topology.load]))

    def read(self, b: int, world: WorldSelection) -> np.ndarray:
        """Mass and end mass (k, 2) [kg] of a body in some worlds."""
        return self._kg[worlds_of(world), b].copy()

    def of(self, b: int, world: int) -> np.ndarray:
        """Masses (N,) float64 [kg] of a body in one world."""
        topology, (mass, load) = self._topologies[b], self._kg[world, b]
        if self._same(b, self._kg[world : world + 1, b])[0]:
            return topology.masses.copy()
        masses = self._own[b] * (mass / self._mass[b])
        masses[-1] += load
        return masses

    def _same(self, b: int, kg: np.ndarray) -> np.ndarray:
        """True for rows (k, 2) of masses that are those of the body's topology."""
        return (np.abs(kg[:, 0] / self._mass[b] - 1.0) < _SAME) & (kg[:, 1] == self._topologies[b].load)

    def of_pinned(self, b: int) -> np.ndarray:
        """(N,) bool: True for pinned particles of a body."""
        return self._topologies[b].pinned

    def effective_materials(self, b: int, rows: np.ndarray, kg: np.ndarray) -> np.ndarray:
        """Convert rows (k,) of Material at masses `kg` (k, 2) to rows with equal frequencies at the topology's masses.

        The choice and the checks of methods know only the topology's masses. With a load, the particles of a rope may
        differ by several factors; the least is used, to be safe.
        """
        topology, rows = self._topologies[b], rows.copy()
        factor, last = kg[:, 0] / self._mass[b], topology.masses[-1]
        least = np.minimum(factor, (factor * (last - topology.load) + kg[:, 1]) / last)
        rows["compliance"] *= np.where(self._same(b, kg), 1.0, least)[:, None]
        return rows

    def write(self, b: int, world: WorldSelection, kg: np.ndarray) -> None:
        """Set a body's masses (2,) or (k, 2) in some worlds; `put` then applies them to free particles."""
        topology, numbers = self._topologies[b], np.arange(len(self._kg), dtype=np.int32)[worlds_of(world)]
        self._kg[numbers, b] = kg
        rows = self._kg[numbers, b]
        same, factor = self._same(b, rows), rows[:, 0] / self._mass[b]
        shares = wp.array(np.column_stack([factor, rows[:, 1], same]), dtype=wp.float64, device=self._device)
        chosen = wp.array(numbers, dtype=int, device=self._device)
        inputs = [*self._given[b], shares, chosen, self._spans[b].start, self.masses, self.inverse]
        wp.launch(weigh, dim=(len(numbers), len(topology.masses)), inputs=inputs, device=self._device)
        total = topology.masses.sum()
        self._materials.write(b, world, largest_inverse_mass=np.where(same, 1.0, total / rows.sum(axis=1)))

    def put(self, b: int, world: WorldSelection, positions: list[wp.array]) -> None:
        """Write the inverse masses of a body's free particles into arrays (worlds, N) of positions."""
        numbers = np.arange(len(self._kg), dtype=np.int32)[worlds_of(world)]
        chosen = wp.array(numbers, dtype=int, device=self._device)
        for rows in positions:
            inputs = [self.inverse[:, self._spans[b]], chosen, rows]
            wp.launch(put_inverse, dim=(len(numbers), rows.shape[1]), inputs=inputs, device=self._device)

    def mirrors(self) -> dict[str, np.ndarray]:
        """Name -> the host array of mass and end mass; call `touch` after writing to it."""
        return {"kg": self._kg}

    def touch(self) -> None:
        """Apply changes to the array of `mirrors`. Particles keep their masses until `put`."""
        for b in range(len(self._topologies)):
            self.write(b, None, self.read(b, None))
