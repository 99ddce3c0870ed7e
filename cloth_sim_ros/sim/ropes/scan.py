# SPDX-License-Identifier: Apache-2.0
"""Scans of a chain by the threads of a block, from both its ends: each thread gets the span before its segments.

The first half of the threads goes from the start of the chain to its middle. The other half goes from the end, as if
the chain began there. In the middle both sides move one particle, and from there forces propagate back. Each way takes
log2 of the threads of a side (Hillis and Steele 1986). Threads exchange spans in shared memory, in two copies that
alternate. A step overwrites data that was last read two steps ago, so each step needs one barrier. A side of at most
half a warp, or a whole one, never waits for another warp.
"""

import warp as wp

from cloth_sim_ros.sim.kernels.intrinsics import load4, quick_quotient, store4, sync, sync_warp, xyz
from cloth_sim_ros.sim.physics.chain import (
    Span,
    close,
    inverse_beside,
    join,
    symmetric,
    turn_frame,
    turned_end,
)
from cloth_sim_ros.sim.ropes.arrays import Segment
from cloth_sim_ros.sim.ropes.partition import Reach, Share
from cloth_sim_ros.sim.ropes.segments import change_of, near_of

THREADS = 256  # largest number of threads that share a chain
SLOTS = wp.constant(9)  # vec4 in which a thread hands on its span and a frame: odd, to avoid bank conflicts
MEETING = wp.constant(5)  # vec4 in which a side hands on its pull where both meet


def scan_size(threads: int) -> int:
    """Return the vec4 of shared memory that `threads` threads need."""
    return 2 * SLOTS * threads + 2 * MEETING


@wp.func
def _post_end(at: int, span: Span, shared: wp.uint64):
    """Store the compliance and free displacement of a span's end."""
    c = span.compliance
    j = span.inertia
    store4(shared, at, wp.vec4(c[0, 0], c[1, 1], c[2, 2], span.free[0]))
    store4(shared, at + 1, wp.vec4(c[0, 1], c[0, 2], c[1, 2], span.free[1]))
    store4(shared, at + 2, wp.vec4(j[0, 0], j[1, 1], j[2, 2], span.free[2]))


@wp.func
def _post(at: int, span: Span, beside: float, shared: wp.uint64):
    """Store a span, and a number."""
    a = span.passed
    j = span.inertia
    _post_end(at, span, shared)
    store4(shared, at + 3, wp.vec4(j[0, 1], j[0, 2], j[1, 2], span.pull[0]))
    store4(shared, at + 4, wp.vec4(a[0, 0], a[0, 1], a[0, 2], span.pull[1]))
    store4(shared, at + 5, wp.vec4(a[1, 0], a[1, 1], a[1, 2], span.pull[2]))
    store4(shared, at + 6, wp.vec4(a[2, 0], a[2, 1], a[2, 2], beside))


@wp.func
def _end_at(at: int, shared: wp.uint64) -> Span:
    c = load4(shared, at)
    beside = load4(shared, at + 1)
    span = Span()
    span.compliance = symmetric(xyz(c), xyz(beside))
    span.free = wp.vec3(c[3], beside[3], load4(shared, at + 2)[3])
    return span


@wp.func
def _span_at(at: int, shared: wp.uint64) -> Span:
    span = _end_at(at, shared)
    beside = load4(shared, at + 3)
    a0 = load4(shared, at + 4)
    a1 = load4(shared, at + 5)
    span.inertia = symmetric(xyz(load4(shared, at + 2)), xyz(beside))
    span.passed = wp.matrix_from_rows(xyz(a0), xyz(a1), xyz(load4(shared, at + 6)))
    span.pull = wp.vec3(beside[3], a0[3], a1[3])
    return span


@wp.func
def _post_reach(at: int, reach: Reach, shared: wp.uint64):
    a = reach.passed
    store4(shared, at, wp.vec4(reach.force[0], reach.force[1], reach.force[2], a[2, 2]))
    store4(shared, at + 1, wp.vec4(a[0, 0], a[0, 1], a[0, 2], a[1, 0]))
    store4(shared, at + 2, wp.vec4(a[1, 1], a[1, 2], a[2, 0], a[2, 1]))


@wp.func
def _reach_at(at: int, shared: wp.uint64) -> Reach:
    force = load4(shared, at)
    first = load4(shared, at + 1)
    last = load4(shared, at + 2)
    reach = Reach()
    reach.force = xyz(force)
    reach.passed = wp.mat33(first[0], first[1], first[2], first[3], last[0], last[1], last[2], last[3], force[3])
    return reach


@wp.func
def _post_side(at: int, segment: Segment, pull: wp.vec3, shared: wp.uint64):
    """Store admittance and pull of the last segment of a side at its far particle, in its frame."""
    f = segment.frame
    a = segment.admittance
    store4(shared, at, wp.vec4(a[0, 0], a[1, 1], a[2, 2], pull[0]))
    store4(shared, at + 1, wp.vec4(a[0, 1], a[0, 2], a[1, 2], pull[1]))
    store4(shared, at + 2, wp.vec4(f[0, 0], f[0, 1], f[0, 2], pull[2]))
    store4(shared, at + 3, wp.vec4(f[1, 0], f[1, 1], f[1, 2], segment.far))
    store4(shared, at + 4, wp.vec4(f[2, 0], f[2, 1], f[2, 2], 0.0))


