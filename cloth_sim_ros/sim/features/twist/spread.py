# SPDX-License-Identifier: Apache-2.0
"""How the twist between two clamps is spread along a rope, and where its bends at rest point.

Torsion waves are far faster than anything else, so that the angles of the material are those of least energy (Bergou et
al. 2008, Discrete Elastic Rods, section 5.1). A rope that is straight at rest has an even twist. One that is bent at
rest turns towards where it is bent. A Newton step a substep follows that.
"""

import warp as wp

from cloth_sim_ros.sim.arrays.context import Context
from cloth_sim_ros.sim.arrays.model import Body, Model
from cloth_sim_ros.sim.arrays.state import Material
from cloth_sim_ros.sim.features.twist.arrays import Twist, TwistState
from cloth_sim_ros.sim.physics.twist import half_binormal, rest_turn

# Angles of the material are known as order 2 extrapolates it to the end of the substep, or LATE, as it begins. If they
# FOLLOW those of the last substep, they tell how the material turns; those AHEAD of late ones turned for two substeps.
FOLLOW = wp.constant(1.0)
AHEAD = wp.constant(0.0)
LATE = wp.constant(-1.0)
RIGID = wp.constant(1.0e-3)  # share of the twist between segments that is left where a clamp holds both


@wp.func
def stiffness_of(j: int, m: Model, body: Body, material: Material, held: wp.vec2i) -> float:
    """Torsional stiffness [N m] between the middles of segments j and j + 1; those that clamps hold do not twist.

    held: number of segments that the clamps at the start and at the end hold. Between two of these it is just large.
    """
    k, free = body.segments + j, body.count - 1 - held[1]
    before, after = m.segment_length[k], m.segment_length[k + 1]
    length = wp.where(j >= held[0] and j < free, before, 0.0) + wp.where(j + 1 >= held[0] and j + 1 < free, after, 0.0)
    return 2.0 / (wp.max(length, RIGID * (before + after)) * material.compliance[1])


@wp.func
def gamma_of(late: bool, ctx: Context) -> float:
    """Time of the dashpots over that since the angles were last known, `late` or not; rates are of first order here."""
    share = wp.where(ctx.step.second, wp.where(late, 1.0 / 3.0, 2.0 / 3.0), 1.0)
    return ctx.material.bend_damping * ctx.step.inverse * share


@wp.func
def twist_before(k: int, s: TwistState) -> float:
    """Twist between two segments in the last substep [rad], from what `carry` of twist.py left."""
    return s.twisted[k + 1].couple[0] - s.twisted[k].couple[0]


@wp.func
def were_late(ctx: Context) -> bool:
    """Return True if the last substep left the angles as they were when it began."""
    return ctx.state.twist.twisted[ctx.body.segments + ctx.body.count - 2].row[1] == LATE


@wp.func
def lag(ctx: Context):
    """Turn the material from its balance by what was written, as a motion begins."""
    s = ctx.state.twist
    for k in range(ctx.body.segments + 1, ctx.body.segments + ctx.body.count - 2):
        s.twisted[k].angle += s.twisted[k].couple[0]


@wp.func
def bend_at(j: int, before: wp.vec3, after: wp.vec3, ctx: Context) -> wp.vec3:
    """Turn of joint j at rest, in world axes now; `before` and `after` are the tangents around it."""
    s, k = ctx.state.twist, ctx.body.segments + j
    angle = 0.5 * (s.twisted[k].angle + s.twisted[k + 1].angle)
    return rest_turn(s.rest_turns[k], s.twisted[k].carried + s.twisted[k + 1].carried, before + after, angle)


@wp.func
def resisted(turn: wp.vec3, spin: float, before: wp.vec3, after: wp.vec3) -> wp.vec3:
    """The turn of a joint a substep ago, as its segments have turned about themselves since, by `spin` in sum."""
    return turn + wp.cross(0.25 * spin * (before + after), turn)


@wp.func
def rigidity_of(k: int, ctx: Context) -> float:
    """Stiffness [N m] in bending of the joint between segments k and k + 1."""
    return 1.0 / wp.max(ctx.material.compliance[2] * ctx.model.joints[k][1], 1.0e-30)


