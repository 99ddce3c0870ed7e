# SPDX-License-Identifier: Apache-2.0
"""Direct solves along chains: one Newton step over all segments of a rope (see physics/chain.py).

Positions and multipliers start from where the last substep and iteration left them. The tension carries over, so that
the first tangent already knows the geometric stiffness. The static balance does not depend on step or iterations.

A thread takes neighbouring segments. Alone it walks the chain to its end and back, on a CPU from both ends at once
(two_sided.py) but for the shortest chains and those on a winch. Many first join their segments to spans and scan these,
from both ends of the chain, so that each knows what lies before its own and how its end moves.
"""

import warp as wp

from cloth_sim_ros.sim.intrinsics import load4, quick_quotient, store4, sync, sync_any, xyz
from cloth_sim_ros.sim.model import Features
from cloth_sim_ros.sim.physics.chain import Span, turn_frame
from cloth_sim_ros.sim.ropes.beam import make_bend_by_moments, make_solve_beam
from cloth_sim_ros.sim.ropes.beam_parallel import make_solve_beam_together, most_together
from cloth_sim_ros.sim.ropes.beam_two_sided import make_solve_beam_from_both_ends
from cloth_sim_ros.sim.ropes.drum import first_out
from cloth_sim_ros.sim.ropes.partition import Share, make_gather, make_reach_back, make_share
from cloth_sim_ros.sim.ropes.scan import make_scans
from cloth_sim_ros.sim.ropes.segment_simd import lack
from cloth_sim_ros.sim.ropes.segments import ATTEMPTS, NEWTON_STEPS, backward, forward, make_prepare, settle
from cloth_sim_ros.sim.ropes.twist import make_find_twist, push_by_couples
from cloth_sim_ros.sim.ropes.two_sided import prepare_both_ends, solve_both_ends
from cloth_sim_ros.sim.stages.here import Here
from cloth_sim_ros.sim.state import Segment


@wp.func
def missing_of(i: int, here: Here) -> wp.vec3:
    """How far particle i lies from where it would be without the chain [m].

    Whatever moved it since the last solve of the substep (bending, contact) counts as part of where it would be.
    """
    if here.step.first and not here.step.store:
        return wp.vec3(0.0)
    g = here.body.particles + i
    now = xyz(load4(here.d, i))
    target = now
    if not here.step.first:
        target = here.state.targets[g] + (now - here.state.solved[g])
    here.state.targets[g] = target
    return target - now


@wp.func
def _keep(i: int, p: wp.vec4, here: Here):
    """Keep what the chain did to particle i, which is at p now, for those who read it and for the next iteration."""
    g = here.body.particles + i
    if p[3] > 0.0 and here.step.store:
        here.state.chain_forces[g] = (xyz(p) - here.state.targets[g]) * quick_quotient(here.step.inverse_square, p[3])
    if here.step.repeats:
        here.state.solved[g] = xyz(p)


@wp.func
def _move(i: int, u: wp.vec3, here: Here):
    p = load4(here.d, i)
    if p[3] > 0.0:
        p = p + wp.vec4(u[0], u[1], u[2], 0.0)
        store4(here.d, i, p)
    _keep(i, p, here)


@wp.func
def owns(share: Share, r: int) -> bool:
    """Whether the thread moves the far particle of its segment r: where both sides meet, one of them does."""
    return not (share.yields and r + 1 == share.count)


