"""A thread's share of a chain: which segments it has, and what they are together, for the scans over all shares."""

import warp as wp

from cloth_sim_ros.sim.model import Body
from cloth_sim_ros.sim.physics.chain import Span, join, span_of, turned_end
from cloth_sim_ros.sim.schedules.segments import stiffness_across
from cloth_sim_ros.sim.state import Segment, State


@wp.struct
class Share:
    """A thread's part of a chain, walked from the start of the chain or from its end, whichever side it is on."""

    lane: int  # the thread's place among the `lanes` of its side that take part, of both sides at `most`
    lanes: int
    most: int
    way: int  # 1 from the start of the chain, -1 from its end
    first: int  # its first segment on the way, of the body
    count: int  # of its segments
    start: int  # the particle at which its side begins, of the body
    ahead: int  # from a segment to its far particle
    meets: bool  # whether there is another side
    yields: bool  # whether its last particle is one of the other side


@wp.struct
class Reach:
    """How the particle before some segments follows the one behind them: passed u + moved [m], in the world."""

    passed: wp.mat33
    moved: wp.vec3


def make_share(threads: int, stored: bool):
    """A Warp function: the part of thread t of `threads`, of the `out` segments of a body from `first`.

    `stored`: a thread may have several. One thread walks all of the chain; many take half of it from either end.
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
            share.meets = out > 1
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
                segment = s.segments[body.segments + share.first + r * share.way]
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


def make_reach_back(stored: bool):
    """A Warp function: how the particle before a thread's segments follows the last one of them, or for the last
    thread, how it moves when that one moves by `last`."""

    @wp.func
    def reach_back(share: Share, segment: Segment, last: wp.vec3, s: State, body: Body) -> Reach:
        reach = Reach()
        if share.lane + 1 == share.lanes:
            reach.moved = last
        else:
            reach.passed = wp.identity(n=3, dtype=float)
        for r in range(share.count):
            if wp.static(stored):
                segment = s.segments[body.segments + share.first + (share.count - 1 - r) * share.way]
            held = wp.transpose(segment.frame) * segment.compliance * segment.admittance
            if wp.static(stored):
                reach.passed = held * segment.frame * reach.passed
            elif share.lane + 1 < share.lanes:
                reach.passed = held * segment.frame
            moved = segment.frame * (reach.moved - segment.free) + wp.vec3(segment.gap, 0.0, 0.0)
            reach.moved = segment.free + held * moved
        return reach

    return reach_back
