# SPDX-License-Identifier: Apache-2.0
"""Contact of particles with colliders: the stage that keeps a particle outside, with friction."""

import warp as wp

from cloth_sim_ros.sim.arrays.context import Context
from cloth_sim_ros.sim.arrays.model import Features
from cloth_sim_ros.sim.features.collider_contact.arrays import Sweep
from cloth_sim_ros.sim.features.collider_contact.broad_phase import Near, make_near_of, next_of, note, strays
from cloth_sim_ros.sim.features.collider_contact.lean import (
    exact_gap,
    friction_of,
    is_hit,
    past_of,
    settled,
    solved_lean,
)
from cloth_sim_ros.sim.features.collider_contact.part import make_meet, note_parted, parted_of
from cloth_sim_ros.sim.features.collider_contact.pinch import (
    depth_before_middle,
    has_touched,
    is_between,
    is_squeezed,
    note_squeezed,
    share_of_friction,
    slack_of,
)
from cloth_sim_ros.sim.features.collider_contact.strain import TOO_STRAINED, widest_around
from cloth_sim_ros.sim.features.collider_contact.sweep import NOISE, least_gap, slip_of
from cloth_sim_ros.sim.features.grasp.hold import HELD
from cloth_sim_ros.sim.kernels.intrinsics import load4, load_row, pack, store4, store_row, xyz
from cloth_sim_ros.sim.physics.friction import friction_correction, outward
from cloth_sim_ros.sim.physics.integrate import Step, carried

NEARBY = wp.constant(3.0)  # reach of facets from their corners, stretched threefold, in gaps between particles
# Bits that contact returns: a collider may come near the particle in this substep, and one touched it.
CLOSE, TOUCHED = wp.constant(1), wp.constant(2)


@wp.func
def forgotten(past: wp.vec3, now: wp.vec3, normal: wp.vec3, hit: bool) -> wp.vec3:
    """Return the past that BDF2 keeps of a motion `past` that a contact turned into `now`.

    Both are displacements or velocities. Along the normal only `now` counts, or the particle would bounce off with half
    its incoming velocity. In a `hit` the particle approached by as much as it was pressed back. Then `now` replaces all
    of the past, as friction jumps too.
    """
    if hit:
        return now
    return past + wp.dot(now - past, normal) * normal


@wp.func
def lost_motion(displacement: wp.vec3, velocity: wp.vec3, step: Step) -> wp.vec3:
    """Return the correction [m] whose effect on the momentum equals that of this past displacement and velocity.

    Order 2 carries a third of both on, so forgetting them is an impulse too. A first substep has carried no
    displacement on, and the next one carries the velocity on over its own, shorter effective step.
    """
    if step.second:
        return carried(displacement + step.effective * velocity)
    return 0.5 * step.effective * velocity


@wp.func
def length_of(step: Step) -> float:
    """Return the length of a substep [s], which in order 2 is longer than its effective step."""
    return step.effective / wp.where(step.second, 2.0 / 3.0, 1.0)


@wp.struct
class Met:
    """Data of the contacts of particle number `slot`.

    share: factor [1/s^2] from a correction over the inverse mass to a force [N], mean over the frame. near: colliders
    that the body may touch. carries: True if the solve of a rope had corrections of earlier iterations, see lean.py.
    """

    slot: int
    share: float
    near: Near
    carries: bool


@wp.func
def add_force(k: int, force: wp.vec3, ctx: Context):
    """Add a force [N] to that of a collider in this frame so far."""
    forces = ctx.state.contact.contact_forces
    forces[k] = load_row(forces, k) + pack(force, 0.0)


@wp.struct
class Push:
    """Sum over all colliders that press a particle.

    way: sum of pressures along normals [m]. motion: sum of the colliders' displacements [m], weighted by pressure [m].
    pressed: sum of pressures [m]. most, entry: largest pressure [m], and the index of that collider's forces.

    If two fingers press from both sides, their pressures cancel: they stop nothing, and no past is forgotten.
    """

    way: wp.vec3
    motion: wp.vec3
    pressed: float
    most: float
    entry: int