def make_solve_chain(features: Features, threads: int, stored: bool):
    """A Warp function by which thread t of `threads` solves its part of a body's chain; whether that was torn.

    `stored`: a thread may have several segments, kept in State.segments; otherwise its one stays in registers. The
    address is that of scan_size(threads) vec4 that the threads share, unused by one thread. A beam also resists
    bending, solved after its stretch, and between two clamps twist. Of a chain on a winch what is out is solved, its
    bending by one thread.
    """
    prepare = make_prepare(features.order, features.winch, threads > 1)
    beam, bent, winch, twist = features.beam, features.bent, features.winch, features.twist
    bend_by_moments = make_bend_by_moments(bent, winch) if beam else None
    solve_beam = make_solve_beam(bent, winch) if beam else None
    solve_beam_from_both_ends = make_solve_beam_from_both_ends(bent) if beam and threads == 1 else None
    solve_beam_together = make_solve_beam_together(threads, bent) if beam and threads > 1 else None
    find_twist = make_find_twist(features.order, features.handles) if twist else None
    gather = make_gather(stored)
    reach_back = make_reach_back(stored)
    share_of = make_share(threads, stored)
    scan_forward, meet, scan_backward = make_scans(threads, stored) if threads > 1 else (None, None, None)

    @wp.func
    def solve_chain(
        t: int,
        here: Here,
        shared: wp.uint64,
    ) -> bool:
        begin = int(0)
        if wp.static(winch):
            begin = first_out(here.state, here.body)
        share = share_of(t, begin, here.body.segments_end - here.body.segments - begin, here.body)
        if wp.static(beam):
            if here.step.first:
                if wp.static(twist):
                    if t == 0:
                        find_twist(here)
                    sync()
                for i in range(t, here.body.count, threads):
                    bend_by_moments(i, here)
                    if wp.static(twist):
                        push_by_couples(i, here)
                sync()
        segment = Segment()
        missing = wp.vec3(0.0)
        near = wp.vec3(0.0)
        placed = bool(False)
        again = int(1)
        steps = int(0)
        if wp.static(threads == 1 and not winch):
            if prepare_both_ends(here):
                if here.step.store or not here.step.first:
                    for i in range(here.body.count):
                        missing = missing_of(i, here)
                        lack(i, missing, here.body.particles, here.body.count - 1, here.state.ladder)
                placed = solve_both_ends(here)
                if here.step.store or here.step.repeats:
                    for i in range(here.body.count):
                        _keep(i, load4(here.d, i), here)
                again = 0
        while again > 0:
            first = wp.mat33(0.0)
            for r in range(share.count):
                k = share.first + r * share.way
                lag = wp.vec3(0.0)
                if owns(share, r):
                    if steps > 0:
                        if wp.static(stored):
                            segment = here.state.segments[here.body.segments + k]
                        lag = wp.transpose(segment.frame) * segment.missing - segment.moved
                    else:
                        lag = missing_of(k + share.ahead, here)
                segment = prepare(k, share.way, lag, here)
                if r == 0:
                    first = segment.frame
                if wp.static(stored):
                    here.state.segments[here.body.segments + k] = segment
            if share.lane == 0 and share.count > 0:
                if steps > 0:
                    missing -= near
                else:
                    missing = missing_of(share.start, here)
            unsettled = int(0)
            eventful = bool(False)
            attempt = int(0)
            while attempt < ATTEMPTS:
                attempt += 1
                # What lies before the thread's first segment, in that one's frame.
                y = wp.identity(n=3, dtype=float) * load4(here.d, share.start)[3]
                q = missing
                if wp.static(threads > 1):
                    start = Span()
                    start.compliance = y
                    start.free = first * q
                    own = gather(share, segment, here.state, here.body)
                    before = scan_forward(t, share, start, own, first, segment.frame, shared)
                    y = before.compliance
                    q = wp.transpose(first) * before.free
                frame = first
                pull = wp.vec3(0.0)
                for r in range(share.count):
                    k = share.first + r * share.way
                    if wp.static(stored):
                        segment = here.state.segments[here.body.segments + k]
                        if r > 0:
                            y = turn_frame(y, frame, segment.frame)
                        frame = segment.frame
                    segment, y, q, pull = forward(segment, y, q)
                    if wp.static(stored):
                        here.state.segments[here.body.segments + k] = segment
                u = q
                change = pull
                if wp.static(threads > 1):
                    u = meet(share, segment, pull, shared)
                    reach, opening = reach_back(share, segment, pull, here.state, here.body)
                    u, near, change = scan_backward(t, share, reach, opening, segment, u, shared)
                too_far = int(0)
                torn = int(0)
                unsettled = int(0)
                for r in range(share.count):
                    k = share.first + (share.count - 1 - r) * share.way
                    if wp.static(stored):
                        segment = here.state.segments[here.body.segments + k]
                    if wp.static(threads > 1 and not stored):
                        segment = settle(segment, u, near, change, here.step.effective)
                    else:
                        segment, u = backward(segment, u, here.step.effective)
                        near = u
                    too_far += segment.too_far
                    torn += segment.torn
                    unsettled += segment.unsettled
                    if wp.static(stored):
                        here.state.segments[here.body.segments + k] = segment
                # One vote, as long as nothing happens. It also holds back what is stored next for the others: what they
                # read of displacements, spans and meeting was before it.
                eventful = sync_any(too_far + torn + unsettled) > 0
                solved = bool(True)
                if eventful:
                    solved = sync_any(too_far) == 0
                    if sync_any(too_far + torn) > 0:
                        placed = True
                if solved:
                    attempt = ATTEMPTS
            for r in range(share.count):
                k = share.first + r * share.way
                if wp.static(stored):
                    segment = here.state.segments[here.body.segments + k]
                here.state.tensions[here.body.segments + k] = segment.held + segment.pull * here.step.inverse_square
                if owns(share, r):
                    _move(k + share.ahead, segment.moved, here)
            if share.lane == 0 and share.count > 0:
                _move(share.start, near, here)
            steps += 1
            again = int(0)
            if eventful:
                if steps < NEWTON_STEPS:
                    again = sync_any(unsettled)
        if wp.static(beam):
            sync()
            if wp.static(winch):
                if t == 0:
                    solve_beam(here)
            elif wp.static(threads > 1):
                if here.body.count <= wp.static(most_together(threads, bent)):
                    solve_beam_together(t, here, shared)
                elif t == 0:
                    solve_beam(here)
            elif not solve_beam_from_both_ends(here):
                solve_beam(here)
        return placed

    return solve_chain
