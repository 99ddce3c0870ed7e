# SPDX-License-Identifier: Apache-2.0
"""The direct solve of a rope's bending by many threads: all compute joints and rows, and one eliminates.

The equations are those of beam.py, where one thread does everything in one elimination. The sequential part is small,
and its data lie in shared memory.
"""

import warp as wp

from cloth_sim_ros.sim.arrays.context import Context
from cloth_sim_ros.sim.kernels.intrinsics import load4, quick_quotient, store4, sync, xyz
from cloth_sim_ros.sim.ropes.arrays import BeamRow
from cloth_sim_ros.sim.ropes.beam import ALL, add_joint, make_keep_moment
from cloth_sim_ros.sim.ropes.beam_rotation import SUMS, Sums, rotation_of, sums_of_block, with_particle
from cloth_sim_ros.sim.ropes.scan import scan_size


def rows_of(bent: bool) -> int:
    """Return the vec4 per particle: two of its row and one of the joint that it begins; 5 if rest is bent."""
    return 5 if bent else 3


def most_together(threads: int, bent: bool) -> int:
    """Return the particles of the longest body that `threads` threads solve together in the shared memory of scans."""
    return (scan_size(threads) - (SUMS * threads // 32 if bent else 0)) // rows_of(bent)


@wp.struct
class Joint:
    """One joint: weights of its particles, stiffness, and change of its moment.

    rest: the stiffness times the rest vector, 0 if rest is straight.
    """

    weights: wp.vec3
    change: wp.vec3
    rest: wp.vec3
    stiff: float


def _make_joint_at(bent: bool):
    """Return a Warp function: joint j of a body before a solve."""

    @wp.func
    def joint_at(j: int, ctx: Context) -> Joint:
        joint = Joint()
        joint.weights = ALL.weights(j, ctx)
        joint.stiff = ALL.stiffness(j, ctx)
        turn = ALL.turn(j, ctx)
        if wp.static(bent):
            rest = ALL.rest(j, ctx)
            joint.change = joint.stiff * (turn - rest)
            joint.rest = joint.stiff * rest
        else:
            square = ctx.step.effective * ctx.step.effective
            joint.change = joint.stiff * turn - square * ctx.state.rope.moments[ctx.body.segments + j]
        return joint

    return joint_at


@wp.func
def _row_of(w: float, begun: Joint, near: Joint, far: Joint):
    """Return the row of a particle of inverse mass w, its pull, and the part of the pull from rest vectors alone.

    begun, near, far: the joints that the particle begins, is the middle of, and ends. The row has the diagonal, the
    couplings to the two particles before, and the inertia (0 if pinned).
    """
    row = wp.vec4(0.0)
    pull = wp.vec3(0.0)
    turning = wp.vec3(0.0)
    if w > 0.0:
        below = near.stiff * near.weights[1] * near.weights[0] + far.stiff * far.weights[2] * far.weights[1]
        beyond = far.stiff * far.weights[2] * far.weights[0]
        diagonal = quick_quotient(1.0, w) + begun.stiff * begun.weights[0] * begun.weights[0]
        diagonal += near.stiff * near.weights[1] * near.weights[1] + far.stiff * far.weights[2] * far.weights[2]
        row = wp.vec4(diagonal, below, beyond, quick_quotient(1.0, w))
        pull = -(begun.weights[0] * begun.change + near.weights[1] * near.change + far.weights[2] * far.change)
        turning = begun.weights[0] * begun.rest + near.weights[1] * near.rest + far.weights[2] * far.rest
    return row, pull, turning


def _make_eliminations(bent: bool):
    """Return two Warp functions for one thread: elimination and substitution."""
    width = rows_of(bent)

    @wp.func
    def eliminate(count: int, rows: wp.uint64):
        """Factor the matrix as L D L^T from the first particle to the last, and eliminate the pulls.

        All entries of a pinned row are 0, and so are the couplings of the next two to it.
        """
        one = BeamRow()
        two = BeamRow()
        row = load4(rows, 0)
        pull = load4(rows, 1)
        turning = wp.vec4(0.0)
        if wp.static(bent):
            turning = load4(rows, 3)
        for i in range(count):
            # Load one row ahead, while this one is computed.
            after = width * wp.min(i + 1, count - 1)
            next_row = load4(rows, after)
            next_pull = load4(rows, after + 1)
            ctx = BeamRow()
            ctx.second = row[2] * two.inverse
            ctx.first = (row[1] - ctx.second * two.pivot * one.first) * one.inverse
            left = ctx.first * ctx.first * one.pivot + ctx.second * ctx.second * two.pivot
            ctx.pivot = wp.max(row[0] - left, row[3])
            ctx.inverse = wp.where(row[3] > 0.0, quick_quotient(1.0, wp.max(ctx.pivot, 1.0e-30)), 0.0)
            ctx.move = xyz(pull) - ctx.first * one.move - ctx.second * two.move
            move = ctx.inverse * ctx.move
            store4(rows, width * i, wp.vec4(move[0], move[1], move[2], ctx.first))
            turn = wp.vec3(0.0)
            if wp.static(bent):
                ctx.turn = xyz(turning) - ctx.first * one.turn - ctx.second * two.turn
                turn = ctx.inverse * ctx.turn
                turning = load4(rows, after + 3)
            store4(rows, width * i + 1, wp.vec4(ctx.second, turn[0], turn[1], turn[2]))
            two = one
            one = ctx
            row = next_row
            pull = next_pull

    @wp.func
    def substitute(count: int, rows: wp.uint64):
        """Substitute from the last particle to the first, which gives the displacements."""
        one = wp.vec3(0.0)
        two = wp.vec3(0.0)
        turn_one = wp.vec3(0.0)
        turn_two = wp.vec3(0.0)
        first = float(0.0)
        second = float(0.0)
        ahead = float(0.0)
        row = load4(rows, width * (count - 1))
        coupled = load4(rows, width * (count - 1) + 1)
        for r in range(count):
            i = count - 1 - r
            before = width * wp.max(i - 1, 0)
            next_row = load4(rows, before)
            next_coupled = load4(rows, before + 1)
            move = xyz(row) - first * one - second * two
            store4(rows, width * i, wp.vec4(move[0], move[1], move[2], 0.0))
            two = one
            one = move
            if wp.static(bent):
                turn = wp.vec3(coupled[1], coupled[2], coupled[3]) - first * turn_one - second * turn_two
                store4(rows, width * i + 3, wp.vec4(turn[0], turn[1], turn[2], 0.0))
                turn_two = turn_one
                turn_one = turn
            second = ahead
            first = row[3]
            ahead = coupled[0]
            row = next_row
            coupled = next_coupled

    return eliminate, substitute


def make_solve_beam_together(threads: int, bent: bool):
    """Return a Warp function that all of `threads` threads call together to solve all joints of a body.

    It moves the particles and updates the moments. bent: True if the rope is bent at rest. Its argument `rows` is the
    address of shared memory, for no more than most_together() particles.
    """
    width = rows_of(bent)
    joint_at, keep_moment = _make_joint_at(bent), make_keep_moment(bent)
    eliminate, substitute = _make_eliminations(bent)

    @wp.func
    def shown(j: int, ctx: Context, rows: wp.uint64) -> Joint:
        """Return joint j as a thread has stored it; without stiffness if there is no such joint."""
        joint = Joint()
        if j >= 0 and j < ctx.body.count - 2:
            row = load4(rows, width * j + 2)
            joint.weights = ALL.weights(j, ctx)
            joint.change = xyz(row)
            joint.stiff = row[3]
            if wp.static(bent):
                joint.rest = xyz(load4(rows, width * j + 4))
        return joint

    @wp.func
    def moved(j: int, place: int, rows: wp.uint64) -> wp.mat33:
        """Return the vectors at index `place` of the rows of joint j's particles."""
        first = xyz(load4(rows, width * j + place))
        middle = xyz(load4(rows, width * (j + 1) + place))
        return wp.matrix_from_rows(first, middle, xyz(load4(rows, width * (j + 2) + place)))

    @wp.func
    def rotation(
        t: int,
        ctx: Context,
        rows: wp.uint64,
    ) -> wp.mat33:
        """Return the rotation of the rest shape minus the identity, from the displacements in rows."""
        sums = Sums()
        for i in range(t, ctx.body.count, threads):
            w = load4(ctx.d, i)[3]
            if w > 0.0:
                move = ctx.state.rope.bend_moves[ctx.body.particles + i] + xyz(load4(rows, width * i))
                sums = with_particle(sums, quick_quotient(1.0, w), move, xyz(load4(rows, width * i + 3)))
        for j in range(t, ctx.body.count - 2, threads):
            sums = add_joint(j, ctx, moved(j, 0, rows), moved(j, 3, rows), sums)
        return rotation_of(sums_of_block(t, threads, sums, width * ctx.body.count, rows))

    @wp.func
    def solve_beam_together(
        t: int,
        ctx: Context,
        rows: wp.uint64,
    ):
        joints = ctx.body.count - 2
        for j in range(t, joints, threads):
            joint = joint_at(j, ctx)
            store4(rows, width * j + 2, wp.vec4(joint.change[0], joint.change[1], joint.change[2], joint.stiff))
            if wp.static(bent):
                store4(rows, width * j + 4, wp.vec4(joint.rest[0], joint.rest[1], joint.rest[2], 0.0))
        sync()
        for i in range(t, ctx.body.count, threads):
            begun, near, far = shown(i, ctx, rows), shown(i - 1, ctx, rows), shown(i - 2, ctx, rows)
            row, pull, turning = _row_of(load4(ctx.d, i)[3], begun, near, far)
            store4(rows, width * i, row)
            if wp.static(bent):
                pull -= row[3] * ctx.state.rope.bend_moves[ctx.body.particles + i]
            store4(rows, width * i + 1, wp.vec4(pull[0], pull[1], pull[2], 0.0))
            if wp.static(bent):
                store4(rows, width * i + 3, wp.vec4(turning[0], turning[1], turning[2], 0.0))
        sync()
        if t == 0:
            eliminate(ctx.body.count, rows)
            substitute(ctx.body.count, rows)
        sync()
        turned = wp.mat33(0.0)
        if wp.static(bent):
            turned = rotation(t, ctx, rows)
            for i in range(t, ctx.body.count, threads):
                move = xyz(load4(rows, width * i)) + turned * xyz(load4(rows, width * i + 3))
                store4(rows, width * i, wp.vec4(move[0], move[1], move[2], 0.0))
                ctx.state.rope.bend_moves[ctx.body.particles + i] += move
            sync()
        for j in range(t, joints, threads):
            keep_moment(j, ctx, moved(j, 0, rows), turned)
        sync()
        for i in range(t, ctx.body.count, threads):
            store4(ctx.d, i, load4(ctx.d, i) + load4(rows, width * i))

    return solve_beam_together
