# SPDX-License-Identifier: Apache-2.0
"""Twist along a rope between two clamps.

At the start of a substep one thread computes the torsional moment. Its sideways forces are part of what the solve of
the rope aims at.

Twist is explicit beside an implicit bending stiffness EI. It is taken at the positions that order 2 extrapolates to (as
in semi-implicit BDF2: Ascher, Ruuth, Wetton 1995). This is stable if M k^3 < EI k^4 + 4 mu / h^2 for every wave number
k. The load at which a rope buckles does not depend on the step.
"""

import warp as wp

from cloth_sim_ros.sim.arrays.context import Context
from cloth_sim_ros.sim.arrays.model import Body, Model
from cloth_sim_ros.sim.arrays.state import State
from cloth_sim_ros.sim.features.twist.arrays import Twist
from cloth_sim_ros.sim.features.twist.clamps import clamp, clamped_by, held_by, start_of, turn_clamps, without_twist
from cloth_sim_ros.sim.features.twist.spread import (
    AHEAD,
    FOLLOW,
    LATE,
    gamma_of,
    lag,
    make_bend_joints,
    make_spread,
    were_late,
)
from cloth_sim_ros.sim.kernels.intrinsics import load4, load_row, store4, xyz
from cloth_sim_ros.sim.physics.twist import FOLDED, angle_about, carried_across, small_angle_about, wrap_angle


def make_tangents(order: int):
    """Return two Warp functions: the unit tangent of segment k as the substep begins, and that a substep before.

    Order 2 extrapolates both, by a substep.
    """

    @wp.func
    def edge_of(k: int, ctx: Context) -> wp.vec3:
        return xyz(load4(ctx.x, k + 1) - load4(ctx.x, k)) + xyz(
            load4(ctx.position_lo, k + 1) - load4(ctx.position_lo, k)
        )

    @wp.func
    def tangent_at(k: int, ctx: Context) -> wp.vec3:
        g = ctx.body.particles + k
        e = edge_of(k, ctx)
        if wp.static(order == 2):
            if ctx.step.second:
                e += ctx.state.last_displacements[g + 1] - ctx.state.last_displacements[g]
        return wp.normalize(e)

    @wp.func
    def tangent_before(k: int, ctx: Context) -> wp.vec3:
        g = ctx.body.particles + k
        e = edge_of(k, ctx)
        if wp.static(order == 1):
            e -= ctx.step.effective * xyz(load_row(ctx.state.velocities, g + 1) - load_row(ctx.state.velocities, g))
        elif were_late(ctx):
            e -= ctx.state.last_displacements[g + 1] - ctx.state.last_displacements[g]
        return wp.normalize(e)

    return tangent_at, tangent_before


@wp.func
def push_of(i: int, m: Model, s: State, body: Body) -> wp.vec3:
    """Return the force [N] of the twist on particle i, from the couples around it."""
    force = wp.vec3(0.0)
    for place in range(3):
        j = i - place
        if j >= 0 and j < body.count - 2:
            joint = m.joints[body.segments + j]
            weight = wp.where(place == 0, joint[2], wp.where(place == 1, joint[3] - joint[2], -joint[3]))
            force += weight * s.twist.twisted[body.segments + j].couple
    return force


@wp.func
def push_by_couples(i: int, ctx: Context):
    """Add the effect of the couples around particle i to its prediction; its solve starts without it, see `falls`."""
    p = load4(ctx.d, i)
    if p[3] == 0.0:
        return
    move = (ctx.step.effective * ctx.step.effective * p[3]) * push_of(i, ctx.model, ctx.state, ctx.body)
    store4(ctx.d, i, p + wp.vec4(move[0], move[1], move[2], 0.0))
    ctx.state.rope.falls[ctx.body.particles + i] += move


