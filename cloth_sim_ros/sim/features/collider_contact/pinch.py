# SPDX-License-Identifier: Apache-2.0
"""Two colliders that pinch what is between them, with a load that does not follow from their depth in it.

A point that both touch is squeezed until it leaves the space between them. It lies in the middle, as the loads from
both sides cancel: they move nothing, but friction and wrenches have them. So neither the thickness of the thing nor
the length of a substep bounds the force of a pinch.

A squeezed particle is held where it was, as by a handle (see grasp/hold.py), or slides against a friction that acts
as its other forces do. Contact behind the lines of a sheet would come too late in a long substep, in which what hangs
from a few light particles moves them far. Where no particle is squeezed, facets are, and their corners are held.
"""

import warp as wp

from cloth_sim_ros.sim.arrays.context import Context
from cloth_sim_ros.sim.arrays.model import Features
from cloth_sim_ros.sim.arrays.state import ColliderMotion
from cloth_sim_ros.sim.features.collider_contact.arrays import Sweep
from cloth_sim_ros.sim.features.grasp.hold import HELD, firm_of, held_pull, limited_pull
from cloth_sim_ros.sim.kernels.intrinsics import load4, load_row, pack, store4, store_row, xyz

_FACING = wp.constant(0.7)  # least cosine of the angle of a normal from the way to the opposite collider
# Ratio of the compliance with which a particle begins to slide to that of a hold, to which it falls before it sticks.
_LOOSENS = wp.constant(10.0)
_CORNER_SHARE = wp.constant(0.25)  # least barycentric weight of a corner that is held for its facet


@wp.func
def slack_of(collider: ColliderMotion, squeezed: bool) -> float:
    """Return how far from a collider a point that it squeezes may lie beyond the thickness [m].

    In a long substep other forces move a point by more than the thickness, before contact takes it back.
    """
    return wp.where(squeezed, collider.reach, 0.0)


@wp.func
def across(c: int, ctx: Context) -> wp.vec3:
    """Return the direction from collider c to its opposite one, in which it presses."""
    opposite = ctx.state.contact.sweeps[ctx.sweep + ctx.colliders[c].opposite - 1].position
    return wp.normalize(opposite - ctx.state.contact.sweeps[ctx.sweep + c].position)


@wp.func
def _middle_of(c: int, ctx: Context) -> Sweep:
    """Return the motion of the point halfway between collider c and its opposite one; it turns as c does."""
    sweep = ctx.state.contact.sweeps[ctx.sweep + c]
    opposite = ctx.state.contact.sweeps[ctx.sweep + ctx.colliders[c].opposite - 1]
    sweep.position = 0.5 * (sweep.position + opposite.position)
    sweep.motion = 0.5 * (sweep.motion + opposite.motion)
    return sweep


@wp.func
def is_between(normal: wp.vec3, c: int, ctx: Context) -> bool:
    """Return True if a local normal of collider c points to its opposite one."""
    return wp.dot(normal, ctx.state.contact.sweeps[ctx.sweep + c].to_local * across(c, ctx)) > _FACING


@wp.func
def depth_before_middle(collider: ColliderMotion, thickness: float) -> float:
    """Return how deep a surface in the middle between both lies in one of them [m]."""
    return wp.max(thickness - collider.half_gap, 0.0)


@wp.func
def touch_of(i: int, c: int, ctx: Context) -> float:
    """Return 2 + the last substep in which collider c, which pinches, touched particle i."""
    return load_row(ctx.state.contact.contacts, (ctx.body.particles + i) * ctx.colliders.shape[0] + c)[3]


@wp.func
def _set_touch(i: int, c: int, ctx: Context):
    entry = (ctx.body.particles + i) * ctx.colliders.shape[0] + c
    store_row(ctx.state.contact.contacts, entry, wp.vec4(0.0, 0.0, 0.0, float(ctx.substep + 2)))


