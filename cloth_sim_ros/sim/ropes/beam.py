# SPDX-License-Identifier: Apache-2.0
"""The direct solve of a rope's bending by one thread, after the solve of its stretch (see chain_solve.py).

Joint j lies between two segments of inverse lengths w0 and w1. The turn vector kappa = w1 (x_j+1 - x_j) - w0 (x_j -
x_j-1) is the difference of their unit tangents. The moment there is M = EI / span (kappa - rest). The force on the
particles is -G^T M with the weights G = (w0, -(w0 + w1), w1). Moments carry over like tensions: the prediction contains
their force, and one solve finds their change. It is linear, and the same for x, y and z: a scalar, symmetric,
pentadiagonal matrix m + G^T (EI / span) G. The solve factors it as L D L^T from one end to the other.

A bent rest shape is given by a length of kappa. The rest vector points along kappa before the substep, turned with the
rope as a whole (see beam_rotation.py). If it pointed along the predicted kappa at each joint, a solve would add energy
to the rope. Moments of a bent rest shape also pull along the segments, where the tension has not met them yet. So they
are not carried over.
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

# Largest ratio of bending stiffness to the particles' inertia. Above it float32 loses the inertia, so it is clamped.
STIFFEST = wp.constant(1.0e5)


class Joints(NamedTuple):
    """Warp functions of joint j of a body (see make_joints)."""

    weights: Callable  # weights of its three particles in its turn vector [1/m]
    stiffness: Callable  # EI / span in units of mass x m^2, limited by STIFFEST
    turn: Callable  # its turn vector
    rest: Callable  # its rest vector, along the turn vector before the substep


@functools.cache
def make_joints(winch: bool) -> Joints:
    """Return the joints of ropes; with `winch`, those on the drum have no weights."""

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
    """Return a Warp function that adds the effect of the last substep's moments to the prediction of particle i.

    bent: True if joints may be bent at rest; it skips these. winch: True for a rope on a winch.
    """
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
    """Return a Warp function that stores the moment at joint j after a solve.

    moves: displacements of its particles, in rows. rotation: rotation of the rest shape, minus the identity. Moments
    are computed before particles are moved. Otherwise they would include rounding of the positions, and give energy to
    stiff ropes.
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
    """Add joint j to the sums of beam_rotation.py; rows of u and y are displacements of its particles."""
    weights = ALL.weights(j, ctx)
    stiff = ALL.stiffness(j, ctx)
    rest = ALL.rest(j, ctx)
    lack = (ALL.turn(j, ctx) - rest) + _turned(u, weights)
    return with_joint(sums, stiff, _turned(y, weights) - rest, lack)


@wp.func
def _turned(moves: wp.mat33, weights: wp.vec3) -> wp.vec3:
    """Return the change of a joint's turn vector by displacements of its three particles."""
    return (moves[2] - moves[1]) * weights[2] - (moves[1] - moves[0]) * weights[0]


def _make_eliminations(bent: bool, winch: bool):
    """Return two Warp functions: elimination and substitution."""
    weights_at, stiffness_at, turn_at, rest_at = make_joints(winch)

    @wp.func
    def eliminate(ctx: Context):
        """Factor the matrix as L D L^T from the first particle to the last, and eliminate the pulls."""
        square = ctx.step.effective * ctx.step.effective
        joints = ctx.body.count - 2
        # The three joints around a particle: the one that it begins (no suffix), is the middle of, and ends.
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
        """Substitute from the last particle to the first, which gives the displacements."""
        one = BeamRow()
        two = BeamRow()
        for r in range(body.count):
            g = body.particles + body.count - 1 - r
            row = s.rope.beam[g]
            # The factors that couple a row to later ones are stored there; all of a pinned row is 0.
            row.move = row.inverse * row.move - one.first * one.move - two.second * two.move
            if wp.static(bent):
                row.turn = row.inverse * row.turn - one.first * one.turn - two.second * two.turn
            s.rope.beam[g] = row
            two = one
            one = row

    return eliminate, substitute


@wp.func
def _rotation(ctx: Context) -> wp.mat33:
    """Return the rotation of the rest shape minus the identity, from the displacements in rows."""
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
    """Return a Warp function in which one thread solves all joints of a body, moves particles and updates moments.

    bent: True if the rope is bent at rest. winch: True to solve only the part of it that is out.
    """
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
