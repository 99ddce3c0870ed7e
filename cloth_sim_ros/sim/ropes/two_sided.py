# SPDX-License-Identifier: Apache-2.0
"""The direct solve of a chain on a CPU: Newton steps along it, each from both its ends at once (see elimination.py)."""

import warp as wp

from cloth_sim_ros.sim.arrays.context import Context
from cloth_sim_ros.sim.physics.distance import SHORTEST
from cloth_sim_ros.sim.ropes.elimination import FEWEST, eliminate
from cloth_sim_ros.sim.ropes.segment_simd import (
    OVERSTRETCHED,
    TOO_FAR,
    UNSETTLED,
    judge_segments,
    lack_more,
    move_particles,
    prepare_segments,
    stiffen_segments,
)
from cloth_sim_ros.sim.ropes.segments import (
    ATTEMPTS,
    LARGEST_TURN,
    MOST_STRETCHED,
    NEWTON_STEPS,
    SETTLED_SPEED,
    stiffest_of,
)


@wp.func
def prepare_two_sided(ctx: Context) -> bool:
    """Prepare the segments of a chain; return False on a GPU, or if they are few or one has no length."""
    n = ctx.body.segments_end - ctx.body.segments
    if n < FEWEST or ctx.state.rope.ladder.shape[0] == 0:
        return False
    return prepare_segments(
        ctx.body.particles,
        ctx.body.segments,
        n,
        ctx.x,
        ctx.position_lo,
        ctx.d,
        ctx.model.segment_length,
        ctx.state.rope.tensions,
        ctx.state.last_displacements,
        ctx.state.rope.ladder,
        ctx.material.compliance[0],
        ctx.material.damping * ctx.step.inverse,
        ctx.step.effective,
        ctx.step.inverse_square,
        ctx.step.second and ctx.state.last_displacements.shape[0] > 0,
        stiffest_of(ctx),
        SHORTEST,
    )


@wp.func
def solve_two_sided(ctx: Context) -> bool:
    """Take Newton steps along a prepared chain until it settles, see chain_solve.py; True if it was overstretched."""
    n = ctx.body.segments_end - ctx.body.segments
    lacking = not ctx.step.first
    overstretched = bool(False)
    steps = int(0)
    again = bool(True)
    while again:
        if steps > 0:
            lack_more(ctx.body.particles, n, lacking, ctx.state.rope.ladder)
            lacking = True
            prepare_two_sided(ctx)
        events = int(TOO_FAR)
        attempt = int(0)
        while (events & TOO_FAR) != 0 and attempt < ATTEMPTS:
            if attempt > 0:
                stiffen_segments(ctx.body.particles, n, ctx.state.rope.ladder)
            eliminate(ctx.body.particles, n, lacking, ctx.state.rope.ladder)
            settled = SETTLED_SPEED * ctx.step.effective
            events = judge_segments(
                ctx.body.particles, n, lacking, ctx.state.rope.ladder, LARGEST_TURN, settled, MOST_STRETCHED
            )
            overstretched = overstretched or (events & (TOO_FAR | OVERSTRETCHED)) != 0
            attempt += 1
        move_particles(
            ctx.body.particles,
            ctx.body.segments,
            n,
            ctx.d,
            ctx.state.rope.tensions,
            ctx.step.inverse_square,
            ctx.state.rope.ladder,
        )
        steps += 1
        again = (events & UNSETTLED) != 0 and steps < NEWTON_STEPS
    return overstretched
