# SPDX-License-Identifier: Apache-2.0
"""Reading objects: their structure, and the state of their particles."""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

from cloth_sim_ros.sim.access.loads import Loads
from cloth_sim_ros.sim.arrays.state import Arrays
from cloth_sim_ros.sim.engine.bodies import Bodies
from cloth_sim_ros.sim.features.seams.arrays import BROKEN
from cloth_sim_ros.sim.input.checks import named, worlds_of
from cloth_sim_ros.sim.topology import KINDS


class Queries:
    """Reads objects by name; methods that read the state wait for the device.

    Raises ValueError for a name or a world that does not exist.
    """

    _bodies: Bodies
    _loads: dict[str, Loads]  # forces and torques on "colliders" and "handles"

    def masses(self, name: str, world: int = 0) -> np.ndarray:
        """Masses (N,) float64 [kg] in one world, pinned particles included."""
        self._bodies.topology(name)
        return self._bodies.batch[name].masses.of(self._bodies.batch[name].index[name], self._bodies.one(world))

    def triangles(self, name: str, world: int = 0) -> np.ndarray:
        """Triangles (T, 3) int32, counter-clockwise seen from their normals; none for a rope.

        A sheet that tears returns the triangles that are left in one world.
        """
        if self.tears(name):
            rows = self.panels_left(name, self._bodies.one(world)).numpy()
            return rows[rows[:, 0] != rows[:, 1]]
        return self._bodies.topology(name).triangles.astype(np.int32)

    def tears(self, name: str) -> bool:
        """Return True if an object can tear."""
        return self._bodies.topology(name).tear_strain > 0.0

    def panels_left(self, name: str, world: int) -> wp.array:
        """Triangles (T,) vec3i of a sheet that tears, on the device; failed triangles have three equal corners."""
        batch = self._bodies.batch[name]
        return batch.worlds[world].state.tearing.panels[batch.panels(name)]

    def rest_positions(self, name: str, world: int = 0) -> np.ndarray:
        """Rest positions (N, 3) float32 [m] in one world, at the object's place in the scene."""
        return self._bodies.topology(name).rest_in(self._bodies.one(world)).astype(np.float32)

    def springs(self, name: str, world: int = 0) -> dict[str, tuple[np.ndarray, np.ndarray, np.ndarray]]:
        """Return kind -> (pairs, rest_length, constant) of the springs as they are now.

        pairs is (S, 2) int, rest_length (S,) [m], and constant (S,) [N/m], infinite for rigid springs. The springs of a
        mesh with a shear_compliance are coupled, so that they alone do not say its energy.
        """
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
        """Return the stitches of a seam in one world, in the order of its lines.

        Args:
            seam: The name of a seam.
            world: The number of the world.

        Returns:
            gaps (E, 3) [m], from the point of the second object to that of the first; forces (E, 3) [N] on the point of
            the first object in the last substep; and broken (E,) of bool.

        Raises:
            ValueError: There is no such seam.
        """
        name, start = named(self._bodies.scene.seams, seam, "seam").first, 0
        for each in self._bodies.topology(name).stitches:
            if each.seam == seam:
                break
            start += len(each.shares)
        batch, world = self._bodies.batch[name], self._bodies.one(world)
        begin = batch.stitches(name).start + start
        rows = slice(begin, begin + len(each.shares))
        slid, state, _ = batch.part("stitches", rows, world).numpy().reshape(-1, 3).T
        first, second = (self._fine_positions(thing, world) for thing in (name, each.other))
        points = _points(first, each.particles[:, :2], each.shares[:, 0])
        if each.slides:
            gaps = _off_rope(points, second, each.particles[:, 2] + each.shares[:, 1] + slid)
        else:
            gaps = points - _points(second, each.particles[:, 2:], each.shares[:, 1])
        broken = state == BROKEN
        forces = np.where(broken[:, None], 0.0, batch.part("stitch_forces", rows, world).numpy().reshape(-1, 3))
        return gaps, forces, broken

    def _fine_positions(self, name: str, world: int) -> np.ndarray:
        """Positions (N, 3) float64 [m] of an object's particles."""
        read = self._bodies.batch[name].read_rows
        return sum(read(part, name, world)[0, :, :3].astype(np.float64) for part in ("positions", "position_lo"))

    def torn(self, name: str, world: int = 0) -> dict[str, np.ndarray]:
        """Return kind -> (S,) bool, True for each of `springs` that failed in one world.

        Raises ValueError if the object does not tear.
        """
        if not self.tears(name):
            raise ValueError(f"{name} does not tear; allowed is an object with a tear_strain above 0")
        batch = self._bodies.batch[name]
        return {kind: rows[0] for kind, rows in batch.torn.read(batch.index[name], self._bodies.one(world)).items()}

    def positions(self, name: str, world: Any = 0) -> np.ndarray:
        """Positions (N, 3) float32 [m] in one world, or (k, N, 3) in several (None: all), in one copy."""
        return self._read("positions", name, world)

    def velocities(self, name: str, world: Any = 0) -> np.ndarray:
        """Velocities (N, 3) float32 [m/s] in one world, or (k, N, 3) in several (None: all), in one copy."""
        return self._read("velocities", name, world)

    def _read(self, what: str, name: str, world: Any) -> np.ndarray:
        self._bodies.topology(name)
        some = self._bodies.some(world)
        rows = self._bodies.batch[name].read_rows(what, name, some if isinstance(some, int) else None)[:, :, :3]
        return np.ascontiguousarray(rows[0] if isinstance(some, int) else rows[worlds_of(some)])

    def wrench(self, collider: str, world: int = 0) -> tuple[np.ndarray, np.ndarray]:
        """Force (3,) [N] and torque (3,) [N m] of all objects on a collider, about its origin, in world axes.

        Both are means over the last frame. The torque uses particle positions at the end of the frame. The weight of a
        cloth that lies on the collider points down.
        """
        row = named(self._bodies.collider_row, collider, "collider")
        load = self.wrenches(world)[row].astype(np.float64)
        return load[:3], load[3:]

    def wrenches(self, world: int = 0) -> np.ndarray:
        """Wrenches of all rows of colliders (K, 6) float32: force [N], then torque [N m], see `wrench`."""
        return self._loads["colliders"].read(world)

    def device_arrays(self, name: str, world: int = 0, writes: bool = True) -> tuple[Arrays, slice, wp.Device]:
        """Return the arrays of an object's batch in one world, the slice of its particles in them, and the device.

        They are valid until `builds` changes. Method auto may rebuild them when live parameters or positions are set.
        A caller that `writes` to them wakes bodies at rest.
        """
        self._bodies.topology(name)
        if writes:
            self._bodies.wake()
        batch = self._bodies.batch[name]
        return batch.worlds[self._bodies.one(world)], batch.span(name), self._bodies.warp_device


def _points(places: np.ndarray, particles: np.ndarray, shares: np.ndarray) -> np.ndarray:
    first, second = places[particles[:, 0]], places[particles[:, 1]]
    return first + shares[:, None] * (second - first)


def _off_rope(points: np.ndarray, rope: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Vectors (E, 3) from a rope's particles (N, 3) to points, from the nearest of the segments around `at` (E,)."""
    segments = np.clip(at.astype(int)[:, None] + (-1, 0, 1), 0, len(rope) - 2)
    along, off = rope[segments + 1] - rope[segments], points[:, None] - rope[segments]
    square = np.maximum((along * along).sum(axis=2), 1e-300)
    gaps = off - np.clip((off * along).sum(axis=2) / square, 0.0, 1.0)[..., None] * along
    return gaps[np.arange(len(gaps)), np.linalg.norm(gaps, axis=2).argmin(axis=1)]
