# SPDX-License-Identifier: Apache-2.0
"""Contact of particles with colliders: the stage that keeps a particle outside, with friction."""

import warp as wp

from cloth_sim_ros.sim.arrays.context import Context
from cloth_sim_ros.sim.arrays.model import Features
from cloth_sim_ros.sim.arrays.state import ColliderMotion
from cloth_sim_ros.sim.features.collider_contact.arrays import Sweep
from cloth_sim_ros.sim.features.collider_contact.broad_phase import Near, make_near_of, next_of, note, strays
from cloth_sim_ros.sim.features.collider_contact.ccd import make_ccd
from cloth_sim_ros.sim.features.collider_contact.sweep import slip_of
from cloth_sim_ros.sim.features.collider_contact.thickness import NEARBY, make_thickness_for, note_strain, widest_around
from cloth_sim_ros.sim.features.grasp.hold import HELD
from cloth_sim_ros.sim.kernels.intrinsics import load4, load_row, pack, store4, store_row, xyz
from cloth_sim_ros.sim.physics.friction import friction_correction, outward
from cloth_sim_ros.sim.physics.integrate import Step, carried

# [m/s] at which what overlaps at the start of a substep comes apart, as after a fall of half a metre. A collider that
# is placed into a cloth would otherwise fling it out within one substep.
SEPARATION = wp.constant(3.0)
# Of a support, what carries over to the next substep. If all did, a chain and a collider would wind one another up.
CARRIED = wp.constant(0.95)
NOISE = wp.constant(1.0e-6)  # [m] a motion of this size may be rounding alone
# Bits of what contact tells of a particle: a collider may come near it in this substep, and one touched it.
CLOSE, TOUCHED = wp.constant(1), wp.constant(2)


@wp.func
def forgotten(past: wp.vec3, now: wp.vec3, normal: wp.vec3, hit: bool) -> wp.vec3:
    """What BDF2 may remember of a motion `past` that a contact turned into `now`, both displacements or velocities.

    Across the surface only what is now counts, or the particle would bounce off with half the velocity that it came
    with. In a `hit` it came by as much as it was pressed back. There that holds for friction's jump as well.
    """
    if hit:
        return now
    return past + wp.dot(now - past, normal) * normal


@wp.func
def lost_motion(displacement: wp.vec3, velocity: wp.vec3, step: Step) -> wp.vec3:
    """The correction [m] that has the effect on the momentum of a past without this displacement and velocity.

    Order 2 carries a third of both on, so that what a contact makes it forget is an impulse too.
    """
    return carried(displacement + step.effective * velocity)


@wp.func
def length_of(step: Step) -> float:
    """The length of a substep [s], which in order 2 is more than its effective step."""
    return step.effective / wp.where(step.second, 2.0 / 3.0, 1.0)


@wp.func
def pace(collider: ColliderMotion, step: Step) -> float:
    """How far an overlap may come apart in a substep [m]; a compliant collider flings nothing by itself."""
    return wp.where(collider.compliance > 0.0, 1.0e9, SEPARATION * step.effective)


@wp.struct
class Met:
    """Where it is kept what particle number `slot` meets: which colliders are near, their motion from `first_sweep` on,
    what earlier iterations did, and forces [N], which are corrections over the inverse mass times `share` [1/s^2].
    colliders: those of the world. carries: whether what supported the particle in the last substep is in its way."""

    slot: int
    first_sweep: int
    share: float
    near: Near
    colliders: wp.array(dtype=ColliderMotion)
    sweeps: wp.array(dtype=Sweep)
    contacts: wp.array(dtype=wp.vec4)
    forces: wp.array(dtype=wp.vec4)
    velocities: wp.array(dtype=wp.vec4)
    last_displacements: wp.array(dtype=wp.vec3)
    supports: wp.array(dtype=wp.vec4)
    carries: bool


@wp.func
def larger_support(support: wp.vec4, push: wp.vec3, c: int) -> wp.vec4:
    """Whichever is more: that, or the push of collider c [m], with 1 + its number."""
    return wp.where(wp.length_sq(push) > wp.length_sq(xyz(support)), pack(push, float(c + 1)), support)


@wp.func
def share_of(step: Step, substeps: int) -> float:
    """What a correction over the inverse mass is multiplied by to be a force, mean over `substeps` [1/s^2]."""
    return step.inverse_square / float(substeps)


@wp.func
def add_force(forces: wp.array(dtype=wp.vec4), k: int, force: wp.vec3):
    """Add a force [N] to what a collider did in this frame so far."""
    forces[k] = load_row(forces, k) + pack(force, 0.0)


