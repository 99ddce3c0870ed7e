# SPDX-License-Identifier: Apache-2.0
"""The direct solve of a rope's bending, beside that of its stretch (see chain_solve.py), by one thread.

Joint j lies between two segments of the inverse lengths w0 and w1. The turn vector kappa = w1 (x_j+1 - x_j) - w0 (x_j -
x_j-1) is the difference of their unit tangents. The moment there is M = EI / span (kappa - rest). The force on the
particles is -G^T M with the same weights G = (w0, -(w0 + w1), w1). Moments carry over like tensions: the prediction
holds their force, and one solve finds by how much they change. It is linear, and the same for x, y and z: a scalar,
symmetric, pentadiagonal matrix m + G^T (EI / span) G. The solve factors it as L D L^T from one end to the other.

A bent rest shape is a length of kappa; rest points where kappa did before the substep, turned with the rope as a whole
(see beam_rotation.py). Where rest pointed along the prediction, joint by joint, a solve would give energy to the rope.
Its moments pull along the segments too, which its tension has not met yet, and are not carried over.
"""

import functools
from collections.abc import Callable
from typing import NamedTuple

import warp as wp

from cloth_sim_ros.sim.arrays.context import Context
from cloth_sim_ros.sim.arrays.model import Body
from cloth_sim_ros.sim.arrays.state import State
from cloth_sim_ros.sim.features.winch.drum import joint_out
from cloth_sim_ros.sim.kernels.intrinsics import larger, load4, quotient, store4, xyz
from cloth_sim_ros.sim.physics.bending import rest_turn
from cloth_sim_ros.sim.ropes.arrays import BeamRow
from cloth_sim_ros.sim.ropes.beam_rotation import Sums, rotation_of, with_joint, with_particle

# Beyond this many times the particles' inertia float32 could not tell the one from the other: stiffer is as stiff.
STIFFEST = wp.constant(1.0e5)


class Joints(NamedTuple):
    """Warp functions of joint j of a body."""

    weights: Callable  # by which its particles turn it [1/m]
    stiffness: Callable  # EI / span in units of mass x m^2, as far as it can be resolved
    turn: Callable  # its turn vector
    rest: Callable  # the one at rest, which points where the turn vector did before the substep


@functools.cache
def make_joints(winch: bool) -> Joints:
    """The joints of ropes, or of ropes on a winch: what is on the drum has none."""

    @wp.func
    def joint_of(j: int, ctx: Context) -> wp.vec4:
        joint = ctx.model.joints[ctx.body.segments + j]
        if wp.static(winch):
            joint = joint_out(j, joint, ctx.state.winch.winches[ctx.body.index])
        return joint

    @wp.func
    def weights_at(j: int, ctx: Context) -> wp.vec3:
        joint = joint_of(j, ctx)
        return wp.vec3(joint[2], -(joint[2] + joint[3]), joint[3])

    @wp.func
    def stiffness_at(j: int, ctx: Context) -> float:
        joint = joint_of(j, ctx)
        middle = joint[2] + joint[3]
        lightest = larger(load4(ctx.d, j)[3], larger(load4(ctx.d, j + 1)[3], load4(ctx.d, j + 2)[3]))
        compliance = ctx.material.compliance[2] * joint[1] * ctx.step.inverse_square
        return quotient(1.0, larger(compliance, lightest * middle * middle / STIFFEST))

    @wp.func
    def turn_at(j: int, ctx: Context) -> wp.vec3:
        joint = joint_of(j, ctx)
        di = xyz(load4(ctx.d, j))
        dj = xyz(load4(ctx.d, j + 1))
        dk = xyz(load4(ctx.d, j + 2))
        first = xyz(load4(ctx.x, j + 1) - load4(ctx.x, j)) + (dj - di)
        last = xyz(load4(ctx.x, j + 2) - load4(ctx.x, j + 1)) + (dk - dj)
        return last * joint[3] - first * joint[2]

    @wp.func
    def rest_at(j: int, ctx: Context) -> wp.vec3:
        joint = joint_of(j, ctx)
        first = xyz(load4(ctx.x, j + 1) - load4(ctx.x, j))
        last = xyz(load4(ctx.x, j + 2) - load4(ctx.x, j + 1))
        return rest_turn(last * joint[3] - first * joint[2], joint[0])

    return Joints(weights_at, stiffness_at, turn_at, rest_at)


ALL = make_joints(winch=False)


