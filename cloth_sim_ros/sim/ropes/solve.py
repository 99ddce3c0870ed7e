# SPDX-License-Identifier: Apache-2.0
"""The stages of a rope: where its solve starts, and Newton steps of all its segments and joints together.

The solve starts where velocity alone would bring the particles. What was at rest is then still in place, so that
contacts are found as they are. The other forces, which `targets` contain, act within the solve.
"""

import warp as wp

from cloth_sim_ros.sim.arrays.context import Context, note_work
from cloth_sim_ros.sim.arrays.model import Features
from cloth_sim_ros.sim.features.collider_contact.broad_phase import make_near_of
from cloth_sim_ros.sim.features.collider_contact.lean import make_lean, make_lean_between
from cloth_sim_ros.sim.features.grasp.hold import HELD
from cloth_sim_ros.sim.kernels.intrinsics import load4, pack, store4, sync, sync_any, xyz
from cloth_sim_ros.sim.physics.distance import SHORTEST
from cloth_sim_ros.sim.ropes.newton import OVERSTRETCHED, TOO_FAR, UNSETTLED, assemble, eliminate, judge, move, prepare

# Largest squared turn of a segment by a step [rad^2]; above it a linear solve is not valid.
LARGEST_TURN = wp.constant(0.09)

# Speed [m/s] of the length error above which another Newton step follows at once. Across, a linear solve leaves a
# segment too long by half the square of its turn. The next substep would undo that at once. A load that far outweighs
# the rope would then hop at that speed, fall into the slack, and gain energy.
SETTLED_SPEED = wp.constant(1.0e-3)

# ATTEMPTS: largest number of solves of a segment that turned too far. Each is stiffer across, as much as the turn
# stretches it (an upper bound of the energy). NEWTON_STEPS: largest number of Newton steps until all segments are
# settled. Very short ones beside long ones take up to 20, and gain energy after 8. CONTACT_STEPS: likewise of contacts.
# A rod of 100 segments that is dragged has up to 2.5 times Coulomb's friction after eight whole steps. Beyond
# WHOLE_STEPS, and for contacts WHOLE_CONTACT_STEPS, half of a step is taken, as steps go to and fro by then.
ATTEMPTS = wp.constant(5)
NEWTON_STEPS, WHOLE_STEPS = wp.constant(32), wp.constant(20)
CONTACT_STEPS, WHOLE_CONTACT_STEPS = wp.constant(16), wp.constant(8)

PARTICLES, SEGMENTS, ANY = wp.constant(1), wp.constant(2), wp.constant(3)  # kinds of contact

# Cost of a Newton step for a particle, in tests of facets for contact (see prices.py).
TESTS = wp.constant(4.0)

# Smallest compliance of a rigid segment along it, in the matrix, as a fraction of that of a rope's whole mass.
STIFFEST = wp.constant(1.0e-4)

# Largest ratio of a joint's stiffness to its lightest mass: float64 keeps five digits of the masses beside it.
STIFFEST_JOINT = wp.constant(1.0e10)

# Largest change of a segment's length in a substep, as a fraction of its length. Beyond it, or after several attempts,
# a rope counts as overstretched.
MOST_STRETCHED = wp.constant(0.02)


@wp.func
def start(i: int, ctx: Context):
    """Set the target of particle i, and where its solve starts."""
    g = ctx.body.particles + i
    packed = load4(ctx.d, i)
    now = xyz(packed)
    if ctx.step.first:
        ctx.state.rope.targets[g] = now
        # A handle has placed what it holds.
        if packed[3] > HELD * load4(ctx.x, i)[3]:
            now -= ctx.state.rope.falls[g]
        store4(ctx.d, i, pack(now, packed[3]))
    else:
        # Moves since the last solve, as by another object, count as part of the target.
        ctx.state.rope.targets[g] += now - ctx.state.rope.solved[g]


def _make_ready(features: Features, threads: int):
    """Return a Warp function that fills the segments and joints of a rope for a Newton step."""
    beam, winch, second = features.beam, features.winch, features.order == 2

    @wp.func
    def ready(t: int, first: int, ctx: Context):
        fed_segment, length, fed = int(-1), float(0.0), float(0.0)
        if wp.static(winch):
            drum = ctx.state.winch.winches[ctx.body.index]
            fed_segment = int(drum.index)
            length = float(drum.length)
            fed = float(drum.fed)
            if wp.static(second):
                if ctx.step.second:
                    fed -= drum.last_fed / 3.0
        prepare(
            t,
            wp.static(threads),
            ctx.body.index,
            ctx.body.particles,
            ctx.body.segments,
            first,
            ctx.body.count,
            wp.static(beam),
            ctx.x,
            ctx.position_lo,
            ctx.d,
            ctx.model.segment_length,
            ctx.model.joints,
            ctx.state.rope.tensions,
            ctx.state.rope.moments,
            ctx.state.twist.bends,
            ctx.state.twist.twisted,
            ctx.state.last_displacements,
            ctx.state.rope.scratch,
            ctx.material.compliance[0],
            ctx.material.compliance[2],
            ctx.material.damping * ctx.step.inverse,
            ctx.material.bend_damping * ctx.step.inverse,
            ctx.step.effective,
            wp.static(second) and ctx.step.second,
            STIFFEST * (ctx.material.largest_inverse_mass * ctx.body.yielding),
            SHORTEST,
            STIFFEST_JOINT,
            fed_segment,
            length,
            fed,
        )

    return ready


