"""Direct solves along chains: one Newton step over all segments of a rope (see physics/chain.py).

Positions and multipliers start from where the last substep and iteration left them: the tension carries over, so that
the first tangent already knows the geometric stiffness, and the static balance does not depend on step or iterations.

A thread takes neighbouring segments, from `begin` to `end`. Alone it walks the chain to its end and back. Many first
join their segments to spans and scan these, so that each knows what lies before its own and how its end moves.
"""

import warp as wp

from cloth_sim_ros.sim.model import Body, Features, Model
from cloth_sim_ros.sim.physics.chain import (
    Span,
    edge_frame,
    particle_compliance,
    series_admittance,
    turn_frame,
)
from cloth_sim_ros.sim.physics.distance import elongation, opened
from cloth_sim_ros.sim.physics.integrate import Step, carried
from cloth_sim_ros.sim.schedules.beam import bend_by_moments, solve_beam
from cloth_sim_ros.sim.schedules.native import inverse_root, load4, quotient, root, store4, sync, sync_any, xyz
from cloth_sim_ros.sim.schedules.reel import make_fed, rest_of, share_out
from cloth_sim_ros.sim.schedules.scan import scan_backward, scan_forward, share_of
from cloth_sim_ros.sim.schedules.shares import make_gather, make_reach_back, stiffness_across
from cloth_sim_ros.sim.schedules.twist import make_find_twist, push_by_couples
from cloth_sim_ros.sim.state import Material, Segment, State

# A segment whose correction turns it by more than the root of this [rad^2] left what a linear solve can tell: it is
# solved again, stiffer across, as far as the turn stretches it (a bound of the energy from above), this often at most.
LARGEST_TURN = wp.constant(0.09)
ATTEMPTS = wp.constant(5)

# Across, a linear solve leaves a segment too long by half the square of its turn. The next substep would take that back
# at once: a load that outweighs the chain by far hops at that speed, falls into the slack, and gains energy. Where the
# speed is more than this [m/s], another Newton step follows at once instead, so that there are this many at most.
SETTLED_SPEED = wp.constant(1.0e-3)
NEWTON_STEPS = wp.constant(8)

# Of what a rope's whole mass yields, what the tangent of a rigid segment yields along it.
STIFFEST = wp.constant(1.0e-4)

# A chain was torn where a segment needs several attempts or changes its length by this share of it in a substep.
TORN = wp.constant(0.02)


@wp.func
def missing_of(i: int, s: State, body: Body, step: Step, d: wp.uint64) -> wp.vec3:
    """How far particle i lies from where it would be without the chain [m].

    Whatever moved it since the last solve of the substep (bending, contact) counts as part of where it would be.
    """
    if step.first and not step.store:
        return wp.vec3(0.0)
    g = body.particles + i
    now = xyz(load4(d, i))
    target = now
    if not step.first:
        target = s.targets[g] + (now - s.solved[g])
    s.targets[g] = target
    return target - now


@wp.func
def _move(i: int, u: wp.vec3, s: State, body: Body, step: Step, d: wp.uint64):
    g = body.particles + i
    p = load4(d, i)
    if p[3] > 0.0:
        p = p + wp.vec4(u[0], u[1], u[2], 0.0)
        store4(d, i, p)
        if step.store:
            s.chain_forces[g] = (xyz(p) - s.targets[g]) * quotient(step.inverse_square, p[3])
    if step.repeats:
        s.solved[g] = xyz(p)


