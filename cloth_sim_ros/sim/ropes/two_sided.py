# SPDX-License-Identifier: Apache-2.0
"""The direct solve of a chain on a CPU: Newton steps along it, each from both its ends at once (see elimination.py)."""

import warp as wp

from cloth_sim_ros.sim.arrays.context import Here
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
def prepare_two_sided(here: Here) -> bool:
    """What the segments of a chain are as they lie; False where this is no CPU, they are few or one has no length."""
    n = here.body.segments_end - here.body.segments
    if n < FEWEST or here.state.ladder.shape[0] == 0:
        return False
    return prepare_segments(
        here.body.particles,
        here.body.segments,
        n,
        here.x,
        here.low,
        here.d,
        here.model.segment_length,
        here.state.tensions,
        here.state.last_displacements,
        here.state.ladder,
        here.material.compliance[0],
        here.material.damping * here.step.inverse,
        here.step.effective,
        here.step.inverse_square,
        here.step.second and here.state.last_displacements.shape[0] > 0,
        stiffest_of(here),
        SHORTEST,
    )


@wp.func
def solve_two_sided(here: Here) -> bool:
    """Newton steps along a prepared chain until it is settled, see chain_solve.py; whether it was overstretched."""
    n = here.body.segments_end - here.body.segments
    lacking = not here.step.first
    overstretched = bool(False)
    steps = int(0)
    again = bool(True)
    while again:
        if steps > 0:
            lack_more(here.body.particles, n, lacking, here.state.ladder)
            lacking = True
            prepare_two_sided(here)
        events = int(TOO_FAR)
        attempt = int(0)
        while (events & TOO_FAR) != 0 and attempt < ATTEMPTS:
            if attempt > 0:
                stiffen_segments(here.body.particles, n, here.state.ladder)
            eliminate(here.body.particles, n, lacking, here.state.ladder)
            settled = SETTLED_SPEED * here.step.effective
            events = judge_segments(
                here.body.particles, n, lacking, here.state.ladder, LARGEST_TURN, settled, MOST_STRETCHED
            )
            overstretched = overstretched or (events & (TOO_FAR | OVERSTRETCHED)) != 0
            attempt += 1
        move_particles(
            here.body.particles,
            here.body.segments,
            n,
            here.d,
            here.state.tensions,
            here.step.inverse_square,
            here.state.ladder,
        )
        steps += 1
        again = (events & UNSETTLED) != 0 and steps < NEWTON_STEPS
    return overstretched
