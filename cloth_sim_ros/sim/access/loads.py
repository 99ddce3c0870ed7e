# SPDX-License-Identifier: Apache-2.0
"""Loads on handles and colliders: forces on particles, summed in a fixed order by one block per handle or collider."""

from __future__ import annotations

import numpy as np
import warp as wp

from cloth_sim_ros.sim.arrays.state import Arrays
from cloth_sim_ros.sim.engine.bodies import Bodies
from cloth_sim_ros.sim.kernels.compiled import compiled
from cloth_sim_ros.sim.kernels.intrinsics import load_row, xyz

_LANES = 64  # threads of a block


@wp.func
def handle_load(arrays: Arrays, g: int, h: int) -> wp.spatial_vector:
    """Load of particle g on handle h: force [N] and torque [N m] about its origin."""
    s = arrays.state
    force = wp.vec3(0.0)
    if int(load_row(s.grasp.grips, g)[3]) == h + 1:
        force = -xyz(load_row(s.grasp.grip_forces, g))
    arm = xyz(load_row(s.positions, g)) - arrays.handles[h].end_position
    return wp.spatial_vector(force, wp.cross(arm, force))


@wp.func
def collider_load(arrays: Arrays, g: int, c: int) -> wp.spatial_vector:
    """Load of particle g on collider c, likewise."""
    s = arrays.state
    force = -xyz(load_row(s.contact.contact_forces, g * arrays.colliders.shape[0] + c))
    arm = xyz(load_row(s.positions, g)) - arrays.colliders[c].end_position
    return wp.spatial_vector(force, wp.cross(arm, force))


def _make_add_up(load):
    @compiled(module="unique")
    def add_up(given: wp.array(dtype=Arrays), loads: wp.array2d(dtype=wp.spatial_vector), lanes: int):
        q, t = wp.tid()
        w, k = q / loads.shape[1], q % loads.shape[1]
        part = wp.spatial_vector()
        for g in range(t, given[w].state.positions.shape[0], lanes):
            part += load(given[w], g, k)
        total = wp.tile_sum(wp.tile(part, preserve_type=True))[0]
        if t == 0:
            loads[w, k] += total

    return add_up


@compiled
def add_torsion(given: wp.array(dtype=Arrays), loads: wp.array2d(dtype=wp.spatial_vector)):
    """Add the moments of ropes that handles clamp (see ropes/twist.py)."""
    w = wp.tid()
    s, model = given[w].state, given[w].model
    for b in range(s.twist.twists.shape[0]):
        twist, body = s.twist.twists[b], model.bodies[b]
        for end in range(2):
            by = wp.where(end == 0, twist.start_by, twist.end_by)
            if by > 0 and twist.known == 1:
                g = wp.where(end == 0, body.particles, body.particles + body.count - 2)
                along = wp.normalize(xyz(load_row(s.positions, g + 1) - load_row(s.positions, g)))
                torque = wp.where(end == 0, twist.start_moment, -twist.end_moment) * along
                loads[w, by - 1] += wp.spatial_vector(wp.vec3(0.0), torque)


ADD_UP = {"handles": _make_add_up(handle_load), "colliders": _make_add_up(collider_load)}


class Loads:
    """The loads of all handles or colliders (`kind`) in every world, mean over the last frame."""

    def __init__(self, bodies: Bodies, kind: str, count: int) -> None:
        self._bodies, self._kernel = bodies, ADD_UP[kind]
        self.array = wp.zeros((bodies.worlds, count), dtype=wp.spatial_vector, device=bodies.warp_device)

    def measure(self) -> wp.array:
        """Measure (worlds, count) of force [N], then torque [N m] about the origin, in world axes, on the device."""
        self.array.zero_()
        device = self._bodies.warp_device
        lanes = 1 if device.is_cpu else _LANES
        batches = self._bodies.batches if self.array.size else []
        for batch in batches:
            inputs = [batch.given, self.array, lanes]
            wp.launch_tiled(self._kernel, dim=[self.array.size], inputs=inputs, block_dim=lanes, device=device)
        for batch in batches if self._kernel is ADD_UP["handles"] else []:
            if batch.features.twist:
                wp.launch(add_torsion, dim=len(batch.given), inputs=[batch.given, self.array], device=device)
        return self.array

    def read(self, world: int) -> np.ndarray:
        """Measure and copy the loads of one world to the host, (count, 6) float32."""
        return self.measure().numpy()[self._bodies.one(world)].copy()
