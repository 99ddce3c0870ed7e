# SPDX-License-Identifier: Apache-2.0
"""Motion of colliders within a substep, and how far a point slips along one."""

import warp as wp

from cloth_sim_ros.sim.arrays.context import Context
from cloth_sim_ros.sim.arrays.state import ColliderMotion
from cloth_sim_ros.sim.features.collider_contact.arrays import Sweep
from cloth_sim_ros.sim.physics.path import bend_at, orientation_at

# Distance [m] below which a motion may be rounding alone. A facet touches a collider where it is that deep: if it were
# let sink so far and then lifted to the surface, each lift would throw it off.
NOISE = wp.constant(1.0e-6)


@wp.func
def sweep_collider(c: ColliderMotion, before: float, after: float) -> Sweep:
    """Return the motion of a collider between two fractions of the frame; one at rest gets no turn by rounding."""
    sweep = Sweep()
    q0 = c.start_orientation
    q1 = c.start_orientation
    moves = wp.length_sq(c.start_orientation - c.end_orientation) > 0.0
    if moves:
        start, end = c.bends.start_turn, c.bends.end_turn
        q0 = orientation_at(before, c.start_orientation, c.end_orientation, start, end)
        q1 = orientation_at(after, c.start_orientation, c.end_orientation, start, end)
    sweep.to_local = wp.transpose(wp.quat_to_matrix(q1))
    if moves:
        sweep.turn = sweep.to_local - wp.transpose(wp.quat_to_matrix(q0))
        sweep.spin = wp.sqrt(wp.ddot(sweep.turn, sweep.turn))
    bend = bend_at(after, c.bends.start, c.bends.end)
    way = c.end_position - c.start_position
    sweep.motion = way * (after - before) + (bend - bend_at(before, c.bends.start, c.bends.end))
    sweep.position = c.start_position + (way * after + bend)
    return sweep


@wp.func
def slip_of(start: wp.vec3, moved: wp.vec3, sweep: Sweep) -> wp.vec3:
    """Return the displacement of a point that moved [m] in the axes of a collider.

    It avoids the difference of two large positions. start: the point when the substep began, relative to the collider
    at its end [m]. For a collider that turns by T and moves by u, the result is R^T_end (moved - u) + T (start + u).
    The collider itself began at -u.
    """
    return sweep.to_local * (moved - sweep.motion) + sweep.turn * (start + sweep.motion)


@wp.func
def least_gap(offset: wp.vec3, moved: wp.vec3, spin: float, reach: float) -> float:
    """Return a bound [m] that is cheap: a point comes no nearer to a collider than that in a substep.

    offset: the point relative to the collider [m]; moved: its displacement relative to the collider's [m]; spin: see
    Sweep; reach: of the collider and of the thickness [m].
    """
    path = wp.length(moved)
    path += spin * (wp.length(offset) + path)
    return wp.length(offset) - path - reach


# Overlap of what is placed, as a fraction of the thickness, from which on it is moved out without a velocity.
SMALL = wp.constant(0.1)
# Speeds [m/s] at which an overlap separates: what contact left, and what was placed. A faster one would bend and
# stretch what is around it, which would then spring back.
QUICK, SLOW, UNLIMITED = wp.constant(3.0), wp.constant(0.5), wp.constant(1.0e9)


@wp.struct
class Apart:
    """How an overlap separates in a substep: by `most` [m], or beyond `small` [m] by `slow` [m] without a velocity."""

    most: float
    small: float
    slow: float


@wp.func
def overlapped(ctx: Context) -> bool:
    """Return True if the body still overlapped a collider in the last substep, after it was placed so."""
    return ctx.state.contact.overlaps_in[2 * ctx.body.index + (ctx.substep + 1) % 2] == ctx.substep


@wp.func
def pace(collider: ColliderMotion, ctx: Context) -> Apart:
    """Return how overlaps with a collider separate in a substep; of a compliant one they are no error.

    A thing may have been placed so in a frame before which anything was changed, but not between two that pinch it.
    """
    apart = Apart()
    apart.most = QUICK * ctx.step.effective
    apart.slow = SLOW * ctx.step.effective
    apart.small = UNLIMITED
    if collider.squeeze == 0.0:
        if overlapped(ctx):
            apart.small = NOISE  # the rest of an overlap
        elif ctx.substep == 0 and ctx.frame.wakes > 0:
            apart.small = SMALL * ctx.material.thickness
    if collider.compliance > 0.0:
        apart.most = UNLIMITED
        apart.small = UNLIMITED
    return apart


@wp.func
def separated(overlap: float, apart: Apart) -> float:
    """Return the part of an overlap [m] that separates in a substep without a velocity [m]."""
    return wp.where(overlap > apart.small, wp.min(overlap, apart.slow), 0.0)
