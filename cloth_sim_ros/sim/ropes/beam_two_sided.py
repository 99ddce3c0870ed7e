# SPDX-License-Identifier: Apache-2.0
"""The direct solve of a rope's bending by one CPU thread: from both its ends at once, in double precision.

The equations are those of beam.py. Joints and rows are computed four at a time. The elimination is a chain of dependent
quotients. It goes from either end to the two rows in the middle, each side in one half of a vector register.
"""

import warp as wp

from cloth_sim_ros.sim.arrays.context import Context
from cloth_sim_ros.sim.ropes.beam import STIFFEST
from cloth_sim_ros.sim.ropes.beam_rotation import Sums, rotation_of
from cloth_sim_ros.sim.ropes.beam_simd import make_lanes
from cloth_sim_ros.sim.ropes.elimination import FEWEST


def make_solve_beam_two_sided(bent: bool):
    """Return a Warp function that solves all joints of a body, moves its particles and updates the moments.

    It returns False on a GPU or if there are few particles, and then does nothing. bent: True if the rope is bent at
    rest.
    """
    prepare, eliminate, add_up, move = make_lanes(bent)

    @wp.func
    def solve_beam_two_sided(ctx: Context) -> bool:
        if ctx.body.count <= FEWEST or ctx.state.rope.ladder.shape[0] == 0:
            return False
        p = ctx.body.particles
        compliance = ctx.material.compliance[2]
        prepare(
            p,
            ctx.body.segments,
            ctx.body.count,
            ctx.x,
            ctx.d,
            ctx.model.joints,
            ctx.state.rope.moments,
            ctx.state.rope.bend_moves,
            ctx.state.rope.ladder,
            compliance,
            ctx.step.effective,
            STIFFEST,
        )
        eliminate(p, ctx.body.count, ctx.x, ctx.d, ctx.state.rope.ladder)
        rotation = wp.mat33(0.0)
        if wp.static(bent):
            found = add_up(p, ctx.body.count, ctx.x, ctx.d, ctx.state.rope.ladder)
            sums = Sums()
            sums.inertia = wp.matrix_from_rows(found[0], found[1], found[2])
            sums.lag = wp.matrix_from_rows(found[3], found[4], found[5])
            rotation = rotation_of(sums)
        move(
            p,
            ctx.body.segments,
            ctx.body.count,
            ctx.x,
            ctx.d,
            ctx.state.rope.moments,
            ctx.state.rope.bend_moves,
            ctx.state.rope.ladder,
            ctx.step.inverse_square,
            rotation,
        )
        return True

    return solve_beam_two_sided