@wp.func
def with_push(push: Push, normal: wp.vec3, pressed: float, motion: wp.vec3, entry: int) -> Push:
    """Return the sum with one more collider, which pressed along `normal` and itself moved by `motion` [m]."""
    more = push
    more.way += pressed * normal
    more.motion += pressed * motion
    more.pressed += pressed
    if pressed >= push.most:
        more.most = pressed
        more.entry = entry
    return more


@wp.func
def forget(met: Met, moved: wp.vec3, push: Push, ctx: Context) -> wp.vec3:
    """Keep only the part of a particle's past that still holds in order 2, after contacts moved it by `moved` [m].

    Returns the correction [m] whose effect on the momentum equals that of the forgotten part.
    """
    step, v = ctx.step, xyz(load_row(ctx.state.velocities, met.slot))
    past = past_of(met.slot, ctx)
    lost = wp.vec3(0.0)
    pressed = wp.length(push.way)
    normal = push.way / wp.max(pressed, 1.0e-20)
    motion = push.motion / wp.max(push.pressed, 1.0e-20)
    if wp.dot(moved - past, normal) > NOISE:
        hit = not met.carries and -wp.dot(past - motion, normal) > 0.5 * pressed
        kept = forgotten(past, moved, normal, hit)
        kept_speed = forgotten(v, moved / length_of(step), normal, hit)
        ctx.state.last_displacements[met.slot] = kept
        store_row(ctx.state.velocities, met.slot, pack(kept_speed, 0.0))
        lost = lost_motion(past - kept, v - kept_speed, step)
    return lost


def least_mass(features: Features) -> float:
    """Return the fraction of its inverse mass above which a contact moves a particle; a held one has less."""
    return HELD if features.handles or features.pinches else 0.0


def _make_before(features: Features):
    """Return a Warp function: the correction [m] that collider c asks already of particle i, in its axes, and its w.

    A rope has that of its solve (see lean.py), or in a second call of a substep (`met.carries` is False) that of the
    first one. A sheet has those of earlier iterations. The last number is above 0 if the collider touched it.
    """

    @wp.func
    def before_of(i: int, c: int, entry: int, w: float, met: Met, ctx: Context) -> wp.vec4:
        before = wp.vec3(0.0)
        if wp.static(features.leans):
            if not met.carries:
                before = (ctx.step.effective * ctx.step.effective) * xyz(load_row(ctx.state.contact.contacts, entry))
            elif ctx.state.contact.leans[entry].contact[3] > 0.0:
                moved = ctx.state.rope.solved[met.slot] - ctx.state.rope.starts[met.slot]
                before = solved_lean(i, c, entry, w, moved, ctx)
        elif not ctx.step.first:
            before = xyz(load_row(ctx.state.contact.contacts, entry))
        return pack(before, wp.where(wp.length_sq(before) > 0.0, 1.0, 0.0))

    return before_of


def _make_correct(features: Features):
    """Return a Warp function: all that a collider corrects a particle by, its move, and what counts as force (3,) [m].

    See `settled` for the arguments.
    """

    @wp.func
    def correct(
        before: wp.vec3,
        n: wp.vec3,
        gap: float,
        slip: wp.vec3,
        softness: float,
        friction: wp.vec3,
        met: Met,
        ctx: Context,
    ):
        pressed = wp.dot(before, n)
        rubbed = before - pressed * n
        pressed += outward(gap, pressed, softness)
        after = pressed * n + friction_correction(slip, rubbed, pressed, friction)
        moved = after - before
        pushed = moved
        if wp.static(features.leans):
            if met.carries and wp.length_sq(before) > 0.0:
                after, moved = settled(before, n, gap, slip, softness, friction)
                pushed = before + moved
            # The last iteration has all of the solve's correction.
            pushed = wp.where(ctx.last, pushed, wp.vec3(0.0))
        return after, moved, pushed

    return correct