@wp.struct
class Push:
    """How far all colliders together pressed a particle [m], how far they moved meanwhile [m], each weighed by its
    pressure, the sum of these, and where forces of the one that pressed most are kept.

    What two fingers press from both sides is pressed by neither: they stop nothing, and no past of it is forgotten.
    """

    way: wp.vec3
    motion: wp.vec3
    pressed: float
    most: float
    entry: int


@wp.func
def with_push(push: Push, normal: wp.vec3, pressed: float, motion: wp.vec3, entry: int) -> Push:
    """The same and one more collider, which pressed along `normal` and itself moved by `motion` [m]."""
    more = push
    more.way += pressed * normal
    more.motion += pressed * motion
    more.pressed += pressed
    if pressed >= push.most:
        more.most = pressed
        more.entry = entry
    return more


@wp.func
def forget(met: Met, moved: wp.vec3, push: Push, step: Step) -> wp.vec3:
    """Of the past of a particle that contacts moved by `moved` [m] in all, keep only what still holds in order 2.

    Returns the correction [m] that has the effect on the momentum of what is forgotten.
    """
    past = met.last_displacements[met.slot]
    lost = wp.vec3(0.0)
    pressed = wp.length(push.way)
    normal = push.way / wp.max(pressed, 1.0e-20)
    motion = push.motion / wp.max(push.pressed, 1.0e-20)
    if wp.dot(moved - past, normal) > NOISE:
        hit = -wp.dot(past - motion, normal) > 0.5 * pressed
        v = xyz(load_row(met.velocities, met.slot))
        kept = forgotten(past, moved, normal, hit)
        kept_speed = forgotten(v, moved / length_of(step), normal, hit)
        met.last_displacements[met.slot] = kept
        store_row(met.velocities, met.slot, pack(kept_speed, 0.0))
        # While a chain leans on a collider, its substeps are of first order, and carry no past on.
        if step.second or met.supports.shape[0] == 0:
            lost = lost_motion(past - kept, v - kept_speed, step)
    return lost


def least_mass(features: Features) -> float:
    """Of its own inverse mass, what a particle has to have left to be moved by a contact: more than if it is held."""
    return HELD if features.handles else 0.0


def _make_support(features: Features):
    """Warp functions: how a collider supports a particle since the last substep, in its axes [m], whether it does, and
    what lets go of it. Nothing supports what `features` do not say."""

    @wp.func
    def carried_by(c: int, met: Met, step: Step, sweep: Sweep) -> wp.vec3:
        carried = wp.vec3(0.0)
        if wp.static(features.supported):
            support = load_row(met.supports, met.slot)
            if met.carries and int(support[3]) == c + 1:
                carried = (step.effective * step.effective) * (sweep.to_local * xyz(support))
        return carried

    @wp.func
    def is_supported(before: wp.vec3) -> bool:
        return wp.static(features.supported) and wp.length_sq(before) > 0.0

    @wp.func
    def let_go(met: Met):
        if wp.static(features.supported):
            met.supports[met.slot] = wp.vec4(0.0)

    return carried_by, is_supported, let_go


def _make_leave(features: Features):
    """A Warp function that moves particle i as colliders have it, and keeps how the one that pushes most does so."""

    @wp.func
    def leave(
        i: int,
        lo: wp.uint64,
        d: wp.uint64,
        displacement: wp.vec3,
        push: Push,
        support: wp.vec4,
        met: Met,
        step: Step,
    ):
        w = load4(d, i)[3]
        if wp.static(features.supported):
            if met.carries:
                held = pack((CARRIED * step.inverse_square) * xyz(support), support[3])
                store_row(met.supports, met.slot, held)
        store4(d, i, pack(displacement, w))
        if wp.static(features.order == 2):
            if push.pressed > 0.0:
                moved = displacement - xyz(load4(lo, i))
                add_force(met.forces, push.entry, (met.share / w) * forget(met, moved, push, step))

    return leave


