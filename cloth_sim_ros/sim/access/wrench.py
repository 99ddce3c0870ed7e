# SPDX-License-Identifier: Apache-2.0
"""The load of a rope on the supports of its ends: tension, bending, weight and wind of the held particles."""

from __future__ import annotations

import warp as wp

from cloth_sim_ros.sim.access.tension import Tensions, edge_at, is_held
from cloth_sim_ros.sim.arrays.state import Arrays
from cloth_sim_ros.sim.engine.batch import Batch
from cloth_sim_ros.sim.features.twist.twist import push_of
from cloth_sim_ros.sim.features.winch.drum import density_at, joint_out
from cloth_sim_ros.sim.kernels.compiled import compiled
from cloth_sim_ros.sim.kernels.intrinsics import xyz


@wp.func
def bending_force(arrays: Arrays, b: int, i: int) -> wp.vec3:
    """Force [N] on particle i of a rope by the joints around it (see ropes/newton.py)."""
    body = arrays.model.bodies[b]
    force = wp.vec3(0.0)
    for place in range(3):
        j = i - place
        if j >= 0 and j < body.count - 2:
            joint = arrays.model.joints[body.segments + j]
            if arrays.state.winch.winches.shape[0] > 0:
                joint = joint_out(j, joint, arrays.state.winch.winches[b])
            weight = wp.where(place == 0, joint[2], wp.where(place == 1, -(joint[2] + joint[3]), joint[3]))
            force -= weight * arrays.state.rope.moments[body.segments + j]
    return force


@wp.func
def load_on(arrays: Arrays, b: int, i: int, forces: wp.array(dtype=wp.vec3), bending: bool) -> wp.vec3:
    """The force [N] of the rope and of the air on particle i, without its own weight."""
    body = arrays.model.bodies[b]
    load = wp.vec3(0.0)
    if i < forces.shape[0]:
        load += forces[i]
    if i > 0:
        load -= forces[i - 1]
    if bending:
        load += bending_force(arrays, b, i)
    if arrays.state.twist.twists.shape[0] > 0:
        load += push_of(i, arrays.model, arrays.state, body)
    if arrays.state.air.panel_forces.shape[0] > 0:
        g = body.particles + i
        for k in range(arrays.model.panel_start[g], arrays.model.panel_start[g + 1]):
            load += xyz(arrays.state.air.panel_forces[arrays.model.particle_panels[k]])
    return load


@wp.func
def held_mass(arrays: Arrays, b: int, i: int, masses: wp.array(dtype=float)) -> float:
    """Mass [kg] of held particle i: at a drum half of the segment that is fed, and 0 on the drum."""
    if arrays.state.winch.winches.shape[0] > 0:
        winch = arrays.state.winch.winches[b]
        if i <= winch.index:
            body = arrays.model.bodies[b]
            return wp.where(i < winch.index, 0.0, 0.5 * density_at(i, arrays.model, body) * winch.length)
    return masses[i]


@compiled
def write_wrenches(
    arrays: Arrays,
    b: int,
    forces: wp.array(dtype=wp.vec3),
    bending: bool,
    masses: wp.array(dtype=float),
    out: wp.array2d(dtype=float),
):
    """Write force [N] and torque [N m] about the end particle: row 0 for the start, row 1 for the end.

    Each sums over all particles held from that end on.
    """
    end = wp.tid()
    first = arrays.model.bodies[b].particles
    last = masses.shape[0] - 1
    tip = wp.where(end == 0, 0, last)
    force = wp.vec3(0.0)
    torque = wp.vec3(0.0)
    place = int(0)
    while place <= last and is_held(arrays, first + wp.where(end == 0, place, last - place)):
        i = wp.where(end == 0, place, last - place)
        load = load_on(arrays, b, i, forces, bending) + held_mass(arrays, b, i, masses) * arrays.frames[0].gravity
        force += load
        torque += wp.cross(xyz(arrays.state.positions[first + i] - arrays.state.positions[first + tip]), load)
        place += 1
    if arrays.state.twist.twists.shape[0] > 0:
        k = wp.where(end == 0, 0, last - 1)
        twist = arrays.state.twist.twists[b]
        torsion = wp.where(end == 0, twist.start_moment, -twist.end_moment)
        torque += torsion * wp.normalize(edge_at(arrays, first + k))
    for c in range(3):
        out[end, c] = force[c]
        out[end, 3 + c] = torque[c]


class EndWrenches:
    """Wrenches (2, 6) of a rope on the supports of its start and its end, in one world.

    `launch()` computes them into `out` from the current state, without allocation.
    """

    def __init__(self, batch: Batch, name: str, world: int, out: wp.array) -> None:
        b, arrays, device = batch.index[name], batch.worlds[world], batch.device
        self._tensions = Tensions(batch, name, world)
        self._masses = batch.masses.masses[world, batch.span(name)]
        inputs = [arrays, b, self._tensions.forces[0], batch.features.beam, self._masses, out]
        self._command = wp.launch(write_wrenches, dim=2, inputs=inputs, device=device, record_cmd=True)

    def launch(self) -> None:
        """Compute the wrenches from the current state."""
        self._tensions.launch()
        self._command.launch()