def make_spread(tangent_at, tangent_before):
    """Return a Warp function that finds the angles of the material; tangents are those of twist.py."""

    @wp.func
    def spread(angle: float, held: wp.vec2i, gamma: float, how: float, ctx: Context):
        """Find the angles of the material where the end is turned by `angle`: a Newton step by Thomas's algorithm.

        Dashpots resist its turning by `gamma`, see gamma_of. Each row ends as the angle by which its segment turned
        about itself since angles were last known, and `how`: FOLLOW, AHEAD or LATE.
        """
        s, first, last = ctx.state.twist, ctx.body.segments, ctx.body.count - 2
        was = wp.vec3(0.0)
        start, end = float(s.twisted[first].angle), float(s.twisted[first + last].angle)  # before they are written
        if gamma > 0.0:
            was = tangent_before(0, ctx)
        s.twisted[first].angle = 0.0
        s.twisted[first + last].angle = angle
        s.twisted[first].row = wp.vec2(0.0)
        before, stiff, moment, curved = tangent_at(0, ctx), float(0.0), float(0.0), float(0.0)
        for j in range(last):
            k = first + j
            after = tangent_at(j + 1, ctx)
            bend = bend_at(j, before, after, ctx)
            if gamma > 0.0:
                was_after = tangent_before(j + 1, ctx)
                # A clamp turned its segment already.
                ahead = wp.where(j == 0, -start, 0.0) + wp.where(j == last - 1, angle - end, 0.0)
                bend += gamma * resisted(was_after - was, ahead, before, after)
                was = was_after
            rigidity = rigidity_of(k, ctx)
            # Half the slope and a quarter of the curvature of the bending energy by the angle at the joint.
            pull = 0.5 * rigidity * wp.dot(wp.cross(before, after), bend)
            more = 0.25 * rigidity * wp.max(wp.dot(after - before, bend), 0.0)
            stiff_after = stiffness_of(j, ctx.model, ctx.body, ctx.material, held) * (1.0 + gamma)
            twisted = s.twisted[k + 1].angle - s.twisted[k].angle
            if gamma > 0.0:
                twisted -= gamma / (1.0 + gamma) * twist_before(k, s)
            moment_after = stiff_after * twisted
            if j > 0:
                row = s.twisted[k - 1].row
                lower = curved - stiff
                diagonal = stiff + stiff_after + curved + more - lower * row[0]
                right = moment_after - pull - moment - lower * row[1]
                s.twisted[k].row = wp.vec2((more - stiff_after) / diagonal, right / diagonal)
            stiff, curved, moment = stiff_after, more, moment_after + pull
            before = after
        move = float(0.0)
        for back in range(1, last):
            k = first + last - back
            move = s.twisted[k].row[1] - s.twisted[k].row[0] * move
            s.twisted[k].angle += move
            s.twisted[k].row = wp.vec2(move, how)
        s.twisted[first].row = wp.vec2(-start, how)
        s.twisted[first + last].row = wp.vec2(angle - end, how)

    return spread


def make_bend_joints(tangent_at, tangent_before):
    """Return a Warp function that stores what the twist does to all joints; tangents are those of twist.py."""

    @wp.func
    def half_torque(j: int, before: wp.vec3, after: wp.vec3, gamma: float, ctx: Context) -> float:
        """Half of the torque [N m] about the rope with which the bend of joint j turns its material, and a clamp."""
        s, k = ctx.state.twist, ctx.body.segments + j
        bend = s.bends[k]
        if gamma > 0.0:
            turn = tangent_before(j + 1, ctx) - tangent_before(j, ctx)
            bend += gamma * resisted(turn, s.twisted[k].row[0] + s.twisted[k + 1].row[0], before, after)
        return 0.5 * rigidity_of(k, ctx) * wp.dot(wp.cross(before, after), bend)

    @wp.func
    def bend_joints(twist: Twist, gamma: float, ctx: Context) -> Twist:
        """Store the couples and bends of all joints, and return the twist with its moments."""
        s, last = ctx.state.twist, ctx.body.count - 2
        before, length = tangent_at(0, ctx), float(0.0)
        twist.start_moment = 0.0
        twist.end_moment = 0.0
        for j in range(last):
            k = ctx.body.segments + j
            after = tangent_at(j + 1, ctx)
            s.bends[k] = bend_at(j, before, after, ctx)
            moment = float(0.0)
            if twist.known == 1:
                angle = s.twisted[k + 1].angle - s.twisted[k].angle
                if gamma > 0.0:
                    angle += gamma * (angle - twist_before(k, s))
                moment = stiffness_of(j, ctx.model, ctx.body, ctx.material, twist.held) * angle
            s.twisted[k].couple = moment * half_binormal(before, after)
            if j >= twist.held[0] and j <= last - twist.held[1]:
                length += ctx.model.segment_length[k]
            if twist.known == 1 and j + 1 == twist.held[0]:
                twist.start_moment = moment - half_torque(j, before, after, gamma, ctx)
            if twist.known == 1 and j == last - twist.held[1]:
                twist.end_moment = moment + half_torque(j, before, after, gamma, ctx)
            before = after
        twist.moment = wp.where(twist.known == 1, twist.angle / (length * ctx.material.compliance[1]), 0.0)
        return twist

    return bend_joints
