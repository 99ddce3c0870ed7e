# SPDX-License-Identifier: Apache-2.0
"""One segment of a chain in a direct solve: what its tangent needs, and the ways past it, there and back.

See physics/chain.py for the quantities, and chain_solve.py for the elimination.
"""

import warp as wp

from cloth_sim_ros.sim.arrays.context import Context
from cloth_sim_ros.sim.features.winch.drum import make_fed, rest_of
from cloth_sim_ros.sim.kernels.intrinsics import inverse_root, larger, load4, quick_quotient, root, xyz
from cloth_sim_ros.sim.physics.chain import edge_frame, particle_compliance, series_admittance
from cloth_sim_ros.sim.physics.distance import elongation, opened
from cloth_sim_ros.sim.physics.integrate import carried
from cloth_sim_ros.sim.ropes.arrays import Segment

# A segment whose correction turns it by more than the root of this [rad^2] left what a linear solve can tell.
LARGEST_TURN = wp.constant(0.09)

# Across, a linear solve leaves a segment too long by half the square of its turn. The next substep would take that back
# at once: a load that outweighs the chain by far hops at that speed, falls into the slack, and gains energy. Where the
# speed is more than this [m/s], another Newton step follows at once instead.
SETTLED_SPEED = wp.constant(1.0e-3)

# A segment that turned too far is solved again, stiffer across, as far as the turn stretches it (a bound of the energy
# from above), this often at most. Newton steps until all is settled there are this many at most.
ATTEMPTS = wp.constant(5)
NEWTON_STEPS = wp.constant(8)

# Of what a rope's whole mass yields, what the tangent of a rigid segment yields along it.
STIFFEST = wp.constant(1.0e-4)

# A chain is overstretched where a segment needs several attempts, or changes its length by this share in a substep.
MOST_STRETCHED = wp.constant(0.02)


@wp.func
def stiffest_of(ctx: Context) -> float:
    """What the tangent of a segment yields along it at least [1/kg]."""
    return STIFFEST * (ctx.material.largest_inverse_mass * ctx.body.yielding)


@wp.func
def stiffness_across(segment: Segment) -> float:
    """The stiffness across a segment, the turn of earlier attempts in it."""
    return segment.across + quick_quotient(wp.min(0.25 * segment.turn, 1.0), segment.along)


def make_prepare(order: int, winch: bool, two_sided: bool):
    """A Warp function: everything that the tangent at segment k needs and that does not depend on others.

    way: 1 where the chain is eliminated along to its end; -1 where it is back from there, as if it began there.
    missing: of the particle at the segment's far end on the way.
    """
    fed_to = make_fed(order)

    @wp.func
    def prepare(
        k: int,
        way: int,
        missing: wp.vec3,
        ctx: Context,
    ) -> Segment:
        index = ctx.body.segments + k
        g = ctx.body.particles + k
        held = ctx.state.rope.tensions[index]  # from afar: first
        rest = ctx.model.segment_length[index]
        p = load4(ctx.d, k)
        q = load4(ctx.d, k + 1)
        de = xyz(q) - xyz(p)
        e = opened((xyz(load4(ctx.x, k + 1)) - xyz(load4(ctx.x, k))) + de, k)
        square = wp.dot(e, e)
        length = root(square)  # as exact as can be: it is what the stretch is told from
        n = inverse_root(square) * e
        if wp.static(winch):
            rest = rest_of(k, ctx)
        alpha = ctx.material.compliance[0] * rest * ctx.step.inverse_square
        gamma = ctx.material.damping * ctx.step.inverse
        segment = Segment()
        segment.held = held
        segment.tension = segment.held * (ctx.step.effective * ctx.step.effective)
        gap = length - rest - alpha * segment.tension
        if gamma > 0.0:
            slip = elongation(e, de - xyz(load4(ctx.position_lo, k + 1) - load4(ctx.position_lo, k)))
            if wp.static(order == 2):
                if ctx.step.second:
                    slip -= wp.dot(n, carried(ctx.state.last_displacements[g + 1] - ctx.state.last_displacements[g]))
            if wp.static(winch):
                slip -= fed_to(k, length, ctx.state, ctx.body, ctx.step.second)
            gap += gamma * slip
        ahead = n
        near = p[3]
        far = q[3]
        if wp.static(two_sided):
            if way < 0:
                ahead = -n
                near = q[3]
                far = p[3]
        segment.frame = edge_frame(ahead)
        eased = quick_quotient(1.0, 1.0 + gamma)
        segment.gap = gap * eased
        # Between a rigid edge and a pinned particle nothing would be left to divide by, and rounding across the edge
        # reaches a tangent that is much stiffer: the rope trembles. Much softer than all that hangs on it, it lags.
        segment.along = larger(alpha * eased, larger(1.0e-9 * larger(p[3], q[3]), stiffest_of(ctx)))
        segment.across = quick_quotient(larger(segment.tension, 0.0), larger(length, 1.0e-3 * rest))
        segment.reach = larger(length, rest)
        segment.near = near
        segment.far = far
        segment.missing = segment.frame * missing
        return segment

    return prepare