@wp.func
def _pressed_on(i: int, c: int, ctx: Context) -> float:
    """Return the force [N] with which contact pushes a sliding particle out of collider c in this substep."""
    pushed = load_row(ctx.state.contact.contacts, (ctx.body.particles + i) * ctx.colliders.shape[0] + c)
    return wp.length(xyz(pushed)) * ctx.step.inverse_square / load4(ctx.d, i)[3]


@wp.func
def brakes(i: int, ctx: Context) -> bool:
    """Return True if the friction of a pinch acts on particle i already."""
    return ctx.state.contact.pinch_places[ctx.body.particles + i][3] != 0.0


@wp.func
def is_squeezed(i: int, collider: ColliderMotion, ctx: Context) -> bool:
    """Return True if a collider and its opposite one squeeze particle i: that one touched it now or a substep ago."""
    if collider.squeeze == 0.0:
        return False
    return touch_of(i, collider.opposite - 1, ctx) > float(ctx.substep)


@wp.func
def is_facet_squeezed(entry: int, collider: ColliderMotion, ctx: Context) -> bool:
    """Return True if a collider and its opposite one squeeze the facet of the press `entry`, likewise."""
    if collider.squeeze == 0.0:
        return False
    first = entry - entry % ctx.colliders.shape[0]
    return ctx.state.contact.presses[first + collider.opposite - 1].when >= ctx.substep - 1


@wp.func
def note_squeezed(c: int, ctx: Context):
    """Note that collider c squeezes a particle of the body in this substep."""
    ctx.state.contact.squeezed_in[ctx.body.index * ctx.colliders.shape[0] + c] = ctx.substep + 2


@wp.func
def load_on_facet(c: int, points: float, ctx: Context) -> float:
    """Return the load [kg m] on a facet of so many points that collider c squeezes; 0 if particles have it."""
    place = ctx.body.index * ctx.colliders.shape[0] + c
    if ctx.state.contact.squeezed_in[place] > ctx.substep:
        return 0.0
    ctx.state.contact.squeezed_in[place] = -1
    return ctx.colliders[c].squeeze * points / ctx.step.inverse_square


@wp.func
def holds_a_corner(corners: wp.vec3i, ctx: Context) -> bool:
    """Return True if a pinch holds or brakes a corner of a facet."""
    held = bool(False)
    for k in range(3):
        held = held or ctx.state.contact.pinch_places[ctx.body.particles + corners[k]][3] != 0.0
    return held


@wp.func
def corner_in(q: int, i: int, ctx: Context) -> int:
    """Return which corner of facet q particle i is."""
    corners = ctx.model.panels[q]
    return wp.where(corners[0] == i, 0, wp.where(corners[1] == i, 1, 2))


@wp.func
def load_of(i: int, c: int, ctx: Context) -> wp.vec3:
    """Return the load [N] by which collider c squeezes the facets around particle i; its opposite one has as much."""
    sum, slot = float(0.0), ctx.body.particles + i
    first = wp.min(c, ctx.colliders[c].opposite - 1)
    for place in range(ctx.model.panel_start[slot], ctx.model.panel_start[slot + 1]):
        q = ctx.model.particle_panels[place]
        press = ctx.state.contact.presses[q * ctx.colliders.shape[0] + first]
        if press.when == ctx.substep:
            sum += press.weights[corner_in(q, i, ctx)] * press.load
    return (ctx.step.inverse_square * sum) * across(c, ctx)


@wp.func
def _share_of_corner(weights: wp.vec3, k: int, least: float) -> float:
    """Return the share of a facet's load that corner k bears; corners of less than the `least` weight bear none."""
    sum = float(0.0)
    for q in range(3):
        if weights[q] >= least:
            sum += weights[q]
    return wp.where(weights[k] >= least, weights[k] / wp.max(sum, least), 0.0)


@wp.func
def _add_force(i: int, c: int, force: wp.vec3, ctx: Context):
    """Add a force of collider c on particle i [N] in this substep to the mean over the frame."""
    entry = (ctx.body.particles + i) * ctx.colliders.shape[0] + c
    row = load_row(ctx.state.contact.contact_forces, entry)
    store_row(ctx.state.contact.contact_forces, entry, row + pack(force / float(ctx.frame.substeps), 0.0))


