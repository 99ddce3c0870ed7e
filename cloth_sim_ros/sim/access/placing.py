# SPDX-License-Identifier: Apache-2.0
"""Placing objects: positions and velocities from the user, or from another simulation."""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

from cloth_sim_ros.sim.access.hands import Hands
from cloth_sim_ros.sim.access.queries import Queries
from cloth_sim_ros.sim.access.starts import Depth, is_strained, off_symmetry, way_out
from cloth_sim_ros.sim.access.tensors import MOST
from cloth_sim_ros.sim.arrays.state import ColliderMotion
from cloth_sim_ros.sim.input.checks import WorldSelection, finite_array, worlds_of
from cloth_sim_ros.sim.topology import Topology

_INSIDE = 1.01  # multiple of the thickness; a surface that lies deeper is inside a collider, as in the node's log


class Placing(Queries, Hands):
    """Moves the objects of a running simulation."""

    moved: dict[str, tuple[float, float]]

    def _leave_colliders(self) -> dict[str, tuple[float, float]]:
        """Let objects that start inside rigid colliders start outside them from the next restart on.

        Returns name -> (depth, distance moved) [m]. With object contact, several objects stay where they are, as one
        could be moved into another. See starts.way_out.
        """
        bodies, found = self._bodies, {}
        rows = bodies.colliders.mirrors()["rows"][0]
        rigid = rows[(rows["shape"] >= 0) & (rows["compliance"] == 0.0)]
        if not len(rigid) or (bodies.scene.object_contact and len(bodies.batch) > 1):
            return found
        colliders = wp.array(rigid, dtype=ColliderMotion, device=bodies.warp_device)
        for name, topology in bodies.elastic.items():
            depth = Depth(bodies.batch[name], name, colliders)
            deep, thickness = depth.at(topology.rest), float(bodies.materials_of(name, 0)["thickness"][0])
            way = way_out(topology.rest, depth, -np.array(bodies.scene.gravity)) if deep > _INSIDE * thickness else None
            if way is not None:
                found[name] = (deep, way[1])
                bodies.start_elsewhere(name, way[0])
        return found

    def set_positions(self, name: str, positions: Any, world: Any = None) -> None:
        """Move all particles to `positions`, pinned ones too; history and multipliers are cleared.

        Positions that strain a spring by more than half get a small perturbation, see starts.off_symmetry.

        Args:
            name: The object.
            positions: (N, 3) [m].
            world: The number of a world, a mask (worlds,) of bool, or None for all.

        Raises:
            ValueError: The positions have another shape, or are not finite or too large.
        """
        rows, some = self._checked_rows(name, positions, "positions"), self._bodies.some(world)
        topology = self._bodies.elastic[name]
        if topology.winch is None and self._are_strained(name, rows, some):  # particles on a drum stay there
            rows = off_symmetry(topology, rows, topology.scales_in(worlds_of(some)).min())
        self._write_positions(name, rows, some)

    def _write_positions(self, name: str, rows: np.ndarray, some: WorldSelection) -> None:
        values = wp.array(rows[None], dtype=wp.float64, device=self._bodies.warp_device)
        self._bodies.batch[name].write_positions(name, values, self._bodies.chosen(some))

    def _are_strained(self, name: str, rows: np.ndarray, some: WorldSelection) -> bool:
        """True if positions strain a spring by more than half in some of these worlds."""
        torn = self.torn(name) if self.tears(name) else {}
        topology = self._bodies.elastic[name]
        scales = np.unique(topology.scales_in(worlds_of(some)))
        # The strain of each spring is largest at its smallest or its largest rest length.
        return any(is_strained(topology, rows / scale, torn) for scale in {*scales[:1], *scales[-1:]})

    def set_velocities(self, name: str, velocities: Any, world: Any = None) -> None:
        """Set the velocities of all particles; pinned ones stay at rest, and history and multipliers are cleared.

        Args:
            name: The object.
            velocities: (N, 3) [m/s].
            world: The number of a world, a mask (worlds,) of bool, or None for all.

        Raises:
            ValueError: The velocities have another shape, or are not finite or too large.
        """
        rows, some = self._checked_rows(name, velocities, "velocities"), self._bodies.some(world)
        values = wp.array(rows[None], dtype=wp.float64, device=self._bodies.warp_device)
        self._bodies.batch[name].write_velocities(name, values, self._bodies.chosen(some))

    def _checked_rows(self, name: str, values: Any, what: str) -> np.ndarray:
        """Return `values` as an array (N, 3), a row per particle.

        Raises ValueError for another shape or a number beyond MOST.
        """
        count, limit = len(self._bodies.topology(name).masses), MOST[what]
        rows = finite_array(values, f"{name} {what}")
        if len(rows) != count or np.abs(rows).max() > limit:
            raise ValueError(
                f"{name} {what} have {len(rows)} rows up to {np.abs(rows).max():g}; "
                f"allowed are {count} rows up to {limit:g}"
            )
        return rows

    def take_over(self, name: str, other: Placing) -> None:
        """Continue an object, in all worlds, from its state in the first world of another simulation.

        The object must have the same structure there. Positions, velocities, the length a winch has paid out, twist,
        torn springs and grasps carry over; the scale does not. Raises ValueError if the structure differs; nothing
        changes then.
        """
        if not isinstance(other, Placing):
            raise ValueError(f"take_over of {name} is from {other!r}; allowed is a Simulation")
        ours, theirs = self._bodies.topology(name), other._bodies.topology(name)
        as_ours, as_theirs = _structure_of(ours), _structure_of(theirs)
        if as_ours != as_theirs or not np.array_equal(ours.triangles, theirs.triangles):
            allowed = f"allowed is {as_ours} with the same triangles"
            raise ValueError(f"{name} is {as_theirs} in the other simulation; {allowed}")
        batch, source = self._bodies.batch[name], other._bodies.batch[name]
        if batch.features.winch:
            batch.write_body("winches", name, source.read_body("winches", name, 0))
        self._write_positions(name, other.positions(name), None)
        self.set_velocities(name, other.velocities(name))
        if batch.torn is not None and source.torn is not None:
            batch.torn.write(batch.index[name], source.torn.read(source.index[name], 0))
        if batch.features.twist and source.features.twist:
            batch.write_body("twists", name, source.read_body("twists", name, 0))
            part = batch.part("twisted", batch.segments(name), None)
            part.assign(np.broadcast_to(source.part("twisted", source.segments(name), 0).numpy(), part.shape).copy())
        if batch.features.handles and source.features.handles:
            self._take_over_grasps(name, other)
        self.moved.pop(name, None)


def _structure_of(topology: Topology) -> str:
    """Describe, as text, the structure that must agree to take over an object."""
    kind = "a sheet" if len(topology.triangles) else "a rope" if topology.winch is None else "a rope on a winch"
    return f"{kind} of {len(topology.masses)} particles"
