# SPDX-License-Identifier: Apache-2.0
"""Direct solves along chains: one Newton step over all segments of a rope (see physics/chain.py).

Positions and multipliers start from the last substep and iteration. The tension carries over, so that the first tangent
already contains the geometric stiffness. The static balance does not depend on step or iterations.

A thread takes neighbouring segments. One thread alone eliminates to the end and back. On a CPU it goes from both ends
at once (two_sided.py), except for the shortest chains and those on a winch. Many threads first join their segments to
spans and scan these from both ends of the chain. Each then knows what lies before its segments, and how their end
moves.
"""

import warp as wp

from cloth_sim_ros.sim.arrays.context import Context
from cloth_sim_ros.sim.arrays.model import Features
from cloth_sim_ros.sim.features.winch.drum import first_out
from cloth_sim_ros.sim.kernels.intrinsics import load4, quick_quotient, store4, sync, sync_any, xyz
from cloth_sim_ros.sim.ropes.arrays import Segment
from cloth_sim_ros.sim.ropes.chain_bending import make_bend_after, make_bend_before
from cloth_sim_ros.sim.ropes.newton_step import make_attempt
from cloth_sim_ros.sim.ropes.partition import Share, make_share
from cloth_sim_ros.sim.ropes.segment_simd import lack
from cloth_sim_ros.sim.ropes.segments import NEWTON_STEPS, make_prepare
from cloth_sim_ros.sim.ropes.two_sided import prepare_two_sided, solve_two_sided


@wp.func
def missing_of(i: int, ctx: Context) -> wp.vec3:
    """Return the vector from particle i to its place without the chain [m].

    Any displacement since the last solve of the substep (bending, contact) counts as part of that place.
    """
    if ctx.step.first and not ctx.step.store:
        return wp.vec3(0.0)
    g = ctx.body.particles + i
    now = xyz(load4(ctx.d, i))
    target = now
    if not ctx.step.first:
        target = ctx.state.rope.targets[g] + (now - ctx.state.rope.solved[g])
    ctx.state.rope.targets[g] = target
    return target - now


@wp.func
def _keep(i: int, p: wp.vec4, ctx: Context):
    """Store the chain's force on particle i, whose displacement is p now, and p itself for the next iteration."""
    g = ctx.body.particles + i
    if p[3] > 0.0 and ctx.step.store:
        ctx.state.rope.chain_forces[g] = (xyz(p) - ctx.state.rope.targets[g]) * quick_quotient(
            ctx.step.inverse_square, p[3]
        )
    if ctx.step.repeats:
        ctx.state.rope.solved[g] = xyz(p)


@wp.func
def _move(i: int, u: wp.vec3, ctx: Context):
    p = load4(ctx.d, i)
    if p[3] > 0.0:
        p = p + wp.vec4(u[0], u[1], u[2], 0.0)
        store4(ctx.d, i, p)
    _keep(i, p, ctx)


@wp.func
def owns(share: Share, r: int) -> bool:
    """Return True if the thread moves the far particle of its segment r; one side does so in the middle."""
    return not (share.yields and r + 1 == share.count)


def make_solve_chain(features: Features, threads: int, stored: bool):
    """Return a Warp function in which thread t of `threads` solves its part of a body's chain.

    It returns True if that was overstretched. stored: True if a thread may have several segments, kept in
    State.segments; otherwise its one segment stays in registers. `shared` is the address of scan_size(threads) vec4 of
    shared memory, which one thread does not use. A beam also resists bending, solved after its stretch, and twist
    between two clamps. On a winch, only the part that is out is solved, and one thread solves its bending.
    """
    beam, winch = features.beam, features.winch
    bend_before, bend_after = make_bend_before(features, threads), make_bend_after(features, threads)
    share_of, find_tangent = make_share(threads, stored), _make_find_tangent(features, threads, stored)
    attempt, move = make_attempt(threads, stored), _make_move(stored)

    @wp.func
    def solve_chain(t: int, ctx: Context, shared: wp.uint64) -> bool:
        begin = int(0)
        if wp.static(winch):
            begin = first_out(ctx.state, ctx.body)
        share = share_of(t, begin, ctx.body.segments_end - ctx.body.segments - begin, ctx.body)
        if wp.static(beam):
            bend_before(t, ctx)
        segment = Segment()
        missing = wp.vec3(0.0)
        near = wp.vec3(0.0)
        placed = bool(False)
        again = int(1)
        steps = int(0)
        if wp.static(threads == 1 and not winch):
            if prepare_two_sided(ctx):
                placed = _solve_two_sided(ctx)
                again = 0
        while again > 0:
            segment, first = find_tangent(share, steps, segment, ctx)
            if share.lane == 0 and share.count > 0:
                if steps > 0:
                    missing -= near
                else:
                    missing = missing_of(share.start, ctx)
            segment, near, eventful, overstretched, unsettled = attempt(t, share, segment, missing, first, ctx, shared)
            placed = placed or overstretched
            move(share, segment, near, ctx)
            steps += 1
            again = int(0)
            if eventful:
                if steps < NEWTON_STEPS:
                    again = sync_any(unsettled)
        if wp.static(beam):
            sync()
            bend_after(t, ctx, shared)
        return placed

    return solve_chain


@wp.func
def _solve_two_sided(ctx: Context) -> bool:
    """Solve a whole chain from both its ends by one CPU thread; return True if it was overstretched."""
    if ctx.step.store or not ctx.step.first:
        for i in range(ctx.body.count):
            lack(i, missing_of(i, ctx), ctx.body.particles, ctx.body.count - 1, ctx.state.rope.ladder)
    placed = solve_two_sided(ctx)
    if ctx.step.store or ctx.step.repeats:
        for i in range(ctx.body.count):
            _keep(i, load4(ctx.d, i), ctx)
    return placed


def _make_find_tangent(features: Features, threads: int, stored: bool):
    """Return a Warp function that computes the tangents of a thread's segments in a Newton step.

    It returns the last segment, and the frame of the first.
    """
    prepare = make_prepare(features.order, features.winch, threads > 1)

    @wp.func
    def find_tangent(share: Share, steps: int, last: Segment, ctx: Context):
        segment = last
        first = wp.mat33(0.0)
        for r in range(share.count):
            k = share.first + r * share.way
            lag = wp.vec3(0.0)
            if owns(share, r):
                if steps > 0:
                    if wp.static(stored):
                        segment = ctx.state.rope.segments[ctx.body.segments + k]
                    lag = wp.transpose(segment.frame) * segment.missing - segment.moved
                else:
                    lag = missing_of(k + share.ahead, ctx)
            segment = prepare(k, share.way, lag, ctx)
            if r == 0:
                first = segment.frame
            if wp.static(stored):
                ctx.state.rope.segments[ctx.body.segments + k] = segment
        return segment, first

    return find_tangent


def _make_move(stored: bool):
    """Return a Warp function that moves a thread's particles as its segments say, and stores the tensions."""

    @wp.func
    def move(share: Share, last: Segment, near: wp.vec3, ctx: Context):
        segment = last
        for r in range(share.count):
            k = share.first + r * share.way
            if wp.static(stored):
                segment = ctx.state.rope.segments[ctx.body.segments + k]
            ctx.state.rope.tensions[ctx.body.segments + k] = segment.held + segment.pull * ctx.step.inverse_square
            if owns(share, r):
                _move(k + share.ahead, segment.moved, ctx)
        if share.lane == 0 and share.count > 0:
            _move(share.start, near, ctx)

    return move
