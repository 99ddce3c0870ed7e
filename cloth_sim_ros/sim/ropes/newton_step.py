# SPDX-License-Identifier: Apache-2.0
"""A Newton step over all segments of a chain: elimination to its end, and back (see physics/chain.py)."""

import warp as wp

from cloth_sim_ros.sim.arrays.context import Context
from cloth_sim_ros.sim.kernels.intrinsics import load4, sync_any
from cloth_sim_ros.sim.physics.chain import Span, turn_frame
from cloth_sim_ros.sim.ropes.arrays import Segment
from cloth_sim_ros.sim.ropes.partition import Share, make_gather, make_reach_back
from cloth_sim_ros.sim.ropes.scan import make_scans
from cloth_sim_ros.sim.ropes.segments import ATTEMPTS, backward, forward, settle


def make_attempt(threads: int, stored: bool):
    """Return a Warp function: a Newton step of a thread's segments, repeated if one of the chain goes too far.

    It returns the last segment and the displacement of its near particle. It also returns True if any event happened in
    the chain, and True if a segment of it went too far or is overstretched. Last comes the number of the thread's own
    unsettled segments. stored: True if a thread may have several segments.
    """
    sweep, settle_all = _make_sweep(threads, stored), _make_settle_all(threads, stored)

    @wp.func
    def attempt(
        t: int, share: Share, last: Segment, missing: wp.vec3, first: wp.mat33, ctx: Context, shared: wp.uint64
    ):
        segment = last
        near = wp.vec3(0.0)
        eventful = bool(False)
        placed = bool(False)
        unsettled = int(0)
        count = int(0)
        while count < ATTEMPTS:
            count += 1
            segment, u, near, change = sweep(t, share, segment, missing, first, ctx, shared)
            segment, near, found = settle_all(share, segment, u, near, change, ctx)
            unsettled = found[2]
            # One vote is enough as long as nothing happens. It is also a barrier: all threads have read displacements,
            # spans and the meeting point before others store new ones.
            eventful = sync_any(found[0] + found[1] + found[2]) > 0
            solved = bool(True)
            if eventful:
                solved = sync_any(found[0]) == 0
                if sync_any(found[0] + found[1]) > 0:
                    placed = True
            if solved:
                count = ATTEMPTS
        return segment, near, eventful, placed, unsettled

    return attempt


def _make_sweep(threads: int, stored: bool):
    """Return a Warp function that eliminates a thread's segments, between those of the other threads.

    It returns the last segment and the displacement of its far particle. For many threads it also returns that of the
    near particle, and the change of the segment's pull.
    """
    gather, reach_back = make_gather(stored), make_reach_back(stored)
    scan_forward, meet, scan_backward = make_scans(threads, stored) if threads > 1 else (None, None, None)

    @wp.func
    def sweep(t: int, share: Share, last: Segment, missing: wp.vec3, first: wp.mat33, ctx: Context, shared: wp.uint64):
        segment = last
        near = wp.vec3(0.0)
        # Compliance and free displacement of all before the thread's first segment, in that segment's frame.
        y = wp.identity(n=3, dtype=float) * load4(ctx.d, share.start)[3]
        q = missing
        if wp.static(threads > 1):
            start = Span()
            start.compliance = y
            start.free = first * q
            own = gather(share, segment, ctx.state, ctx.body)
            before = scan_forward(t, share, start, own, first, segment.frame, shared)
            y = before.compliance
            q = wp.transpose(first) * before.free
        frame = first
        pull = wp.vec3(0.0)
        for r in range(share.count):
            k = share.first + r * share.way
            if wp.static(stored):
                segment = ctx.state.rope.segments[ctx.body.segments + k]
                if r > 0:
                    y = turn_frame(y, frame, segment.frame)
                frame = segment.frame
            segment, y, q, pull = forward(segment, y, q)
            if wp.static(stored):
                ctx.state.rope.segments[ctx.body.segments + k] = segment
        u = q
        change = pull
        if wp.static(threads > 1):
            u = meet(share, segment, pull, shared)
            reach, opening = reach_back(share, segment, pull, ctx.state, ctx.body)
            u, near, change = scan_backward(t, share, reach, opening, segment, u, shared)
        return segment, u, near, change

    return sweep


def _make_settle_all(threads: int, stored: bool):
    """Return a Warp function that computes the displacements of a thread's particles, from its last far one back.

    It returns the last segment processed, the displacement of its near particle, and three counts: segments that go too
    far, are overstretched, and are unsettled.
    """

    @wp.func
    def settle_all(share: Share, last: Segment, far: wp.vec3, moved: wp.vec3, change: wp.vec3, ctx: Context):
        segment = last
        u = far
        near = moved
        found = wp.vec3i(0)
        for r in range(share.count):
            k = share.first + (share.count - 1 - r) * share.way
            if wp.static(stored):
                segment = ctx.state.rope.segments[ctx.body.segments + k]
            if wp.static(threads > 1 and not stored):
                segment = settle(segment, u, near, change, ctx.step.effective)
            else:
                segment, u = backward(segment, u, ctx.step.effective)
                near = u
            found += wp.vec3i(segment.too_far, segment.overstretched, segment.unsettled)
            if wp.static(stored):
                ctx.state.rope.segments[ctx.body.segments + k] = segment
        return segment, near, found

    return settle_all
