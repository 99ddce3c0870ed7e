# SPDX-License-Identifier: Apache-2.0
"""Velocities, the history of order 2 and the solve of a rope in shared memory, for a body that lives there."""

import warp as wp

from cloth_sim_ros.sim.arrays.model import Body
from cloth_sim_ros.sim.arrays.state import State
from cloth_sim_ros.sim.kernels.intrinsics import load_row, store_row
from cloth_sim_ros.sim.ropes.arrays import NUMBERS


@wp.func
def with_history_at(begin: wp.uint64, capacity: int, body: Body, s: State) -> State:
    """Return the state with velocities, last velocities and last displacements of one body at address `begin`.

    They take 10 floats for each of `capacity` particles. Indices count through the batch as in other arrays.
    """
    ctx = s
    end = body.particles + body.count
    skipped = wp.uint64(body.particles)
    room = wp.uint64(capacity)
    ctx.velocities = wp.array(ptr=begin - wp.uint64(16) * skipped, shape=(end,), dtype=wp.vec4)
    begin += wp.uint64(16) * room
    ctx.last_velocities = wp.array(ptr=begin - wp.uint64(12) * skipped, shape=(end,), dtype=wp.vec3)
    begin += wp.uint64(12) * room
    ctx.last_displacements = wp.array(ptr=begin - wp.uint64(12) * skipped, shape=(end,), dtype=wp.vec3)
    return ctx


@wp.func
def scratch_at(begin: wp.uint64, body: Body) -> wp.array(dtype=wp.float64):
    """Return the scratch of the solve of one rope at address `begin`; indices count through the batch."""
    skipped = NUMBERS * (body.particles + 3 * body.index)
    end = skipped + NUMBERS * (body.count + 3)
    return wp.array(ptr=begin - wp.uint64(8) * wp.uint64(skipped), shape=(end,), dtype=wp.float64)


@wp.func
def copy_history(g: int, source: State, target: State):
    """Copy velocity and history of particle g from one state to the other."""
    store_row(target.velocities, g, load_row(source.velocities, g))
    target.last_velocities[g] = source.last_velocities[g]
    target.last_displacements[g] = source.last_displacements[g]
