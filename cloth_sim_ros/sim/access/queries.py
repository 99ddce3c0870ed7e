# SPDX-License-Identifier: Apache-2.0
"""What is read of objects: what they are made of, and where their particles are."""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

from cloth_sim_ros.sim.access.loads import Loads
from cloth_sim_ros.sim.arrays.state import Arrays
from cloth_sim_ros.sim.engine.bodies import Bodies
from cloth_sim_ros.sim.input.checks import names_of, worlds_of
from cloth_sim_ros.sim.topology import KINDS


class Queries:
    """What can be asked of an object by its name; whatever reads the state waits for the device.

    Raises ValueError for a name or a world that does not exist. loads: what colliders feel.
    """

    def __init__(self, bodies: Bodies) -> None:
        self._bodies = bodies
        self.loads = Loads(bodies, "colliders", bodies.colliders.array.shape[1])

    def masses(self, name: str, world: int = 0) -> np.ndarray:
        """Masses (N,) float64 [kg] in one world, pinned particles included."""
        self._bodies.topology(name)
        return self._bodies.batch[name].masses.of(self._bodies.batch[name].index[name], self._bodies.one(world))

    def triangles(self, name: str, world: int = 0) -> np.ndarray:
        """Triangles (T, 3) int32, counter-clockwise seen from their normals; none for a rope. Of a sheet that tears,
        those that are left in one world."""
        if self.tears(name):
            rows = self.panels_left(name, self._bodies.one(world)).numpy()
            return rows[rows[:, 0] != rows[:, 1]]
        return self._bodies.topology(name).triangles.astype(np.int32)

    def tears(self, name: str) -> bool:
        """Whether an object tears."""
        return self._bodies.topology(name).tear_strain > 0.0

    def panels_left(self, name: str, world: int) -> wp.array:
        """The triangles (T,) vec3i of a sheet that tears on the device; those that failed have three equal corners."""
        batch = self._bodies.batch[name]
        return batch.worlds[world].state.panels[batch.panels(name)]

    def rest_positions(self, name: str, world: int = 0) -> np.ndarray:
        """Rest positions (N, 3) float32 [m] in one world, where the scene puts the object."""
        return self._bodies.topology(name).rest_in(self._bodies.one(world)).astype(np.float32)

    def springs(self, name: str, world: int = 0) -> dict[str, tuple[np.ndarray, np.ndarray, np.ndarray]]:
        """Kind -> (pairs (S, 2) int, rest_length (S,) [m], constant (S,) [N/m], infinite where rigid), as they are
        now."""
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

    def torn(self, name: str, world: int = 0) -> dict[str, np.ndarray]:
        """Kind -> (S,) bool, which of `springs` failed in one world. Raises ValueError where the object does not
        tear."""
        if not self.tears(name):
            raise ValueError(f"{name} does not tear; allowed is an object with a tear_strain above 0")
        batch = self._bodies.batch[name]
        return {kind: rows[0] for kind, rows in batch.torn.read(batch.index[name], self._bodies.one(world)).items()}

    def positions(self, name: str, world: Any = 0) -> np.ndarray:
        """Positions (N, 3) float32 [m] in one world, or (k, N, 3) in several, all for None, in one copy."""
        return self._rows("positions", name, world)

    def velocities(self, name: str, world: Any = 0) -> np.ndarray:
        """Velocities (N, 3) float32 [m/s] in one world, or (k, N, 3) in several, all for None, in one copy."""
        return self._rows("velocities", name, world)

    def _rows(self, what: str, name: str, world: Any) -> np.ndarray:
        self._bodies.topology(name)
        some = self._bodies.some(world)
        rows = self._bodies.batch[name].read_rows(what, name, some if isinstance(some, int) else None)[:, :, :3]
        return np.ascontiguousarray(rows[0] if isinstance(some, int) else rows[worlds_of(some)])

    def wrench(self, collider: str, world: int = 0) -> tuple[np.ndarray, np.ndarray]:
        """Force (3,) [N] and torque (3,) [N m] about its origin on a collider by all objects, in world axes.

        They are means over the last frame; the torque takes particles where the frame leaves them. The weight of a
        cloth that lies on the collider points down.
        """
        rows = self._bodies.collider_row
        if collider not in rows:
            raise ValueError(f"there is no collider {collider!r}; allowed is {names_of(rows)}")
        load = self.wrenches(world)[rows[collider]].astype(np.float64)
        return load[:3], load[3:]

    def wrenches(self, world: int = 0) -> np.ndarray:
        """The same of all rows of colliders (K, 6) float32: force [N], then torque [N m]."""
        return self.loads.read(world)

    def device_arrays(self, name: str, world: int = 0) -> tuple[Arrays, slice, wp.Device]:
        """The arrays of the batch that holds an object in one world, where its particles lie in them, their device.

        They hold until `builds` changes: method auto may build anew when live parameters or positions are set.
        """
        self._bodies.topology(name)
        batch = self._bodies.batch[name]
        return batch.worlds[self._bodies.one(world)], batch.span(name), self._bodies.warp_device