@wp.func
def parted_by(pressed: float, overlap: float, n: wp.vec3, sweep: Sweep) -> wp.vec3:
    """Return what of a push [m] along the local normal n ends an overlap [m]."""
    if overlap > 0.0:
        return wp.clamp(pressed, 0.0, overlap) * (wp.transpose(sweep.to_local) * n)
    return wp.vec3(0.0)


def make_leave(features: Features):
    """Return a Warp function that applies the result of colliders to particle i; one of them moves by `motion` [m]."""

    @wp.func
    def leave(i: int, displacement: wp.vec3, push: Push, motion: wp.vec3, met: Met, ctx: Context):
        packed = load4(ctx.d, i)
        w = packed[3]
        if wp.static(features.leans):
            ctx.state.rope.solved[met.slot] += displacement - xyz(packed)
        store4(ctx.d, i, pack(displacement, w))
        if wp.static(features.coupled):
            store_row(ctx.state.self_contact.grounds, met.slot, pack(motion, 1.0))
        if wp.static(features.order == 2):
            if push.pressed > 0.0:
                moved = displacement - xyz(load4(ctx.position_lo, i)) - parted_of(i, ctx)
                add_force(push.entry, (met.share / w) * forget(met, moved, push, ctx), ctx)

    return leave


def _make_pushed(features: Features):
    """Return a Warp function: a Push with one more collider, for the past that BDF2 keeps of a particle's motion.

    What a rope leans on within its solve counts only as it hits the particle.
    """

    @wp.func
    def pushed(
        push: Push, normal: wp.vec3, pressed: float, motion: wp.vec3, entry: int, leaned: bool, met: Met, ctx: Context
    ) -> Push:
        if wp.static(features.leans):
            if leaned and not is_hit(past_of(met.slot, ctx), motion, normal, pressed):
                return push
        if wp.static(features.order == 2):
            return with_push(push, normal, pressed, motion, entry)
        return push

    return pushed


