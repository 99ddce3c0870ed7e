"""The direct solve of a chain on a CPU: Newton steps along it, each from both its ends at once (see walks.py)."""

import warp as wp

from cloth_sim_ros.sim.model import Body, Model
from cloth_sim_ros.sim.physics.distance import SHORTEST
from cloth_sim_ros.sim.physics.integrate import Step
from cloth_sim_ros.sim.schedules.segment_lanes import (
    TEARS,
    TOO_FAR,
    UNSETTLED,
    judge_segments,
    lack_more,
    move_particles,
    prepare_segments,
    stiffen_segments,
)
from cloth_sim_ros.sim.schedules.segments import (
    ATTEMPTS,
    LARGEST_TURN,
    NEWTON_STEPS,
    SETTLED_SPEED,
    STIFFEST,
    TORN,
)
from cloth_sim_ros.sim.schedules.walks import FEWEST, walk
from cloth_sim_ros.sim.state import Material, State


@wp.func
def prepare_both_ends(
    m: Model, s: State, body: Body, material: Material, step: Step, x: wp.uint64, low: wp.uint64, d: wp.uint64
) -> bool:
    """What the segments of a chain are as they lie; False where this is no CPU, they are few or one has no length."""
    n = body.segments_end - body.segments
    if n < FEWEST or s.ladder.shape[0] == 0:
        return False
    return prepare_segments(
        body.particles,
        body.segments,
        n,
        x,
        low,
        d,
        m.segment_length,
        s.tensions,
        s.last_displacements,
        s.ladder,
        material.compliance[0],
        material.damping * step.inverse,
        step.effective,
        step.inverse_square,
        step.second and s.last_displacements.shape[0] > 0,
        STIFFEST * body.yielding,
        SHORTEST,
    )


@wp.func
def solve_both_ends(
    m: Model, s: State, body: Body, material: Material, step: Step, x: wp.uint64, low: wp.uint64, d: wp.uint64
) -> bool:
    """Newton steps along a prepared chain until it is settled, see lines.py; whether it was torn."""
    n = body.segments_end - body.segments
    lacking = not step.first
    torn = bool(False)
    steps = int(0)
    again = bool(True)
    while again:
        if steps > 0:
            lack_more(body.particles, n, lacking, s.ladder)
            lacking = True
            prepare_both_ends(m, s, body, material, step, x, low, d)
        events = int(TOO_FAR)
        attempt = int(0)
        while (events & TOO_FAR) != 0 and attempt < ATTEMPTS:
            if attempt > 0:
                stiffen_segments(body.particles, n, s.ladder)
            walk(body.particles, n, lacking, s.ladder)
            settled = SETTLED_SPEED * step.effective
            events = judge_segments(body.particles, n, lacking, s.ladder, LARGEST_TURN, settled, TORN)
            torn = torn or (events & (TOO_FAR | TEARS)) != 0
            attempt += 1
        move_particles(body.particles, body.segments, n, d, s.tensions, step.inverse_square, s.ladder)
        steps += 1
        again = (events & UNSETTLED) != 0 and steps < NEWTON_STEPS
    return torn
