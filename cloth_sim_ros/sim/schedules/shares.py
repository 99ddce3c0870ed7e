"""A thread's share of a chain as a whole: what its segments are together, for the scans over all threads' shares."""

import warp as wp

from cloth_sim_ros.sim.model import Body
from cloth_sim_ros.sim.physics.chain import Span, join, span_of, turned_end
from cloth_sim_ros.sim.schedules.native import quotient
from cloth_sim_ros.sim.schedules.scan import Reach, Share
from cloth_sim_ros.sim.state import Segment, State


@wp.func
def stiffness_across(segment: Segment) -> float:
    """The stiffness across a segment, the turn of earlier attempts in it."""
    return segment.across + quotient(wp.min(0.25 * segment.turn, 1.0), segment.along)


def make_gather(stored: bool):
    """A Warp function: the segments of a thread as one span."""

    @wp.func
    def gather(share: Share, segment: Segment, s: State, body: Body) -> Span:
        span = Span()
        frame = wp.mat33(0.0)
        for k in range(share.begin, share.end):
            if wp.static(stored):
                segment = s.segments[body.segments + k]
            one = span_of(
                segment.far, segment.along, stiffness_across(segment), segment.tension, segment.gap, segment.missing
            )
            if wp.static(stored):
                if k > share.begin:
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
        if share.end == share.count:
            reach.moved = last
        else:
            reach.passed = wp.identity(n=3, dtype=float)
        for r in range(share.end - share.begin):
            if wp.static(stored):
                segment = s.segments[body.segments + share.end - 1 - r]
            held = wp.transpose(segment.frame) * segment.compliance * segment.admittance
            reach.passed = held * segment.frame * reach.passed
            moved = segment.frame * (reach.moved - segment.free) + wp.vec3(segment.gap, 0.0, 0.0)
            reach.moved = segment.free + held * moved
        return reach

    return reach_back
