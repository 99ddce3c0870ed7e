# SPDX-License-Identifier: Apache-2.0
"""One segment of a chain in a direct solve: its tangent, and the steps of elimination past it, there and back.

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

# Largest squared turn of a segment by a correction [rad^2]; above it a linear solve is not valid.
LARGEST_TURN = wp.constant(0.09)

# Speed [m/s] of the length error above which another Newton step follows at once. Across, a linear solve leaves a
# segment too long by half the square of its turn. The next substep would undo that at once. A load that far outweighs
# the chain would then hop at that speed, fall into the slack, and gain energy.
SETTLED_SPEED = wp.constant(1.0e-3)

# ATTEMPTS: largest number of solves of a segment that turned too far. Each is stiffer across, as much as the turn
# stretches it (an upper bound of the energy). NEWTON_STEPS: largest number of Newton steps until all is settled.
ATTEMPTS = wp.constant(5)
NEWTON_STEPS = wp.constant(8)

# Smallest compliance of a rigid segment along it, in the tangent, as a fraction of that of a rope's whole mass.
STIFFEST = wp.constant(1.0e-4)

# Largest change of a segment's length in a substep, as a fraction of its length. Beyond it, or after several attempts,
# a chain counts as overstretched.
MOST_STRETCHED = wp.constant(0.02)


@wp.func
def stiffest_of(ctx: Context) -> float:
    """Return the smallest compliance of a segment along it in the tangent [1/kg]."""
    return STIFFEST * (ctx.material.largest_inverse_mass * ctx.body.yielding)


@wp.func
def stiffness_across(segment: Segment) -> float:
    """Return the stiffness across a segment, including the turn of earlier attempts."""
    return segment.across + quick_quotient(wp.min(0.25 * segment.turn, 1.0), segment.along)


def make_prepare(order: int, winch: bool, two_sided: bool):
    """Return a Warp function: the part of segment k's tangent that does not depend on other segments.

    two_sided: True if `way` may be -1. way: 1 to eliminate the chain from its start, -1 from its end. missing: vector
    from the segment's far particle on that way to its place without the chain [m].
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
        held = ctx.state.rope.tensions[index]  # a slow load, so it comes first
        rest = ctx.model.segment_length[index]
        p = load4(ctx.d, k)
        q = load4(ctx.d, k + 1)
        de = xyz(q) - xyz(p)
        e = opened((xyz(load4(ctx.x, k + 1)) - xyz(load4(ctx.x, k))) + de, k)
        square = wp.dot(e, e)
        length = root(square)  # as exact as possible, as the stretch depends on it
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
        # Between a rigid edge and a pinned particle the divisor would vanish. Rounding across the edge would also reach
        # a much stiffer tangent, and the rope would tremble. A tangent much softer than its load lags.
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
    """Return the force that moves the far particle of a passed segment, in mass times length, in its frame."""
    pull = admittance * (segment.frame * q - wp.vec3(segment.gap, 0.0, 0.0)) - wp.vec3(segment.tension, 0.0, 0.0)
    if segment.far > 0.0:
        pull += segment.missing * quick_quotient(1.0, segment.far)
    return pull


@wp.func
def forward(segment: Segment, y: wp.mat33, q: wp.vec3):
    """Pass a segment, from the particle before it with compliance y (segment's frame) and free displacement q.

    Returns the segment with data for the way back, compliance and free displacement of its far particle, and the pull
    on that particle. The pull is in units of mass times length, in the segment's frame. Displacements are in world axes
    because differences of rotated ones would lose digits.
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
    """Return the change of force in a segment if the particle after it moves by u, in the segment's frame."""
    return segment.admittance * (segment.frame * (u - segment.free) + wp.vec3(segment.gap, 0.0, 0.0))


@wp.func
def near_of(segment: Segment, change: wp.vec3) -> wp.vec3:
    """Return the displacement of the particle before a segment if the force in it changes by `change`."""
    return segment.free + wp.transpose(segment.frame) * (segment.compliance * change)


@wp.func
def settle(segment: Segment, u: wp.vec3, near: wp.vec3, change: wp.vec3, h: float) -> Segment:
    """Store the displacement of a segment's far end, its pull and turn, and its events; h: substep length [s]."""
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
    """Return the settled segment and the displacement of the particle before it; the one after it moves by u."""
    change = change_of(segment, u)
    near = near_of(segment, change)
    return settle(segment, u, near, change, h), near