@wp.func
def _side_at(at: int, shared: wp.uint64):
    diagonal = load4(shared, at)
    beside = load4(shared, at + 1)
    f0 = load4(shared, at + 2)
    f1 = load4(shared, at + 3)
    frame = wp.matrix_from_rows(xyz(f0), xyz(f1), xyz(load4(shared, at + 4)))
    return frame, symmetric(xyz(diagonal), xyz(beside)), wp.vec3(diagonal[3], beside[3], f0[3]), f1[3]


def make_scans(threads: int, stored: bool):
    """Return three Warp functions that all of `threads` threads call together: scan_forward, meet and scan_backward.

    stored: True if a thread may have several segments.
    """
    sync_side = sync_warp if threads <= 64 else sync
    copy = SLOTS * threads
    meeting = 2 * SLOTS * threads
    steps = (threads // 2 - 1).bit_length()

    @wp.func
    def scan_forward(
        t: int, share: Share, start: Span, own: Span, first: wp.mat33, last: wp.mat33, shared: wp.uint64
    ) -> Span:
        """Return the span of everything before a thread's segments, in the frame `first`.

        start: the span before the first thread. own: the span of the thread's segments. first, last: frames of the
        first and the last of them.
        """
        at = SLOTS * t
        takes_part = share.lane < share.lanes
        _post(at, own, last[2, 2], shared)
        store4(shared, at + 7, wp.vec4(last[0, 0], last[0, 1], last[0, 2], last[1, 0]))
        store4(shared, at + 8, wp.vec4(last[1, 1], last[1, 2], last[2, 0], last[2, 1]))
        sync_side()
        span = start
        if takes_part and share.lane > 0:
            before = at - SLOTS
            f = load4(shared, before + 7)
            l = load4(shared, before + 8)
            behind = wp.mat33(f[0], f[1], f[2], f[3], l[0], l[1], l[2], l[3], load4(shared, before + 6)[3])
            span = turned_end(_span_at(before, shared), first * wp.transpose(behind))
        offset = int(1)
        half = int(copy)
        while 2 * offset < share.most:
            if takes_part:
                _post(half + at, span, 0.0, shared)
            sync_side()
            if takes_part and share.lane >= offset:
                span = join(_span_at(half + at - SLOTS * offset, shared), span)
            half = copy - half
            offset *= 2
        # In the last step, every span that a thread takes over begins at an end of the chain.
        if offset < share.most:
            if takes_part:
                _post_end(half + at, span, shared)
            sync_side()
            if takes_part and share.lane >= offset:
                span = close(_end_at(half + at - SLOTS * offset, shared), span)
        return span

    @wp.func
    def meet(share: Share, segment: Segment, pull: wp.vec3, shared: wp.uint64) -> wp.vec3:
        """Return the displacement of the particle where both sides meet.

        segment: the last segment that the thread has passed. pull: force that moves its far particle, in its frame.
        Every thread computes it from the same numbers in the same way, with equal bits.
        """
        if share.lane + 1 == share.lanes:
            place = wp.where(share.way > 0, meeting, meeting + MEETING)
            _post_side(place, segment, pull, shared)
            if not share.coupled:
                _post_side(meeting + MEETING, Segment(), wp.vec3(0.0), shared)
        # A vote of the whole block follows before the next meeting or forward scan stores here again.
        sync()
        # Avoid a branch, so that independent work is computed meanwhile.
        frame, both, pulled, w = _side_at(meeting, shared)
        other, admittance, push, there = _side_at(meeting + MEETING, shared)
        both += turn_frame(admittance, other, frame)
        pulled += frame * (wp.transpose(other) * push)
        moved = wp.transpose(frame) * (inverse_beside(quick_quotient(1.0, wp.max(w, 1.0e-15)), both) * pulled)
        return wp.where(w > 0.0, moved, wp.vec3(0.0))

    @wp.func
    def scan_backward(t: int, share: Share, reach: Reach, first: Segment, last: Segment, u: wp.vec3, shared: wp.uint64):
        """Return the displacements of a thread's last particle and of the one before its first segment.

        It also returns the change of force in that segment, in its frame. u: displacement of the side's last particle,
        after its segment `last`.
        """
        if share.lane + 1 == share.lanes:
            force = wp.transpose(last.frame) * (change_of(last, u) + wp.vec3(last.tension, 0.0, 0.0))
            if wp.static(stored):
                force = reach.force + reach.passed * force
            reach.force = force
            reach.passed = wp.mat33(0.0)
        at = SLOTS * t
        ends = at + SLOTS * (wp.max(share.lanes, 1) - 1 - share.lane)
        for step in range(wp.static(steps)):
            ctx = wp.static(copy) * (step % 2)
            _post_reach(ctx + at, reach, shared)
            sync_side()
            # A thread at the end of its side follows none: what it reads from there is multiplied by 0.
            after = ctx + wp.min(at + SLOTS * (1 << step), ends)
            behind = _reach_at(after, shared)
            reach.force += reach.passed * behind.force
            if wp.static(step + 1 < steps):
                reach.passed = reach.passed * behind.passed
        there = wp.static(copy * (steps % 2))
        change = first.frame * reach.force - wp.vec3(first.tension, 0.0, 0.0)
        near = near_of(first, change)
        store4(shared, there + at, wp.vec4(near[0], near[1], near[2], 0.0))
        sync_side()
        if share.lane + 1 < share.lanes:
            u = xyz(load4(shared, there + at + SLOTS))
        return u, near, change

    return scan_forward, meet, scan_backward