@wp.func
def _way_to(place: wp.vec4, x: wp.vec4, sweep: Sweep) -> wp.vec3:
    """Return the vector from a particle at x to its place between two colliders at the end of the substep [m]."""
    return (sweep.position - xyz(x)) + wp.transpose(sweep.to_local) * xyz(place)


@wp.func
def _way_with(x: wp.vec3, lo: wp.vec3, sweep: Sweep) -> wp.vec3:
    """Return the displacement [m] of a particle at x that moves as a collider does, with the low part lo of its place."""
    return sweep.motion - wp.transpose(sweep.to_local) * (sweep.turn * ((x - sweep.position) + sweep.motion)) + lo


@wp.func
def _slip_across(slip: wp.vec3, n: wp.vec3) -> wp.vec3:
    return slip - wp.dot(slip, n) * n


def make_hold_pinched(features: Features):
    """Return the stage after prediction: particle i is held between two colliders, or friction brakes it there."""

    @wp.func
    def load_on(i: int, c: int, was: wp.vec4, ctx: Context) -> float:
        """Return the load on particle i between collider c and its opposite one [N]; 0 if they do not squeeze it."""
        if wp.min(touch_of(i, c, ctx), touch_of(i, ctx.colliders[c].opposite - 1, ctx)) == float(ctx.substep + 1):
            return ctx.colliders[c].squeeze
        load = float(0.0)
        if wp.static(features.surface):
            slot, least = ctx.body.particles + i, wp.where(was[3] == 0.0, _CORNER_SHARE, 0.5 * _CORNER_SHARE)
            for place in range(ctx.model.panel_start[slot], ctx.model.panel_start[slot + 1]):
                q = ctx.model.particle_panels[place]
                press = ctx.state.contact.presses[q * ctx.colliders.shape[0] + c]
                if press.when == ctx.substep - 1:
                    load += _share_of_corner(press.weights, corner_in(q, i, ctx), least) * press.load
        return load * ctx.step.inverse_square

    @wp.func
    def hold_pinched(i: int, ctx: Context):
        if ctx.frame.squeezes == 0:
            return
        g, x = ctx.body.particles + i, load4(ctx.x, i)
        was = load_row(ctx.state.contact.pinch_places, g)
        number, load = int(0), float(0.0)
        if x[3] > 0.0:
            for c in range(ctx.colliders.shape[0]):
                if ctx.colliders[c].squeeze > 0.0 and ctx.colliders[c].opposite - 1 > c and load == 0.0:
                    load = load_on(i, c, was, ctx)
                    number = c + 1
        if load == 0.0:
            if was[3] != 0.0:
                store_row(ctx.state.contact.pinch_places, g, wp.vec4(0.0))
            return
        sweep = _middle_of(number - 1, ctx)
        pull = xyz(load_row(ctx.state.contact.pinch_pulls, g))
        if int(wp.abs(was[3])) != number:
            off = (xyz(x) - (sweep.position - sweep.motion)) + xyz(load4(ctx.position_lo, i))
            was = pack((sweep.to_local - sweep.turn) * off, float(number))
            store_row(ctx.state.contact.pinch_places, g, was)
            pull = wp.vec3(0.0)
        store_row(ctx.state.contact.pinch_pulls, g, pack(pull, load))
        give = firm_of(x[3], ctx)
        way, pull = _way_to(was, x, sweep), limited_pull(pull, give, ctx)
        if was[3] < 0.0:
            give = was[0]
            way, pull = _way_with(xyz(x), xyz(load4(ctx.position_lo, i)), sweep), wp.vec3(0.0)
        store4(ctx.p, i, held_pull(load4(ctx.p, i), pull, give, way, ctx))

    return hold_pinched