def make_bend_by_moments(bent: bool, winch: bool):
    """A Warp function: add to the prediction of particle i what the moments of the last substep do to it, where joints
    are straight at rest."""
    weights_at = make_joints(winch).weights

    @wp.func
    def bend_by_moments(i: int, ctx: Context):
        move = wp.vec3(0.0)
        p = load4(ctx.d, i)
        if p[3] > 0.0:
            joints = ctx.body.count - 2
            force = wp.vec3(0.0)
            for place in range(3):
                j = i - place
                if j >= 0 and j < joints:
                    held = ctx.state.rope.moments[ctx.body.segments + j]
                    if wp.static(bent):
                        held *= wp.where(ctx.model.joints[ctx.body.segments + j][0] > 0.0, 0.0, 1.0)
                    force -= weights_at(j, ctx)[place] * held
            move = (ctx.step.effective * ctx.step.effective * p[3]) * force
            store4(ctx.d, i, p + wp.vec4(move[0], move[1], move[2], 0.0))
        if wp.static(bent):
            ctx.state.rope.bend_moves[ctx.body.particles + i] = move

    return bend_by_moments


def make_keep_moment(bent: bool, winch: bool = False):
    """A Warp function: the moment at joint j after a solve. Its particles are to move by the rows of `moves`, and the
    rest shape turned by `rotation` + 1.

    Told before they are moved: with what rounds their places moments would know more than they did, and give stiff
    ropes energy.
    """
    weights_at, stiffness_at, turn_at, rest_at = make_joints(winch)

    @wp.func
    def keep_moment(
        j: int,
        ctx: Context,
        moves: wp.mat33,
        rotation: wp.mat33,
    ):
        stiff = stiffness_at(j, ctx)
        turn = turn_at(j, ctx) + _turned(moves, weights_at(j, ctx))
        if wp.static(bent):
            rest = rest_at(j, ctx)
            turn -= rest + rotation * rest
        ctx.state.rope.moments[ctx.body.segments + j] = (stiff * ctx.step.inverse_square) * turn

    return keep_moment


@wp.func
def add_joint(
    j: int,
    ctx: Context,
    u: wp.mat33,
    y: wp.mat33,
    sums: Sums,
) -> Sums:
    """The sums of beam_rotation.py with joint j, whose particles the rows of u and y move."""
    weights = ALL.weights(j, ctx)
    stiff = ALL.stiffness(j, ctx)
    rest = ALL.rest(j, ctx)
    lack = (ALL.turn(j, ctx) - rest) + _turned(u, weights)
    return with_joint(sums, stiff, _turned(y, weights) - rest, lack)


@wp.func
def _turned(moves: wp.mat33, weights: wp.vec3) -> wp.vec3:
    """By how much three particles that move turn their joint."""
    return (moves[2] - moves[1]) * weights[2] - (moves[1] - moves[0]) * weights[0]