def _make_attempt(features: Features, threads: int):
    """Return a Warp function that solves for the moves of a rope, and returns the thread's events as bits."""
    beam = features.beam

    @wp.func
    def attempt(t: int, first: int, ctx: Context) -> int:
        rope, body = ctx.state.rope, ctx.body
        assemble(
            t,
            wp.static(threads),
            body.index,
            body.particles,
            first,
            body.count,
            wp.static(beam),
            ctx.d,
            rope.targets,
            rope.starts,
            rope.pushes,
            rope.holds,
            body.segments,
            rope.between,
            rope.sewn,
            rope.scratch,
        )
        sync()
        eliminate(t, body.index, body.particles, first, body.count, wp.static(beam), rope.scratch)
        sync()
        settled = SETTLED_SPEED * ctx.step.effective
        return judge(
            t,
            wp.static(threads),
            body.index,
            body.particles,
            first,
            body.count,
            rope.scratch,
            LARGEST_TURN,
            settled,
            MOST_STRETCHED,
        )

    return attempt


def _make_lean_all(features: Features, threads: int):
    """Return a Warp function that finds what touches a rope, of which `kinds`, at solve `k` of a substep.

    With `writes` the next solve takes what is found. Else it returns which kinds of contact have to be solved again.
    """
    near_of, lean = make_near_of(features.listed), make_lean(features)
    lean_between = make_lean_between(features) if features.surface else None

    @wp.func
    def lean_all(t: int, kinds: int, k: int, writes: bool, ctx: Context) -> int:
        if kinds == 0:
            return 0
        near, open, changes = near_of(ctx), int(0), int(0)
        if kinds & PARTICLES != 0:
            for i in range(t, ctx.body.count, wp.static(threads)):
                if lean(i, near, ctx, k, writes):
                    open = PARTICLES
        if wp.static(lean_between is not None):
            sync()
            for j in range(t, ctx.body.count - 1, wp.static(threads)):
                if lean_between(j, near, ctx, writes):
                    changes = SEGMENTS
        if writes:
            return 0
        return wp.where(sync_any(open) != 0, PARTICLES, 0) + wp.where(sync_any(changes) != 0, SEGMENTS, 0)

    return lean_all


@wp.func
def note_steps(t: int, steps: int, ctx: Context):
    """Count Newton steps beyond the first one, which the budget has to pay."""
    if t == 0 and steps > 1:
        note_work(int(TESTS * float((steps - 1) * ctx.body.count)), ctx)


def _make_newton_step(features: Features, threads: int):
    """Return a Warp function that moves a rope by a Newton step, and returns the thread's events as bits."""
    beam, ready, attempt = features.beam, _make_ready(features, threads), _make_attempt(features, threads)

    @wp.func
    def newton_step(t: int, first: int, share: float, ctx: Context) -> int:
        ready(t, first, ctx)
        sync()
        events, count = int(TOO_FAR), int(0)
        while sync_any(events & TOO_FAR) != 0 and count < ATTEMPTS:
            events = attempt(t, first, ctx)
            count += 1
        move(
            t,
            wp.static(threads),
            ctx.body.index,
            ctx.body.particles,
            ctx.body.segments,
            first,
            ctx.body.count,
            wp.static(beam),
            ctx.d,
            ctx.state.rope.tensions,
            ctx.state.rope.moments,
            ctx.state.rope.scratch,
            ctx.step.inverse_square,
            share,
        )
        return events

    return newton_step


def make_solve(features: Features, threads: int):
    """Return the stage in which `threads` threads solve a rope: Newton steps until all segments are settled."""
    winch, newton_step = features.winch, _make_newton_step(features, threads)
    lean_all = _make_lean_all(features, threads) if features.leans else None

    @wp.func
    def solve(t: int, ctx: Context) -> bool:
        first = int(0)
        if wp.static(winch):
            first = ctx.state.winch.winches[ctx.body.index].index
        overstretched, again, unsettled, steps = bool(False), bool(True), bool(False), int(0)
        kinds = int(wp.static(ANY if features.leans else 0))  # of contact that is not settled
        solves = bool(True)  # else a turn looks what the last one left: the compiler emits this search once
        while again:
            left = int(0)
            if wp.static(lean_all is not None):
                left = lean_all(t, kinds, steps, solves, ctx)
            if solves:
                whole = steps < wp.where(kinds == 0, WHOLE_STEPS, WHOLE_CONTACT_STEPS) or steps == CONTACT_STEPS - 1
                events = newton_step(t, first, wp.where(whole, 1.0, 0.5), ctx)
                overstretched = sync_any(events & (TOO_FAR | OVERSTRETCHED)) != 0 or overstretched
                steps += 1
                unsettled = sync_any(events & UNSETTLED) != 0 and steps < NEWTON_STEPS
                solves = steps >= wp.static(int(CONTACT_STEPS) if features.leans else 0)
                kinds = wp.where(solves, 0, ANY)
                again = unsettled or not solves
            else:
                kinds = left
                again = unsettled or kinds != 0
                solves = True
        note_steps(t, steps, ctx)
        return overstretched

    @wp.func
    def chain(t: int, width: int, ctx: Context):
        overstretched = bool(False)
        if t < wp.static(threads):
            overstretched = solve(t, ctx)
            if wp.static(features.leans) or ctx.step.repeats:
                for i in range(t, ctx.body.count, wp.static(threads)):
                    ctx.state.rope.solved[ctx.body.particles + i] = xyz(load4(ctx.d, i))
        if t == 0:
            before = not ctx.step.first and ctx.state.rope.overstretched[ctx.body.index] > 0
            ctx.state.rope.overstretched[ctx.body.index] = wp.where(overstretched or before, 1, 0)

    return chain