def make_prepare(order: int, winch: bool):
    """A Warp function: everything that the tangent at segment k needs and that does not depend on others."""
    fed_to = make_fed(order)

    @wp.func
    def prepare(
        k: int,
        missing: wp.vec3,
        m: Model,
        s: State,
        body: Body,
        material: Material,
        step: Step,
        x: wp.uint64,
        low: wp.uint64,
        d: wp.uint64,
    ) -> Segment:
        index = body.segments + k
        g = body.particles + k
        p = load4(d, k)
        q = load4(d, k + 1)
        de = xyz(q) - xyz(p)
        e = opened((xyz(load4(x, k + 1)) - xyz(load4(x, k))) + de, k)
        square = wp.dot(e, e)
        length = root(square)  # as exact as can be: it is what the stretch is told from
        n = inverse_root(square) * e
        rest = m.segment_length[index]
        if wp.static(winch):
            rest = rest_of(k, m, s, body)
        alpha = material.compliance[0] * rest * step.inverse_square
        gamma = material.damping * step.inverse
        segment = Segment()
        segment.held = s.tensions[index]
        segment.tension = segment.held * (step.effective * step.effective)
        gap = length - rest - alpha * segment.tension
        if gamma > 0.0:
            slip = elongation(e, de - xyz(load4(low, k + 1) - load4(low, k)))
            if wp.static(order == 2):
                if step.second:
                    slip -= wp.dot(n, carried(s.last_displacements[g + 1] - s.last_displacements[g], step))
            if wp.static(winch):
                slip -= fed_to(k, length, s, body, step.second, step.parts)
            gap += gamma * slip
        segment.frame = edge_frame(n)
        eased = quotient(1.0, 1.0 + gamma)
        segment.gap = gap * eased
        # Between a rigid edge and a pinned particle nothing would be left to divide by, and rounding across the edge
        # reaches a tangent that is much stiffer: the rope trembles. Much softer than all that hangs on it, it lags.
        segment.along = wp.max(alpha * eased, wp.max(1.0e-9 * wp.max(p[3], q[3]), STIFFEST * body.yielding))
        segment.across = quotient(wp.max(segment.tension, 0.0), wp.max(length, 1.0e-3 * rest))
        segment.reach = wp.max(length, rest)
        segment.near = p[3]
        segment.far = q[3]
        segment.missing = segment.frame * missing
        return segment

    return prepare


@wp.func
def forward(segment: Segment, y: wp.mat33, q: wp.vec3):
    """Past a segment, from the particle before it with compliance y, in the segment's frame, and free displacement q.

    Returns the segment with what the way back needs, and compliance and free displacement of its far particle.
    Displacements are in the world: differences of turned ones would lose digits.
    """
    # The edge's present tension pulls its first particle; the rest of the pull is solved for.
    q += wp.transpose(segment.frame) * (y * wp.vec3(segment.tension, 0.0, 0.0))
    admittance = wp.mat33(0.0)
    if segment.near + segment.far > 0.0:
        admittance = series_admittance(y, segment.along, stiffness_across(segment))
    segment.admittance = admittance
    segment.compliance = y
    segment.free = q
    pull = admittance * (segment.frame * q - wp.vec3(segment.gap, 0.0, 0.0)) - wp.vec3(segment.tension, 0.0, 0.0)
    if segment.far > 0.0:
        pull += segment.missing * quotient(1.0, segment.far)
    y = particle_compliance(segment.far, admittance)
    return segment, y, wp.transpose(segment.frame) * (y * pull)


@wp.func
def backward(segment: Segment, u: wp.vec3, h: float):
    """How the particle before a segment moves when the one behind it moves by u, and the segment with its new pull
    and turn, negative where it turns too far."""
    segment.moved = u
    force = segment.admittance * (segment.frame * (u - segment.free) + wp.vec3(segment.gap, 0.0, 0.0))
    before = segment.free + wp.transpose(segment.frame) * (segment.compliance * force)
    turned = segment.frame * (u - before)
    turn = quotient(turned[1] * turned[1] + turned[2] * turned[2], segment.reach * segment.reach)
    segment.too_far = wp.where(turn > LARGEST_TURN and turn > 2.0 * segment.turn, 1, 0)
    segment.unsettled = wp.where(0.5 * turn * segment.reach > SETTLED_SPEED * h, 1, 0)
    segment.turn = wp.max(turn, segment.turn)
    segment.torn = wp.where(wp.abs(turned[0]) > TORN * segment.reach, 1, 0)
    segment.pull = force[0]
    return segment, before