@wp.func
def pull_of(segment: Segment, admittance: wp.mat33, q: wp.vec3) -> wp.vec3:
    """What moves the far particle of a segment that is passed, in units of mass times length, in its frame."""
    pull = admittance * (segment.frame * q - wp.vec3(segment.gap, 0.0, 0.0)) - wp.vec3(segment.tension, 0.0, 0.0)
    if segment.far > 0.0:
        pull += segment.missing * quick_quotient(1.0, segment.far)
    return pull


@wp.func
def forward(segment: Segment, y: wp.mat33, q: wp.vec3):
    """Past a segment, from the particle before it with compliance y, in the segment's frame, and free displacement q.

    Returns the segment with what the way back needs: compliance and free displacement of its far particle. Also what
    moves that particle, in units of mass times length, in the segment's frame. Displacements are in the world:
    differences of turned ones would lose digits.
    """
    # The edge's present tension pulls its first particle; the rest of the pull is solved for.
    q += wp.transpose(segment.frame) * (y * wp.vec3(segment.tension, 0.0, 0.0))
    admittance = wp.mat33(0.0)
    if segment.near + segment.far > 0.0:
        admittance = series_admittance(y, segment.along, stiffness_across(segment))
    segment.admittance = admittance
    segment.compliance = y
    segment.free = q
    pull = pull_of(segment, admittance, q)
    y = particle_compliance(segment.far, admittance)
    return segment, y, wp.transpose(segment.frame) * (y * pull), pull


@wp.func
def change_of(segment: Segment, u: wp.vec3) -> wp.vec3:
    """By how much the force in a segment changes when the particle behind it moves by u, in the segment's frame."""
    return segment.admittance * (segment.frame * (u - segment.free) + wp.vec3(segment.gap, 0.0, 0.0))


@wp.func
def near_of(segment: Segment, change: wp.vec3) -> wp.vec3:
    """How the particle before a segment moves when the force in it changes so."""
    return segment.free + wp.transpose(segment.frame) * (segment.compliance * change)


@wp.func
def settle(segment: Segment, u: wp.vec3, near: wp.vec3, change: wp.vec3, h: float) -> Segment:
    """The segment with how its ends move and with its new pull and turn."""
    segment.moved = u
    turned = segment.frame * (u - near)
    turn = quick_quotient(turned[1] * turned[1] + turned[2] * turned[2], segment.reach * segment.reach)
    segment.too_far = wp.where(turn > LARGEST_TURN and turn > 2.0 * segment.turn, 1, 0)
    segment.unsettled = wp.where(0.5 * turn * segment.reach > SETTLED_SPEED * h, 1, 0)
    segment.turn = larger(turn, segment.turn)
    segment.overstretched = wp.where(wp.abs(turned[0]) > MOST_STRETCHED * segment.reach, 1, 0)
    segment.pull = change[0]
    return segment


@wp.func
def backward(segment: Segment, u: wp.vec3, h: float):
    """How the particle before a segment moves when the one behind it moves by u, and the segment settled."""
    change = change_of(segment, u)
    near = near_of(segment, change)
    return settle(segment, u, near, change, h), near
