# SPDX-License-Identifier: Apache-2.0
"""A thread's share of a chain: its segments, and their combined span for the scans over all shares."""

import warp as wp

from cloth_sim_ros.sim.arrays.model import Body
from cloth_sim_ros.sim.arrays.state import State
from cloth_sim_ros.sim.kernels.intrinsics import quick_quotient
from cloth_sim_ros.sim.physics.chain import Span, inverse_beside, join, span_of, symmetric_product, turned_end
from cloth_sim_ros.sim.ropes.arrays import Segment
from cloth_sim_ros.sim.ropes.segments import pull_of, stiffness_across


@wp.struct
class Share:
    """A thread's part of a chain, eliminated from the start of the chain or from its end, depending on its side."""

    lane: int  # the thread's index among the active threads of its side
    lanes: int  # number of active threads of its side
    most: int  # larger number of active threads of both sides
    way: int  # 1 from the start of the chain, -1 from its end
    first: int  # its first segment on the way, counted in the body
    count: int  # number of its segments
    start: int  # particle at which its side begins, counted in the body
    ahead: int  # offset from a segment to its far particle
    coupled: bool  # True if there is another side
    yields: bool  # True if its last particle belongs to the other side


@wp.struct
class Reach:
    """The force in the first of some segments as a function of the force f after them: passed f + force.

    Forces are in world axes, in units of mass times length. With displacements instead, products would lose the tiny
    compliance of rigid segments along themselves beside that across, and with it their tension. Forces of neighbours
    differ only by what moves one particle.
    """

    passed: wp.mat33
    force: wp.vec3


def make_share(threads: int, stored: bool):
    """Return a Warp function: the part of thread t of `threads`, of the `out` segments of a body from `first`.

    stored: True if a thread may have several segments. One thread takes the whole chain; many take half of it from
    either end.
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
    """Return a Warp function that joins the segments of a thread to one span.

    stored: True if a thread may have several segments, kept in State.segments.
    """

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
    """Return the Reach of one segment that is passed; `pull` is the force that moves its far particle.

    Let that particle have mass m and compliance Y. By Newton's second law it takes a part of the force f after it, and
    hands on (1 - m Y) f + m (missing - q). Here q = Y pull is the displacement that it has alone. Pinned, it takes all.
    """
    reach = Reach()
    back = wp.transpose(segment.frame)
    # Avoid a branch, so that this is computed while both sides meet.
    m = quick_quotient(1.0, wp.max(segment.far, 1.0e-15))
    y = inverse_beside(m, segment.admittance)
    reach.passed = wp.identity(n=3, dtype=float) - m * symmetric_product(back * y, back)
    reach.force = back * (m * (segment.missing - y * pull))
    return reach


def make_reach_back(stored: bool):
    """Return a Warp function: the Reach over a thread's segments, and the first of them.

    stored: True if a thread may have several segments. pull: force that moves the far particle of `segment`, the last
    of them. The last segment of a side, where both sides meet, is left out.
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
