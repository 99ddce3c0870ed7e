# SPDX-License-Identifier: Apache-2.0
"""Reading objects: their structure, and the state of their particles."""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

from cloth_sim_ros.sim.access.loads import Loads
from cloth_sim_ros.sim.access.seams import read_stitches
from cloth_sim_ros.sim.arrays.state import Arrays
from cloth_sim_ros.sim.engine.bodies import Bodies
from cloth_sim_ros.sim.input.checks import named, worlds_of
from cloth_sim_ros.sim.topology import KINDS


class Queries:
    """Reads objects by name; methods that read the state wait for the device.

    Raises ValueError for a name or a world that does not exist. loads: forces and torques on colliders.
    """

    def __init__(self, bodies: Bodies) -> None:
        self._bodies = bodies
        self.loads = Loads(bodies, "colliders", bodies.colliders.array.shape[1])

    def masses(self, name: str, world: int = 0) -> np.ndarray:
        """See Simulation.masses."""
        self._bodies.topology(name)
        return self._bodies.batch[name].masses.of(self._bodies.batch[name].index[name], self._bodies.one(world))

    def triangles(self, name: str, world: int = 0) -> np.ndarray:
        """See Simulation.triangles."""
        if self.tears(name):
            rows = self.panels_left(name, self._bodies.one(world)).numpy()
            return rows[rows[:, 0] != rows[:, 1]]
        return self._bodies.topology(name).triangles.astype(np.int32)

    def tears(self, name: str) -> bool:
        """See Simulation.tears."""
        return self._bodies.topology(name).tear_strain > 0.0

    def panels_left(self, name: str, world: int) -> wp.array:
        """See Simulation.panels_left."""
        batch = self._bodies.batch[name]
        return batch.worlds[world].state.tearing.panels[batch.panels(name)]

    def rest_positions(self, name: str, world: int = 0) -> np.ndarray:
        """See Simulation.rest_positions."""
        return self._bodies.topology(name).rest_in(self._bodies.one(world)).astype(np.float32)

    def springs(self, name: str, world: int = 0) -> dict[str, tuple[np.ndarray, np.ndarray, np.ndarray]]:
        """See Simulation.springs."""
        topo, batch = self._bodies.topology(name), self._bodies.batch[name]
        kinds = dict(topo.springs)
        if topo.chain is not None:
            kinds["structural"] = topo.chain
        scale = topo.scales_in(self._bodies.one(world))
        compliance = batch.materials.read(batch.index[name], world)["compliance"][0]
        found = {}
        for kind, elements in kinds.items():
            yields = elements.scale if len(topo.triangles) else elements.scale * scale
            with np.errstate(divide="ignore"):
                constant = 1.0 / (float(compliance[KINDS.index(kind)]) * yields)
            found[kind] = (elements.particles.astype(np.int64), elements.rest * scale, constant)
        return found

    def stitches(self, seam: str, world: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """See Simulation.stitches."""
        return read_stitches(self._bodies, seam, world)

    def torn(self, name: str, world: int = 0) -> dict[str, np.ndarray]:
        """See Simulation.torn."""
        if not self.tears(name):
            raise ValueError(f"{name} does not tear; allowed is an object with a tear_strain above 0")
        batch = self._bodies.batch[name]
        return {kind: rows[0] for kind, rows in batch.torn.read(batch.index[name], self._bodies.one(world)).items()}

    def positions(self, name: str, world: Any = 0) -> np.ndarray:
        """See Simulation.positions."""
        return self._rows("positions", name, world)

    def velocities(self, name: str, world: Any = 0) -> np.ndarray:
        """See Simulation.velocities."""
        return self._rows("velocities", name, world)

    def _rows(self, what: str, name: str, world: Any) -> np.ndarray:
        self._bodies.topology(name)
        some = self._bodies.some(world)
        rows = self._bodies.batch[name].read_rows(what, name, some if isinstance(some, int) else None)[:, :, :3]
        return np.ascontiguousarray(rows[0] if isinstance(some, int) else rows[worlds_of(some)])

    def wrench(self, collider: str, world: int = 0) -> tuple[np.ndarray, np.ndarray]:
        """See Simulation.wrench."""
        row = named(self._bodies.collider_row, collider, "collider")
        load = self.wrenches(world)[row].astype(np.float64)
        return load[:3], load[3:]

    def wrenches(self, world: int = 0) -> np.ndarray:
        """See Simulation.wrenches."""
        return self.loads.read(world)

    def device_arrays(self, name: str, world: int = 0, writes: bool = True) -> tuple[Arrays, slice, wp.Device]:
        """See Simulation.device_arrays."""
        self._bodies.topology(name)
        if writes:
            self._bodies.wake()
        batch = self._bodies.batch[name]
        return batch.worlds[self._bodies.one(world)], batch.span(name), self._bodies.warp_device