def make_touch(features: Features):
    """A Warp function that keeps particle i outside all colliders, with friction.

    Returns bits of whether one of them may come within a `width` [m] of it in the substep, and whether one touched it.
    """
    meet, leave = make_ccd(features.shapes), _make_leave(features)
    carried_by, is_supported, let_go = _make_support(features)
    least, thickness_for = least_mass(features), make_thickness_for(features)

    @wp.func
    def contact(i: int, met: Met, ctx: Context, width: float) -> int:
        material, step = ctx.material, ctx.step
        packed = load4(ctx.d, i)
        row = load4(ctx.x, i)
        w = packed[3]
        if w <= wp.static(least) * row[3]:
            let_go(met)
            return CLOSE
        close = bool(False)
        position = xyz(row)
        displacement = xyz(packed)
        touched = bool(False)
        push, support = Push(), wp.vec4(0.0)
        known = wp.vec2(0.0)
        stray = strays(met.near, position + displacement, displacement)
        c = next_of(-1, met.near, stray)
        while c < met.colliders.shape[0]:
            k = met.first_sweep + c
            entry = met.slot * met.colliders.shape[0] + c
            before = wp.vec3(0.0)
            if step.first:
                before = carried_by(c, met, step, met.sweeps[k])
            else:
                before = xyz(load_row(met.contacts, entry))
            after = before
            # Most particles are farther from the collider than both can move in a substep: a few numbers tell.
            offset = (position - met.sweeps[k].position) + displacement
            path = wp.length(displacement - met.sweeps[k].motion)
            path += met.sweeps[k].spin * (wp.length(offset) + path)
            away = wp.length(offset) - path - met.colliders[c].reach - material.thickness
            close = close or (away < width and met.colliders[c].facets != 0)
            known = thickness_for(i, met.colliders[c].roundness, away, known[1], ctx)
            thickness = known[0]
            away -= thickness - material.thickness
            if away < 0.0 or is_supported(before):
                collider = met.colliders[c]
                sweep = met.sweeps[k]
                lo = xyz(load4(ctx.position_lo, i))
                slip = slip_of(position - sweep.position, displacement - lo, sweep)
                p = sweep.to_local * offset
                # What it is thicker by than a moment ago was no overlap before.
                apart = pace(collider, step) + (thickness - material.thickness)
                touching = meet(collider.shape, collider.size, collider.data, p, slip, thickness, apart)
                gap = touching[3]
                if gap < 0.0 or is_supported(before):
                    n = xyz(touching)
                    pressed = wp.dot(before, n)
                    rubbed_before = before - pressed * n
                    pressed += outward(gap, pressed, collider.compliance * step.inverse_square / w)
                    tangential = slip - wp.dot(slip, n) * n
                    mu_s = wp.sqrt(material.static_friction * collider.static_friction)
                    mu_k = wp.sqrt(material.kinetic_friction * collider.kinetic_friction)
                    after = pressed * n + friction_correction(tangential, rubbed_before, pressed, mu_s, mu_k)
                    displacement += wp.transpose(sweep.to_local) * (after - before)
                    # What is carried over acts in this substep, as what is added does.
                    pushed = wp.transpose(sweep.to_local) * wp.where(step.first, after, after - before)
                    add_force(met.forces, entry, (met.share / w) * pushed)
                    support = larger_support(support, wp.transpose(sweep.to_local) * after, c)
                    touched = True
                    if stray:
                        note(c, met.near)
                    stray = stray or strays(met.near, position + displacement, displacement)
                    if wp.static(features.order == 2):
                        push = with_push(push, wp.transpose(sweep.to_local) * n, pressed, sweep.motion, entry)
            if step.repeats:
                store_row(met.contacts, entry, pack(after, 0.0))
            c = next_of(c, met.near, stray)
        if touched or wp.static(features.supported):
            leave(i, ctx.position_lo, ctx.d, displacement, push, support, met, step)
        return wp.where(close, CLOSE, 0) + wp.where(touched, TOUCHED, 0)

    return contact


def make_met_in(features: Features):
    """A Warp function: where it is kept what the particles of a body meet; `slot` is up to each."""
    near_of = make_near_of(features.listed)

    @wp.func
    def met_in(ctx: Context) -> Met:
        met = Met()
        met.first_sweep = ctx.sweep
        met.share = share_of(ctx.step, ctx.frame.substeps)
        met.near = near_of(ctx)
        met.colliders = ctx.colliders
        met.sweeps = ctx.state.contact.sweeps
        met.contacts = ctx.state.contact.contacts
        met.forces = ctx.state.contact.contact_forces
        met.velocities = ctx.state.velocities
        met.last_displacements = ctx.state.last_displacements
        met.supports = ctx.state.contact.supports
        met.carries = wp.static(features.supported)
        return met

    return met_in


def make_contact(features: Features):
    """The stage that keeps particle i, which meets `met`, outside all colliders after each iteration."""
    touch = make_touch(features)

    @wp.func
    def contact(i: int, met: Met, ctx: Context):
        width = NEARBY * ctx.body.gap
        found = touch(i, met, ctx, width)
        if wp.static(features.surface):
            if ctx.step.first:
                ctx.state.contact.close[met.slot] = found & CLOSE
        elif wp.static(features.method == "verlet"):
            if found & TOUCHED != 0:
                strain = widest_around(i, ctx) / ctx.body.gap - 1.0
                note_strain(strain, ctx.body.index, ctx.state.trial.strain_found)

    return contact
