# SPDX-License-Identifier: Apache-2.0
"""Motion of colliders within a substep, and how far a point slips along one."""

import warp as wp

from cloth_sim_ros.sim.arrays.state import ColliderMotion
from cloth_sim_ros.sim.features.collider_contact.arrays import Sweep
from cloth_sim_ros.sim.physics.integrate import Step
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


# Speed [m/s] at which parts that overlap at the start of a substep separate, as after a fall of half a metre. Without
# this limit, a collider that is placed into a cloth would fling it out within one substep.
SEPARATION = wp.constant(3.0)


@wp.func
def pace(collider: ColliderMotion, step: Step) -> float:
    """Return how far an overlap may separate in a substep [m]; unlimited for a compliant collider."""
    return wp.where(collider.compliance > 0.0, 1.0e9, SEPARATION * step.effective)