def _make_twist_anew(tangent_at, tangent_before):
    """Return a Warp function that finds the total twist of a body; see make_find_twist."""

    @wp.func
    def carry(k: int, u: wp.vec3, t: wp.vec3, follows: bool, ctx: Context):
        """Store the carried vector u of segment k, whose tangent is t.

        If it `follows`, the angle becomes that of a material which did not turn about the segment since the last
        substep. The one before goes to `couple`.
        """
        s, i = ctx.state.twist, ctx.body.segments + k
        if follows:
            was, before, angle = s.twisted[i].carried, tangent_before(k, ctx), s.twisted[i].angle
            still = was - wp.dot(was, t) / wp.max(1.0 + wp.dot(before, t), FOLDED) * (before + t)
            s.twisted[i].couple = wp.vec3(angle, 0.0, 0.0)
            s.twisted[i].angle = angle - small_angle_about(t, still, u)
        s.twisted[i].carried = u

    @wp.func
    def twist_anew(follows: bool, ctx: Context) -> Twist:
        """Return the twist at the present positions, and carry the vector of its start along the rope.

        At first, and after positions were set, the only twist is the angle by which the end is turned. After a new
        clamping there is none.
        """
        twist = ctx.state.twist.twists[ctx.body.index]
        last = ctx.body.count - 2
        start_by = clamped_by(0, 1, ctx)
        end_by = clamped_by(last + 1, last, ctx)
        clamped = start_by != 0 and end_by != 0
        before = tangent_at(0, ctx)
        if not clamped:
            twist = without_twist(twist, before)
        elif twist.known == 1:
            twist = turn_clamps(twist, start_by, end_by, before, tangent_at(last, ctx), ctx)
        else:
            twist.start = start_of(twist, before)
        u = twist.start
        carry(0, u, before, follows, ctx)
        for k in range(1, last + 1):
            after = tangent_at(k, ctx)
            u = carried_across(u, before, after)
            carry(k, u, after, follows, ctx)
            if not clamped:
                ctx.state.twist.twisted[ctx.body.segments + k].angle = 0.0
                ctx.state.twist.twisted[ctx.body.segments + k].row = wp.vec2(0.0, LATE)
            before = after
        if clamped:
            twist.held = held_by(start_by, end_by, ctx)
            if twist.known != 1:
                twist = clamp(twist, start_by, end_by, tangent_at(0, ctx), before, u, ctx)
            # The end may be turned by any angle; the writhe changes by less than half a turn between two substeps.
            turned = twist.angle + (twist.wanted - twist.turned)
            twist.angle = turned + wrap_angle(angle_about(before, u, twist.end) + twist.wanted - turned)
            twist.turned = twist.wanted
        return twist

    return twist_anew


def make_find_twist(order: int):
    """Return a Warp function in which one thread computes the twist of a body and the couples of its joints.

    order: order of the time integration.
    """
    tangent_at, tangent_before = make_tangents(order)
    twist_anew = _make_twist_anew(tangent_at, tangent_before)
    spread, bend_joints = make_spread(tangent_at, tangent_before), make_bend_joints(tangent_at, tangent_before)

    @wp.func
    def find_twist(i: int, ctx: Context):
        ctx.state.twist.twists[ctx.body.index].wanted = ctx.turn
        before = ctx.state.twist.twists[ctx.body.index]
        # Dashpots act in the material, if it is known how that turned since the last substep.
        follows = ctx.material.bend_damping > 0.0 and before.known == 1 and before.wanted == before.turned
        late, gamma, how = were_late(ctx), float(0.0), float(AHEAD)
        if follows:
            gamma = gamma_of(late, ctx)
            how = wp.where(late and ctx.step.second, AHEAD, FOLLOW)
        if (wp.static(order == 2) or not follows) and not ctx.step.second:
            how = LATE
        twist = twist_anew(follows, ctx)
        if twist.known == 1:
            spread(twist.angle, twist.held, gamma, how, ctx)
            if before.known == 0:
                lag(ctx)
        ctx.state.twist.twists[ctx.body.index] = bend_joints(twist, gamma, ctx)

    return find_twist
