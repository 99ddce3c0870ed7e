# SPDX-License-Identifier: Apache-2.0
"""Fault recovery: at the end of a frame, each body that is not finite or ran away is put back, and no other.

If any particle is bad, its body returns to the last state in which all were good (rounded to float32). It is at rest
there, with its history and multipliers cleared. Velocities are not kept, or the same fault would come again. If it does
come again, frame after frame, that state was not good, and the body returns to its rest shape. Other bodies are not
affected.
"""

import warp as wp

from cloth_sim_ros.sim.arrays.context import Context
from cloth_sim_ros.sim.arrays.model import Features, Model
from cloth_sim_ros.sim.arrays.state import State
from cloth_sim_ros.sim.kernels.intrinsics import load4, load_row, store_row

FARTHEST = wp.constant(1.0e6)  # largest distance from the origin [m]
FASTEST = wp.constant(1.0e5)  # largest speed [m/s]
RELAPSES = wp.constant(3)  # frames with a fault in a row, after which the last good state is dropped


@wp.func
def find_fault(i: int, ctx: Context):
    """Mark the body as faulty if particle i is bad."""
    if not is_good(load4(ctx.x, i), load_row(ctx.state.velocities, ctx.body.particles + i)):
        ctx.state.faulty[ctx.body.index] = 1


def make_settle(features: Features):
    """Return the stage that keeps the state of particle i and of the rope there, or puts them back."""

    @wp.func
    def settle(i: int, ctx: Context):
        s = ctx.state
        g = ctx.body.particles + i
        if s.faulty[ctx.body.index] == 0:
            keep(g, load4(ctx.x, i), load4(ctx.position_lo, i), s)
            return
        put_back(g, s.relapses[ctx.body.index], ctx.model, s)
        if wp.static(features.chain):
            k = ctx.body.segments + i
            if k < ctx.body.segments_end:
                s.rope.tensions[k] = 0.0
                if wp.static(features.beam):
                    s.rope.moments[k] = wp.vec3(0.0)
                if wp.static(features.twist):
                    s.twist.twisted[k].couple = wp.vec3(0.0)

    return settle


def make_count(features: Features):
    """Return the stage that ends a frame: count a fault, keep or restore twist and winch, set the history."""

    @wp.func
    def count(i: int, ctx: Context):
        s, b = ctx.state, ctx.body.index
        faulty = s.faulty[b] == 1
        if wp.static(features.twist):
            if faulty:
                s.twist.twists[b] = s.twist.good_twists[b]
            else:
                s.twist.good_twists[b] = s.twist.twists[b]
        if wp.static(features.winch):
            if faulty:
                s.winch.winches[b] = s.winch.good_winches[b]
            else:
                s.winch.good_winches[b] = s.winch.winches[b]
        s.recoveries[b] += s.faulty[b]
        s.relapses[b] = s.faulty[b] * (s.relapses[b] + 1)
        s.faulty[b] = 0
        n = ctx.frame.substeps
        s.control.taken[b] = n
        s.control.since[b] += wp.vec4i(1, n, 0, 0)
        s.control.asleep[b] = 0
        if wp.static(features.looks_back):
            smooth = s.events[2 * b + (n - 1) % 2] != n
            s.history[b] = wp.where(smooth and not faulty, 1, 0)
            s.events[2 * b] = 0
            s.events[2 * b + 1] = 0

    return count


@wp.func
def is_good(position: wp.vec4, velocity: wp.vec4) -> bool:
    """Return True if a particle is finite and within bounds; the comparisons are False for NaN."""
    size = wp.abs(position[0]) + wp.abs(position[1]) + wp.abs(position[2])
    speed = wp.abs(velocity[0]) + wp.abs(velocity[1]) + wp.abs(velocity[2])
    return size < FARTHEST and speed < FASTEST


@wp.func
def keep(g: int, position: wp.vec4, lo: wp.vec4, s: State):
    """Keep the state of particle g of the batch, which is at `position` plus `lo` in a good body."""
    store_row(s.positions, g, position)
    store_row(s.good_positions, g, position)
    store_row(s.position_lo, g, lo)


@wp.func
def put_back(g: int, relapses: int, m: Model, s: State):
    """Put particle g of the batch at its last good position, at rest.

    After RELAPSES `relapses` it goes to its rest position.
    """
    if relapses >= RELAPSES:
        rest = m.rest[g]
        s.good_positions[g] = wp.vec4(rest[0], rest[1], rest[2], s.good_positions[g][3])
    store_row(s.positions, g, load_row(s.good_positions, g))
    store_row(s.position_lo, g, wp.vec4(0.0))
    store_row(s.velocities, g, wp.vec4(0.0))