def make_solve_chain(features: Features, threads: int, stored: bool):
    """A Warp function by which thread t of `threads` solves its part of a body's chain; whether that was torn.

    `stored`: a thread may have several segments, kept in State.segments; otherwise its one stays in registers. The
    address is that of 2 x SLOTS x threads vec4 that the threads share, unused by one thread. A beam also resists
    bending, solved after its stretch, and between two clamps twist; of a chain on a winch, what is out is solved.
    """
    prepare = make_prepare(features.order, features.winch)
    beam, winch, twist = features.beam, features.winch, features.twist
    find_twist = make_find_twist(features.order) if twist else None
    gather = make_gather(stored)
    reach_back = make_reach_back(stored)

    @wp.func
    def solve_chain(
        t: int,
        m: Model,
        s: State,
        body: Body,
        material: Material,
        step: Step,
        x: wp.uint64,
        low: wp.uint64,
        d: wp.uint64,
        shared: wp.uint64,
    ) -> bool:
        if wp.static(winch):
            share = share_out(t, threads, s, body)
        else:
            share = share_of(t, threads, body)
        if wp.static(beam):
            if step.first:
                if wp.static(twist):
                    if t == 0:
                        find_twist(m, s, body, material, step, x, low)
                    sync()
                for i in range(t, body.count, threads):
                    bend_by_moments(i, m, s, body, step, d)
                    if wp.static(twist):
                        push_by_couples(i, m, s, body, step, d)
                sync()
        segment = Segment()
        missing = wp.vec3(0.0)
        near = wp.vec3(0.0)
        placed = bool(False)
        again = int(1)
        steps = int(0)
        while again > 0:
            first = wp.mat33(0.0)
            for k in range(share.begin, share.end):
                lag = wp.vec3(0.0)
                if steps > 0:
                    if wp.static(stored):
                        segment = s.segments[body.segments + k]
                    lag = wp.transpose(segment.frame) * segment.missing - segment.moved
                else:
                    lag = missing_of(k + 1, s, body, step, d)
                segment = prepare(k, lag, m, s, body, material, step, x, low, d)
                if k == share.begin:
                    first = segment.frame
                if wp.static(stored):
                    s.segments[body.segments + k] = segment
            if t == 0:
                if steps > 0:
                    missing -= near
                else:
                    missing = missing_of(0, s, body, step, d)
            unsettled = int(0)
            attempt = int(0)
            while attempt < ATTEMPTS:
                attempt += 1
                # What lies before the thread's first segment, in that one's frame.
                y = wp.identity(n=3, dtype=float) * load4(d, 0)[3]
                q = missing
                if wp.static(threads > 1):
                    start = Span()
                    start.compliance = y
                    start.free = first * q
                    before = scan_forward(share, start, gather(share, segment, s, body), first, segment.frame, shared)
                    y = before.compliance
                    q = wp.transpose(first) * before.free
                frame = first
                for k in range(share.begin, share.end):
                    if wp.static(stored):
                        segment = s.segments[body.segments + k]
                        if k > share.begin:
                            y = turn_frame(y, frame, segment.frame)
                        frame = segment.frame
                    segment, y, q = forward(segment, y, q)
                    if wp.static(stored):
                        s.segments[body.segments + k] = segment
                u = q
                if wp.static(threads > 1):
                    u = scan_backward(share, reach_back(share, segment, u, s, body), shared, u)
                too_far = int(0)
                torn = int(0)
                unsettled = int(0)
                for r in range(share.end - share.begin):
                    k = share.end - 1 - r
                    if wp.static(stored):
                        segment = s.segments[body.segments + k]
                    segment, u = backward(segment, u, step.effective)
                    too_far += segment.too_far
                    torn += segment.torn
                    unsettled += segment.unsettled
                    if wp.static(stored):
                        s.segments[body.segments + k] = segment
                near = u
                if sync_any(too_far) > 0:
                    placed = True
                else:
                    if sync_any(torn) > 0:
                        placed = True
                    attempt = ATTEMPTS
            for k in range(share.begin, share.end):
                if wp.static(stored):
                    segment = s.segments[body.segments + k]
                s.tensions[body.segments + k] = segment.held + segment.pull * step.inverse_square
                _move(k + 1, segment.moved, s, body, step, d)
            if t == 0:
                _move(0, near, s, body, step, d)
            steps += 1
            again = wp.where(steps < NEWTON_STEPS, sync_any(unsettled), 0)
        if wp.static(beam):
            sync()
            if t == 0:
                solve_beam(m, s, body, material, step, x, d)
        return placed

    return solve_chain
