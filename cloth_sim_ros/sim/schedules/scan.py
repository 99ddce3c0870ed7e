"""The threads of a block scan a chain: from spans of their own segments to what lies before and behind them.

Both scans take log2(lanes) steps (Hillis and Steele 1986). Lanes show one another their spans in shared memory.
"""

import warp as wp

from cloth_sim_ros.sim.model import Body
from cloth_sim_ros.sim.physics.chain import Span, join, turned_end
from cloth_sim_ros.sim.schedules.native import load4, store4, sync, xyz

THREADS = 256  # most that share a chain
SLOTS = wp.constant(10)  # vec4 by which a lane hands on its span and a frame, in each of two copies


@wp.struct
class Share:
    """A thread's part of a chain: its place among the `lanes` that take part, and its segments of the body."""

    lane: int
    lanes: int
    begin: int
    end: int
    count: int


@wp.func
def share_of(t: int, width: int, body: Body) -> Share:
    """The part of thread t of `width`."""
    share = Share()
    share.count = body.segments_end - body.segments
    each = (share.count + width - 1) / width
    share.lane = t
    share.lanes = (share.count + each - 1) / each
    share.begin = wp.min(t * each, share.count)
    share.end = wp.min(share.begin + each, share.count)
    return share


@wp.func
def _post(lane: int, span: Span, shared: wp.uint64):
    """Show a lane's span to the others; symmetric matrices as six numbers."""
    a = span.passed
    c = span.compliance
    j = span.inertia
    at = SLOTS * lane
    store4(shared, at, wp.vec4(a[0, 0], a[0, 1], a[0, 2], span.free[0]))
    store4(shared, at + 1, wp.vec4(a[1, 0], a[1, 1], a[1, 2], span.free[1]))
    store4(shared, at + 2, wp.vec4(a[2, 0], a[2, 1], a[2, 2], span.free[2]))
    store4(shared, at + 3, wp.vec4(c[0, 0], c[1, 1], c[2, 2], span.pull[0]))
    store4(shared, at + 4, wp.vec4(c[0, 1], c[0, 2], c[1, 2], span.pull[1]))
    store4(shared, at + 5, wp.vec4(j[0, 0], j[1, 1], j[2, 2], span.pull[2]))
    store4(shared, at + 6, wp.vec4(j[0, 1], j[0, 2], j[1, 2], 0.0))


@wp.func
def _span_at(lane: int, shared: wp.uint64) -> Span:
    at = SLOTS * lane
    a0 = load4(shared, at)
    a1 = load4(shared, at + 1)
    a2 = load4(shared, at + 2)
    c0 = load4(shared, at + 3)
    c1 = load4(shared, at + 4)
    j0 = load4(shared, at + 5)
    j1 = load4(shared, at + 6)
    span = Span()
    span.passed = wp.matrix_from_rows(xyz(a0), xyz(a1), xyz(a2))
    span.compliance = _symmetric(c0, c1)
    span.inertia = _symmetric(j0, j1)
    span.free = wp.vec3(a0[3], a1[3], a2[3])
    span.pull = wp.vec3(c0[3], c1[3], j0[3])
    return span


@wp.func
def _symmetric(diagonal: wp.vec4, beside: wp.vec4) -> wp.mat33:
    return wp.mat33(
        diagonal[0], beside[0], beside[1], beside[0], diagonal[1], beside[2], beside[1], beside[2], diagonal[2]
    )


@wp.func
def _post_matrix(at: int, a: wp.mat33, b: wp.vec3, shared: wp.uint64):
    store4(shared, at, wp.vec4(a[0, 0], a[0, 1], a[0, 2], b[0]))
    store4(shared, at + 1, wp.vec4(a[1, 0], a[1, 1], a[1, 2], b[1]))
    store4(shared, at + 2, wp.vec4(a[2, 0], a[2, 1], a[2, 2], b[2]))


@wp.func
def _matrix_at(at: int, shared: wp.uint64) -> wp.mat33:
    return wp.matrix_from_rows(xyz(load4(shared, at)), xyz(load4(shared, at + 1)), xyz(load4(shared, at + 2)))


@wp.func
def _vector_at(at: int, shared: wp.uint64) -> wp.vec3:
    return wp.vec3(load4(shared, at)[3], load4(shared, at + 1)[3], load4(shared, at + 2)[3])


@wp.struct
class Reach:
    """How the particle before some segments follows the one behind them: passed u + moved [m], in the world."""

    passed: wp.mat33
    moved: wp.vec3


@wp.func
def scan_forward(share: Share, start: Span, own: Span, first: wp.mat33, last: wp.mat33, shared: wp.uint64) -> Span:
    """All that lies before a lane's segments, `start` before the first lane's, in the frame of its first segment.

    own: the lane's segments; first, last: frames of the first and the last of them. Two copies of the slots take
    turns, so that each step needs one barrier (Hillis and Steele 1986).
    """
    takes_part = share.lane < share.lanes
    if share.lane + 1 < share.lanes:
        _post(share.lane + 1, own, shared)
        _post_matrix(SLOTS * (share.lane + 1) + 7, last, wp.vec3(0.0), shared)
    sync()
    span = start
    if takes_part and share.lane > 0:
        behind = _matrix_at(SLOTS * share.lane + 7, shared)
        span = turned_end(_span_at(share.lane, shared), first * wp.transpose(behind))
    offset = int(1)
    half = wp.block_dim()
    while offset < share.lanes:
        if takes_part:
            _post(half + share.lane, span, shared)
        sync()
        if takes_part and share.lane >= offset:
            span = join(_span_at(half + share.lane - offset, shared), span)
        half = wp.block_dim() - half
        offset *= 2
    return span


@wp.func
def scan_backward(share: Share, reach: Reach, shared: wp.uint64, last: wp.vec3) -> wp.vec3:
    """How the last particle of a lane's segments moves; `last` is that of the chain, and known to the last lane."""
    takes_part = share.lane < share.lanes
    offset = int(1)
    half = int(0)
    sync()
    while offset < share.lanes:
        at = SLOTS * (half + share.lane)
        if takes_part:
            _post_matrix(at, reach.passed, reach.moved, shared)
        sync()
        if takes_part and share.lane + offset < share.lanes:
            after = at + SLOTS * offset
            reach.moved += reach.passed * _vector_at(after, shared)
            reach.passed = reach.passed * _matrix_at(after, shared)
        half = wp.block_dim() - half
        offset *= 2
    if takes_part:
        _post_matrix(SLOTS * (half + share.lane), reach.passed, reach.moved, shared)
    sync()
    if share.lane + 1 < share.lanes:
        return _vector_at(SLOTS * (half + share.lane + 1), shared)
    return last
