# SPDX-License-Identifier: Apache-2.0
"""A thread's share of a chain: which segments it has, and what they are together, for the scans over all shares."""

import warp as wp

from cloth_sim_ros.sim.arrays.model import Body
from cloth_sim_ros.sim.arrays.state import State
from cloth_sim_ros.sim.kernels.intrinsics import quick_quotient
from cloth_sim_ros.sim.physics.chain import Span, inverse_beside, join, span_of, symmetric_product, turned_end
from cloth_sim_ros.sim.ropes.arrays import Segment
from cloth_sim_ros.sim.ropes.segments import pull_of, stiffness_across


@wp.struct
class Share:
    """A thread's part of a chain, eliminated from the start of the chain or from its end, whichever side it is on."""

    lane: int  # the thread's place among the `lanes` of its side that take part, of both sides at `most`
    lanes: int
    most: int
    way: int  # 1 from the start of the chain, -1 from its end
    first: int  # its first segment on the way, of the body
    count: int  # of its segments
    start: int  # the particle at which its side begins, of the body
    ahead: int  # from a segment to its far particle
    coupled: bool  # whether there is another side
    yields: bool  # whether its last particle is one of the other side


@wp.struct
class Reach:
    """How the force in the first of some segments follows the one f behind them: passed f + force, in the world, in
    units of mass times length.

    Were these displacements, products of them would lose what rigid segments yield along themselves, all that tells
    their tension, beside what they yield across. Forces differ from one to the next by what moves a particle alone.
    """

    passed: wp.mat33
    force: wp.vec3


def make_share(threads: int, stored: bool):
    """A Warp function: the part of thread t of `threads`, of the `out` segments of a body from `first`.

    `stored`: a thread may have several. One thread takes all of the chain; many take half of it from either end.
    """
    half = max(threads // 2, 1)

    @wp.func
    def share_of(t: int, first: int, out: int, body: Body) -> Share:
        share = Share()
        share.way = 1
        share.ahead = 1
        share.lanes = 1
        share.most = 1
        share.first = first
        share.count = out
        if wp.static(threads > 1):
            near = (out + 1) / 2
            side = near
            share.lane = t
            if t >= half:
                side = out - near
                share.lane = t - half
                share.way = -1
                share.ahead = 0
                share.first = first + out - 1
                share.start = body.count - 1
            each = int(1)
            if wp.static(stored):
                each = (near + half - 1) / half
            share.most = (near + each - 1) / each
            share.lanes = (side + each - 1) / each
            share.first += share.way * share.lane * each
            share.count = wp.clamp(side - share.lane * each, 0, each)
            share.coupled = out > 1
            share.yields = t >= half and share.lane + 1 == share.lanes
        return share

    return share_of


def make_gather(stored: bool):
    """A Warp function: the segments of a thread as one span."""

    @wp.func
    def gather(share: Share, segment: Segment, s: State, body: Body) -> Span:
        span = Span()
        frame = wp.mat33(0.0)
        for r in range(share.count):
            if wp.static(stored):
                segment = s.rope.segments[body.segments + share.first + r * share.way]
            one = span_of(
                segment.far, segment.along, stiffness_across(segment), segment.tension, segment.gap, segment.missing
            )
            if wp.static(stored):
                if r > 0:
                    one = join(turned_end(span, segment.frame * wp.transpose(frame)), one)
                frame = segment.frame
            span = one
        return span

    return gather


@wp.func
def reach_of(segment: Segment, pull: wp.vec3) -> Reach:
    """Of one segment that is passed, where `pull` is what moves its far particle.

    By Newton's second law that particle, of mass m and compliance Y, hands on what it does not take of the force f
    behind it: (1 - m Y) f + m (missing - q), with the displacement q = Y pull that it has alone. Pinned, it takes all.
    """
    reach = Reach()
    back = wp.transpose(segment.frame)
    # Without a branch: it is reckoned while both sides meet.
    m = quick_quotient(1.0, wp.max(segment.far, 1.0e-15))
    y = inverse_beside(m, segment.admittance)
    reach.passed = wp.identity(n=3, dtype=float) - m * symmetric_product(back * y, back)
    reach.force = back * (m * (segment.missing - y * pull))
    return reach


def make_reach_back(stored: bool):
    """A Warp function: how the force in the first of a thread's segments follows the one behind them, and that first.

    pull: what moves the far particle of `segment`, the last of them, which is left out where both sides meet.
    """

    @wp.func
    def reach_back(share: Share, segment: Segment, pull: wp.vec3, s: State, body: Body):
        reach = Reach()
        if wp.static(stored):
            last = wp.where(share.lane + 1 == share.lanes, 1, 0)
            reach.passed = wp.identity(n=3, dtype=float)
            for r in range(last, share.count):
                segment = s.rope.segments[body.segments + share.first + (share.count - 1 - r) * share.way]
                one = reach_of(segment, pull_of(segment, segment.admittance, segment.free))
                reach.force = one.passed * reach.force + one.force
                reach.passed = one.passed * reach.passed
        else:
            reach = reach_of(segment, pull)
        return reach, segment

    return reach_back
