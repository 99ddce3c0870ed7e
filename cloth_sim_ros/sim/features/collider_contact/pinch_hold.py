# SPDX-License-Identifier: Apache-2.0
"""What two colliders squeeze (see pinch.py) is held or slides between them, by friction beside the other forces.

A dashpot brakes a particle that slides, in prediction and as implicit as a hold. The slip of the last substep at its
rate would have met the friction of Coulomb's law.
"""

import warp as wp

from cloth_sim_ros.sim.arrays.context import Context
from cloth_sim_ros.sim.arrays.model import Features
from cloth_sim_ros.sim.features.collider_contact.arrays import Sweep
from cloth_sim_ros.sim.features.collider_contact.pinch import (
    across,
    add_force_of,
    corner_in,
    load_of,
    middle_of,
    note_squeezed,
    pressed_on,
    set_touch,
    share_of_corner,
    touch_of,
)
from cloth_sim_ros.sim.features.grasp.hold import HELD, firm_of, held_pull, limited_pull
from cloth_sim_ros.sim.kernels.intrinsics import load4, load_row, pack, store4, store_row, xyz

_CORNER_SHARE = wp.constant(0.25)  # least barycentric weight of a corner that is held for its facet
# Ratio of the compliance with which a particle begins to slide to that of a hold, to which it falls before it sticks.
_LOOSENS = wp.constant(10.0)


@wp.func
def _way_to(place: wp.vec4, x: wp.vec4, sweep: Sweep) -> wp.vec3:
    """Return the vector from a particle at x to its place between two colliders at the end of the substep [m]."""
    return (sweep.position - xyz(x)) + wp.transpose(sweep.to_local) * xyz(place)


@wp.func
def _way_with(x: wp.vec3, lo: wp.vec3, sweep: Sweep) -> wp.vec3:
    """Return the displacement [m] of a particle at x, with the low part lo, that moves as a collider does."""
    return sweep.motion - wp.transpose(sweep.to_local) * (sweep.turn * ((x - sweep.position) + sweep.motion)) + lo


@wp.func
def _slip_across(slip: wp.vec3, n: wp.vec3) -> wp.vec3:
    """Return a vector without its part along n."""
    return slip - wp.dot(slip, n) * n


def _make_load_on(features: Features):
    """Return a Warp function: the load on particle i between collider c and its opposite one [N], or 0."""

    @wp.func
    def load_on(i: int, c: int, was: wp.vec4, ctx: Context) -> float:
        if wp.min(touch_of(i, c, ctx), touch_of(i, ctx.colliders[c].opposite - 1, ctx)) == float(ctx.substep + 1):
            return ctx.colliders[c].squeeze
        load = float(0.0)
        if wp.static(features.surface):
            slot, least = ctx.body.particles + i, wp.where(was[3] == 0.0, _CORNER_SHARE, 0.5 * _CORNER_SHARE)
            for place in range(ctx.model.panel_start[slot], ctx.model.panel_start[slot + 1]):
                q = ctx.model.particle_panels[place]
                press = ctx.state.contact.presses[q * ctx.colliders.shape[0] + c]
                if press.when == ctx.substep - 1:
                    load += share_of_corner(press.weights, corner_in(q, i, ctx), least) * press.load
        return load * ctx.step.inverse_square

    return load_on


def make_hold_pinched(features: Features):
    """Return the stage after prediction: particle i is held between two colliders, or friction brakes it there."""
    load_on = _make_load_on(features)

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
        sweep = middle_of(number - 1, ctx)
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
        store4(ctx.d, i, held_pull(load4(ctx.d, i), pull, give, way, ctx))

    return hold_pinched


@wp.func
def _feel_held(i: int, c: int, place: wp.vec4, ctx: Context) -> wp.vec3:
    """Return the force of the hold [N]; the particle slides next if friction does not bear it."""
    g, sweep, x = ctx.body.particles + i, middle_of(c, ctx), load4(ctx.x, i)
    held, give = load_row(ctx.state.contact.pinch_pulls, g), firm_of(x[3], ctx)
    missing = _way_to(place, x, sweep) - xyz(load4(ctx.d, i))
    pull = limited_pull(xyz(held), give, ctx) + missing / give
    rubs = _slip_across(pull, across(c, ctx))
    mu = wp.sqrt(ctx.material.static_friction * ctx.colliders[c].static_friction)
    if wp.length(rubs) > 2.0 * mu * held[3]:
        mu = wp.sqrt(ctx.material.kinetic_friction * ctx.colliders[c].kinetic_friction)
        give *= _LOOSENS * wp.length(rubs) / wp.max(2.0 * mu * held[3], 1.0e-20)
        store_row(ctx.state.contact.pinch_places, g, wp.vec4(give, 0.0, 0.0, -place[3]))
    store_row(ctx.state.contact.pinch_pulls, g, pack(pull, held[3]))
    return pull


@wp.func
def _feel_sliding(i: int, c: int, give: float, ctx: Context) -> wp.vec3:
    """Return the friction [N]; the particle sticks next where its slip is that of a hold."""
    g, sweep, x = ctx.body.particles + i, middle_of(c, ctx), load4(ctx.x, i)
    held, d = load_row(ctx.state.contact.pinch_pulls, g), xyz(load4(ctx.d, i))
    missing = _way_with(xyz(x), xyz(load4(ctx.position_lo, i)), sweep) - d
    mu = wp.sqrt(ctx.material.kinetic_friction * ctx.colliders[c].kinetic_friction)
    pressed = 2.0 * held[3] + pressed_on(i, c, ctx) + pressed_on(i, ctx.colliders[c].opposite - 1, ctx)
    next = wp.length(_slip_across(missing, across(c, ctx))) / wp.max(mu * pressed, 1.0e-20)
    next = wp.sqrt(give * next)  # half the way on a logarithmic scale, or it would swing
    place = wp.vec4(next, 0.0, 0.0, -float(c + 1))
    if next <= firm_of(x[3], ctx):
        place = pack(sweep.to_local * ((xyz(x) - sweep.position) + d), float(c + 1))
    store_row(ctx.state.contact.pinch_places, g, place)
    store_row(ctx.state.contact.pinch_pulls, g, pack(missing / give, held[3]))
    return missing / give


def make_feel_pinched(features: Features):
    """Return the stage before particle i arrives: force of its hold or friction, and what it does next."""

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
            pull = _feel_held(i, c, place, ctx)
        else:
            pull = _feel_sliding(i, c, place[0], ctx)
        first = load * across(c, ctx)
        second = -first
        is_held = load4(ctx.d, i)[3] <= wp.static(HELD) * load4(ctx.x, i)[3]  # contact does not touch it then
        if touch_of(i, c, ctx) >= float(ctx.substep + 1):
            note_squeezed(True, c, ctx)
            note_squeezed(True, other, ctx)
            if is_held:
                set_touch(i, c, ctx)
                set_touch(i, other, ctx)
        elif wp.static(features.surface):
            first = load_of(i, c, ctx)
            if not is_held:  # facets give it the load
                first = wp.vec3(0.0)
            second = -first
        add_force_of(i, c, 0.5 * pull + first, ctx)
        add_force_of(i, other, 0.5 * pull + second, ctx)

    return feel_pinched