def make_feel_pinched(features: Features):
    """Return the stage before particle i arrives: the force of its hold or friction, and if it sticks or slides next."""

    @wp.func
    def feel_held(i: int, c: int, place: wp.vec4, ctx: Context) -> wp.vec3:
        """Return the force of the hold [N]; the particle slides next if friction does not bear it."""
        g, sweep, x = ctx.body.particles + i, _middle_of(c, ctx), load4(ctx.x, i)
        held, give = load_row(ctx.state.contact.pinch_pulls, g), firm_of(x[3], ctx)
        missing = _way_to(place, x, sweep) - xyz(load4(ctx.d, i))
        pull = limited_pull(xyz(held), give, ctx) + missing / give
        rubs = _slip_across(pull, across(c, ctx))
        mu = wp.sqrt(ctx.material.static_friction * ctx.colliders[c].static_friction)
        if wp.length(rubs) > 2.0 * mu * held[3]:
            mu = wp.sqrt(ctx.material.kinetic_friction * ctx.colliders[c].kinetic_friction)
            give *= _LOOSENS * wp.length(rubs) / (2.0 * mu * held[3])
            store_row(ctx.state.contact.pinch_places, g, wp.vec4(give, 0.0, 0.0, -place[3]))
        store_row(ctx.state.contact.pinch_pulls, g, pack(pull, held[3]))
        return pull

    @wp.func
    def feel_sliding(i: int, c: int, give: float, ctx: Context) -> wp.vec3:
        """Return the friction [N]; the particle sticks next where its slip is that of a hold."""
        g, sweep, x = ctx.body.particles + i, _middle_of(c, ctx), load4(ctx.x, i)
        held, d = load_row(ctx.state.contact.pinch_pulls, g), xyz(load4(ctx.d, i))
        missing = _way_with(xyz(x), xyz(load4(ctx.position_lo, i)), sweep) - d
        mu = wp.sqrt(ctx.material.kinetic_friction * ctx.colliders[c].kinetic_friction)
        pressed = 2.0 * held[3] + _pressed_on(i, c, ctx) + _pressed_on(i, ctx.colliders[c].opposite - 1, ctx)
        next = wp.length(_slip_across(missing, across(c, ctx))) / wp.max(mu * pressed, 1.0e-20)
        next = wp.sqrt(give * next)  # half the way on a logarithmic scale, or it would swing
        place = wp.vec4(next, 0.0, 0.0, -float(c + 1))
        if next <= firm_of(x[3], ctx):
            place = pack(sweep.to_local * ((xyz(x) - sweep.position) + d), float(c + 1))
        store_row(ctx.state.contact.pinch_places, g, place)
        store_row(ctx.state.contact.pinch_pulls, g, pack(missing / give, held[3]))
        return missing / give

    @wp.func
    def feel_pinched(i: int, ctx: Context):
        if ctx.frame.squeezes == 0:
            return
        g = ctx.body.particles + i
        place = load_row(ctx.state.contact.pinch_places, g)
        if place[3] == 0.0:
            return
        c = int(wp.abs(place[3])) - 1
        other, load = ctx.colliders[c].opposite - 1, load_row(ctx.state.contact.pinch_pulls, g)[3]
        pull = wp.vec3(0.0)
        if place[3] > 0.0:
            pull = feel_held(i, c, place, ctx)
        else:
            pull = feel_sliding(i, c, place[0], ctx)
        first = load * across(c, ctx)
        second = -first
        is_held = load4(ctx.d, i)[3] <= wp.static(HELD) * load4(ctx.x, i)[3]  # contact does not touch it then
        if touch_of(i, c, ctx) >= float(ctx.substep + 1):
            note_squeezed(c, ctx)
            note_squeezed(other, ctx)
            if is_held:
                _set_touch(i, c, ctx)
                _set_touch(i, other, ctx)
        elif wp.static(features.surface):
            first = load_of(i, c, ctx)
            if not is_held:  # facets give it the load
                first = wp.vec3(0.0)
            second = -first
        _add_force(i, c, 0.5 * pull + first, ctx)
        _add_force(i, other, 0.5 * pull + second, ctx)

    return feel_pinched