def _make_eliminations(bent: bool, winch: bool):
    """Two Warp functions: elimination, and substitution."""
    weights_at, stiffness_at, turn_at, rest_at = make_joints(winch)

    @wp.func
    def eliminate(ctx: Context):
        """From the first particle to the last: L D L^T, and what it makes of the pulls."""
        square = ctx.step.effective * ctx.step.effective
        joints = ctx.body.count - 2
        # The three joints around a particle, the one that it begins, is the middle of, and ends.
        near = wp.vec3(0.0)
        change_near = wp.vec3(0.0)
        rest_near = wp.vec3(0.0)
        stiff_near = float(0.0)
        far = wp.vec3(0.0)
        change_far = wp.vec3(0.0)
        rest_far = wp.vec3(0.0)
        stiff_far = float(0.0)
        one = BeamRow()
        two = BeamRow()
        for i in range(ctx.body.count):
            weights = wp.vec3(0.0)
            change = wp.vec3(0.0)
            rest = wp.vec3(0.0)
            stiff = float(0.0)
            if i < joints:
                weights = weights_at(i, ctx)
                stiff = stiffness_at(i, ctx)
                turn = turn_at(i, ctx)
                if wp.static(bent):
                    rest = rest_at(i, ctx)
                    change = stiff * (turn - rest)
                    rest *= stiff
                else:
                    change = stiff * turn + (-square) * ctx.state.rope.moments[ctx.body.segments + i]
            w = load4(ctx.d, i)[3]
            row = BeamRow()
            if w > 0.0:
                below = stiff_near * near[1] * near[0] + stiff_far * far[2] * far[1]
                beyond = stiff_far * far[2] * far[0]
                diagonal = quotient(1.0, w) + stiff * weights[0] * weights[0]
                diagonal += stiff_near * near[1] * near[1] + stiff_far * far[2] * far[2]
                row.second = beyond * two.inverse
                row.first = (below - row.second * two.pivot * one.first) * one.inverse
                left = row.first * row.first * one.pivot + row.second * row.second * two.pivot
                row.pivot = larger(diagonal - left, quotient(1.0, w))
                row.inverse = quotient(1.0, row.pivot)
                pull = -(weights[0] * change + near[1] * change_near + far[2] * change_far)
                if wp.static(bent):
                    pull -= quotient(1.0, w) * ctx.state.rope.bend_moves[ctx.body.particles + i]
                row.move = pull - row.first * one.move - row.second * two.move
                if wp.static(bent):
                    turning = weights[0] * rest + near[1] * rest_near + far[2] * rest_far
                    row.turn = turning - row.first * one.turn - row.second * two.turn
            ctx.state.rope.beam[ctx.body.particles + i] = row
            two = one
            one = row
            far = near
            change_far = change_near
            rest_far = rest_near
            stiff_far = stiff_near
            near = weights
            change_near = change
            rest_near = rest
            stiff_near = stiff

    @wp.func
    def substitute(s: State, body: Body):
        """From the last particle to the first: how they move."""
        one = BeamRow()
        two = BeamRow()
        for r in range(body.count):
            g = body.particles + body.count - 1 - r
            row = s.rope.beam[g]
            # What couples a row to those behind it is theirs; all of a pinned one is 0.
            row.move = row.inverse * row.move - one.first * one.move - two.second * two.move
            if wp.static(bent):
                row.turn = row.inverse * row.turn - one.first * one.turn - two.second * two.turn
            s.rope.beam[g] = row
            two = one
            one = row

    return eliminate, substitute


@wp.func
def _rotation(ctx: Context) -> wp.mat33:
    """By how much the rest shape turns, less 1, when rows tell how particles move."""
    sums = Sums()
    for i in range(ctx.body.count):
        row = ctx.state.rope.beam[ctx.body.particles + i]
        w = load4(ctx.d, i)[3]
        if w > 0.0:
            sums = with_particle(
                sums, quotient(1.0, w), ctx.state.rope.bend_moves[ctx.body.particles + i] + row.move, row.turn
            )
    for j in range(ctx.body.count - 2):
        first = ctx.state.rope.beam[ctx.body.particles + j]
        middle = ctx.state.rope.beam[ctx.body.particles + j + 1]
        last = ctx.state.rope.beam[ctx.body.particles + j + 2]
        u = wp.matrix_from_rows(first.move, middle.move, last.move)
        y = wp.matrix_from_rows(first.turn, middle.turn, last.turn)
        sums = add_joint(j, ctx, u, y, sums)
    return rotation_of(sums)


def make_solve_beam(bent: bool, winch: bool):
    """A Warp function: one solve over all joints of a body, `bent` at rest or straight, or of what is out of a `winch`,
    by one thread; it moves the particles and changes the moments."""
    keep_moment = make_keep_moment(bent, winch)
    eliminate, substitute = _make_eliminations(bent, winch)

    @wp.func
    def solve_beam(ctx: Context):
        eliminate(ctx)
        substitute(ctx.state, ctx.body)
        rotation = wp.mat33(0.0)
        if wp.static(bent):
            rotation = _rotation(ctx)
            for i in range(ctx.body.count):
                row = ctx.state.rope.beam[ctx.body.particles + i]
                row.move += rotation * row.turn
                ctx.state.rope.bend_moves[ctx.body.particles + i] += row.move
                ctx.state.rope.beam[ctx.body.particles + i] = row
        for j in range(ctx.body.count - 2):
            g = ctx.body.particles + j
            moves = wp.matrix_from_rows(
                ctx.state.rope.beam[g].move, ctx.state.rope.beam[g + 1].move, ctx.state.rope.beam[g + 2].move
            )
            keep_moment(j, ctx, moves, rotation)
        for i in range(ctx.body.count):
            p = load4(ctx.d, i)
            if p[3] > 0.0:
                move = ctx.state.rope.beam[ctx.body.particles + i].move
                store4(ctx.d, i, p + wp.vec4(move[0], move[1], move[2], 0.0))

    return solve_beam
