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


# Speeds [m/s] at which an overlap separates: what contact left, and what was placed. A faster one would bend and
# stretch what is around it, which would then spring back.
QUICK, SLOW, UNLIMITED = wp.constant(3.0), wp.constant(0.5), wp.constant(1.0e9)


@wp.struct
class Apart:
    """How an overlap separates in a substep.

    left: so much of it [m] is of what was placed, and separates by `slow` [m] without a velocity. most: largest
    separation of the rest [m].
    """

    most: float
    left: float
    slow: float


@wp.func
def is_measured(ctx: Context) -> bool:
    """Return True if overlaps are measured in this substep, as anything may have been placed since the last one."""
    return ctx.substep == 0 and ctx.frame.wakes > 0


@wp.func
def pace(collider: ColliderMotion, left: float, ctx: Context) -> Apart:
    """Return how overlaps with a collider separate in a substep; left: of what was placed [m].

    With a soft collider they are no error. While they are measured nothing separates.
    """
    apart = Apart()
    apart.most = wp.where(collider.compliance > 0.0, UNLIMITED, QUICK * ctx.step.effective)
    if collider.compliance == 0.0 and collider.squeeze == 0.0:
        apart.left = left
        if is_measured(ctx):
            apart.left = UNLIMITED
        else:
            apart.slow = SLOW * ctx.step.effective
    return apart


@wp.func
def separated(overlap: float, apart: Apart) -> float:
    """Return the part of an overlap [m] that separates in a substep without a velocity [m]."""
    return wp.max(wp.min(wp.min(overlap, apart.left), apart.slow), 0.0)