def make_touch(features: Features):
    """Return a Warp function that keeps particle i outside all colliders, with friction.

    It returns bits: CLOSE if a collider may come within `width` [m] in the substep, TOUCHED if one touched it.
    """
    meet, leave = make_meet(features), make_leave(features)
    before_of, correct, leans = _make_before(features), _make_correct(features), features.leans
    pushed_on, least = _make_pushed(features), least_mass(features)

    @wp.func
    def contact(i: int, met: Met, ctx: Context, width: float) -> int:
        material, step = ctx.material, ctx.step
        packed, row = load4(ctx.d, i), load4(ctx.x, i)
        w = packed[3]
        if w <= wp.static(least) * row[3]:
            return CLOSE
        position, displacement = xyz(row), xyz(packed)
        close, touched, push, parted, ground = bool(False), bool(False), Push(), wp.vec3(0.0), wp.vec3(0.0)
        stray = strays(met.near, position + displacement, displacement)
        c = next_of(-1, met.near, stray)
        while c < ctx.colliders.shape[0]:
            k = ctx.sweep + c
            entry = met.slot * ctx.colliders.shape[0] + c
            known = before_of(i, c, entry, w, met, ctx)
            before, acted = xyz(known), known[3] > 0.0
            after, touch = before, float(0.0)
            offset = (position - ctx.state.contact.sweeps[k].position) + displacement
            reach = ctx.colliders[c].reach + material.thickness
            motion, spin = ctx.state.contact.sweeps[k].motion, ctx.state.contact.sweeps[k].spin
            away = least_gap(offset, displacement - motion, spin, reach)
            close = close or (away < width and ctx.colliders[c].facets != 0)
            if away < 0.0 or acted:
                collider = ctx.colliders[c]
                sweep = ctx.state.contact.sweeps[k]
                lo = xyz(load4(ctx.position_lo, i))
                slip = slip_of(position - sweep.position, displacement - lo, sweep)
                p = sweep.to_local * offset
                squeezed, slack, turn = bool(False), float(0.0), float(0.0)
                if wp.static(features.pinches):
                    squeezed = is_squeezed(i, collider, ctx)
                    slack = slack_of(collider, squeezed, has_touched(i, c, ctx))
                thickness = material.thickness + slack
                touching, overlap = meet(i, collider, sweep, p, slip, thickness, ctx)
                gap = touching[3] + slack
                if wp.static(leans):
                    turn = ctx.state.rope.half_turns[met.slot]  # as the solve began; its neighbours move meanwhile
                    gap = slack + exact_gap(touching[3], wp.dot(slip, xyz(touching)), wp.length(offset))
                squeezed = is_between(squeezed, gap, slack, xyz(touching), c, ctx)
                if gap < 0.0 or squeezed or acted:
                    n = xyz(touching)
                    gap += depth_before_middle(squeezed, collider, material.thickness)
                    note_squeezed(squeezed, c, ctx)
                    softness = collider.compliance * step.inverse_square / w
                    tangential = slip - wp.dot(slip, n) * n
                    friction = share_of_friction(squeezed, i, ctx) * friction_of(collider, turn, ctx)
                    after, moved, pushed = correct(before, n, gap, tangential, softness, friction, met, ctx)
                    pressed = wp.dot(after, n)
                    displacement += wp.transpose(sweep.to_local) * moved
                    part = parted_by(pressed, overlap, n, sweep)
                    parted += part
                    counts = wp.transpose(sweep.to_local) * pushed - wp.where(ctx.last, part, wp.vec3(0.0))
                    add_force(entry, (met.share / w) * counts, ctx)
                    touched, touch = True, float(ctx.substep + 2)
                    ground = sweep.motion
                    if stray:
                        note(c, met.near)
                    stray = stray or strays(met.near, position + displacement, displacement)
                    normal, leaned = wp.transpose(sweep.to_local) * n, acted and met.carries
                    push = pushed_on(push, normal, pressed, sweep.motion, entry, leaned, met, ctx)
            if wp.static(leans):
                store_row(ctx.state.contact.contacts, entry, pack(step.inverse_square * after, touch))
            elif step.repeats or (wp.static(features.pinches) and ctx.colliders[c].opposite > 0):
                store_row(ctx.state.contact.contacts, entry, pack(after, touch))
            c = next_of(c, met.near, stray)
        note_parted(i, parted, ctx)
        if touched:
            leave(i, displacement, push, ground, met, ctx)
        return wp.where(close, CLOSE, 0) + wp.where(touched, TOUCHED, 0)

    return contact


def make_met_in(features: Features):
    """Return a Warp function: the Met of the particles of a body; the caller sets `slot`."""
    near_of = make_near_of(features.listed)

    @wp.func
    def met_in(ctx: Context) -> Met:
        met = Met()
        met.share = ctx.step.inverse_square / float(ctx.frame.substeps)
        met.near = near_of(ctx)
        met.carries = wp.static(features.leans)
        return met

    return met_in


def make_contact(features: Features):
    """Return the stage that keeps particle i outside all colliders after each iteration; `met`: see Met."""
    touch = make_touch(features)

    @wp.func
    def contact(i: int, met: Met, ctx: Context):
        width = NEARBY * ctx.body.gap
        if wp.static(features.coupled):
            store_row(ctx.state.self_contact.grounds, met.slot, wp.vec4(0.0))
        found = touch(i, met, ctx, width)
        if wp.static(features.surface):
            if ctx.step.first:
                ctx.state.contact.close[met.slot] = found & CLOSE
        elif wp.static(features.method == "verlet"):
            if found & TOUCHED != 0:
                strain = widest_around(i, ctx) / ctx.body.gap - 1.0
                if strain > TOO_STRAINED:  # it may let the collider through; the frame is repeated, see trial.py
                    wp.atomic_max(ctx.state.trial.strains, 2 * ctx.body.index + 1, strain)

    return contact
