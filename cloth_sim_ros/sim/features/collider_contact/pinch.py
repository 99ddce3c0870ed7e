# SPDX-License-Identifier: Apache-2.0
"""Two colliders that pinch what is between them, with a load that does not follow from their depth in it.

A point that both touch is squeezed until it leaves the space between them. It lies in the middle, as the loads from
both sides cancel: they move nothing, but friction and wrenches have them. So neither the thickness of the thing nor
the length of a substep bounds the force of a pinch.

A squeezed particle that sticks is held where it was, as by a handle (see grasp/hold.py). What hangs from it would else
move it far in a long substep, before friction takes it back. It slides once the hold pulls by more than friction bears,
and then friction acts as in other contacts. Where no particle is squeezed, facets are, and their corners are held.
"""

import warp as wp

from cloth_sim_ros.sim.arrays.context import Context
from cloth_sim_ros.sim.arrays.model import Features
from cloth_sim_ros.sim.arrays.state import ColliderMotion
from cloth_sim_ros.sim.features.collider_contact.arrays import Press, Sweep
from cloth_sim_ros.sim.features.grasp.hold import firm_of, held_pull, limited_pull
from cloth_sim_ros.sim.kernels.intrinsics import load4, load_row, pack, store4, store_row, xyz

_FACING = wp.constant(0.7)  # least cosine of the angle of a normal from the way to the opposite collider
_CORNER_SHARE = wp.constant(0.25)  # least barycentric weight of a corner that is held for its facet


@wp.func
def slack_of(collider: ColliderMotion, squeezed: bool) -> float:
    """Return how far from a collider a point that it squeezes may lie beyond the thickness [m].

    In a long substep other forces move a point by more than the thickness, before contact takes it back.
    """
    return wp.where(squeezed, collider.reach, 0.0)


@wp.func
def is_between(normal: wp.vec3, collider: ColliderMotion, sweep: Sweep, ctx: Context) -> bool:
    """Return True if a collider's local normal points to the collider opposite."""
    opposite = ctx.state.contact.sweeps[ctx.sweep + collider.opposite - 1]
    way = sweep.to_local * (opposite.position - sweep.position)
    return wp.dot(normal, way) > _FACING * wp.length(way)


@wp.func
def depth_before_middle(collider: ColliderMotion, thickness: float) -> float:
    """Return how deep a surface in the middle between both lies in one of them [m]."""
    return wp.max(thickness - collider.half_gap, 0.0)


@wp.func
def touch_of(i: int, c: int, ctx: Context) -> float:
    """Return 2 + the last substep in which collider c, which pinches, touched particle i; negative if that slid."""
    return load_row(ctx.state.contact.contacts, (ctx.body.particles + i) * ctx.colliders.shape[0] + c)[3]


@wp.func
def _set_touch(i: int, c: int, touch: float, ctx: Context):
    entry = (ctx.body.particles + i) * ctx.colliders.shape[0] + c
    store_row(ctx.state.contact.contacts, entry, wp.vec4(0.0, 0.0, 0.0, touch))


@wp.func
def is_squeezed(i: int, collider: ColliderMotion, ctx: Context) -> bool:
    """Return True if a collider and its opposite one squeeze particle i: that one touched it now or a substep ago."""
    if collider.squeeze == 0.0:
        return False
    return wp.abs(touch_of(i, collider.opposite - 1, ctx)) > float(ctx.substep)


@wp.func
def is_facet_squeezed(entry: int, collider: ColliderMotion, ctx: Context) -> bool:
    """Return True if a collider and its opposite one squeeze the facet of the press `entry`, likewise."""
    if collider.squeeze == 0.0:
        return False
    first = entry - entry % ctx.colliders.shape[0]
    return ctx.state.contact.presses[first + collider.opposite - 1].when >= ctx.substep - 1


@wp.func
def load_on_facet(corners: wp.vec3i, c: int, points: float, ctx: Context) -> float:
    """Return the load [kg m] on a facet of so many points that collider c squeezes; 0 if a corner has it."""
    for k in range(3):
        if wp.abs(touch_of(corners[k], c, ctx)) > float(ctx.substep):
            return 0.0
    return ctx.colliders[c].squeeze * points / ctx.step.inverse_square


@wp.func
def corner_in(q: int, i: int, ctx: Context) -> int:
    """Return which corner of facet q particle i is."""
    corners = ctx.model.panels[q]
    return wp.where(corners[0] == i, 0, wp.where(corners[1] == i, 1, 2))


@wp.func
def load_of(i: int, c: int, ctx: Context) -> wp.vec3:
    """Return the load [kg m] by which collider c squeezes the facets around particle i."""
    sum, slot = wp.vec3(0.0), ctx.body.particles + i
    for place in range(ctx.model.panel_start[slot], ctx.model.panel_start[slot + 1]):
        q = ctx.model.particle_panels[place]
        press = ctx.state.contact.presses[q * ctx.colliders.shape[0] + c]
        if press.when == ctx.substep:
            sum += press.weights[corner_in(q, i, ctx)] * press.load * press.normal
    return sum


@wp.func
def _share_of_corner(press: Press, k: int) -> float:
    """Return the share of a stuck facet's load that corner k bears; corners near which the point is not bear none."""
    sum = float(0.0)
    for q in range(3):
        if press.stuck[q] >= _CORNER_SHARE:
            sum += press.stuck[q]
    return wp.where(press.stuck[k] >= _CORNER_SHARE, press.stuck[k] / wp.max(sum, _CORNER_SHARE), 0.0)


@wp.func
def _add_force(i: int, c: int, force: wp.vec3, ctx: Context):
    """Add a force of collider c on particle i [N] in this substep to the mean over the frame."""
    entry = (ctx.body.particles + i) * ctx.colliders.shape[0] + c
    row = load_row(ctx.state.contact.contact_forces, entry)
    store_row(ctx.state.contact.contact_forces, entry, row + pack(force / float(ctx.frame.substeps), 0.0))


@wp.func
def _way_to(place: wp.vec4, x: wp.vec4, sweep: Sweep) -> wp.vec3:
    """Return the vector from a particle at x to its place in a collider's axes at the end of the substep [m]."""
    return (sweep.position - xyz(x)) + wp.transpose(sweep.to_local) * xyz(place)


def make_hold_pinched(features: Features):
    """Return the stage after prediction: particle i stays where it was between two colliders if it sticks there."""

    @wp.func
    def stuck_load(i: int, c: int, ctx: Context) -> float:
        """Return the load on particle i that sticks between collider c and its opposite one [N]; 0 if it does not."""
        collider, sticks = ctx.colliders[c], float(ctx.substep + 1)
        if touch_of(i, c, ctx) == sticks and touch_of(i, collider.opposite - 1, ctx) == sticks:
            return collider.squeeze
        load = float(0.0)
        if wp.static(features.surface):
            slot = ctx.body.particles + i
            for place in range(ctx.model.panel_start[slot], ctx.model.panel_start[slot + 1]):
                q = ctx.model.particle_panels[place]
                press = ctx.state.contact.presses[q * ctx.colliders.shape[0] + c]
                if press.when == ctx.substep - 1:
                    load += _share_of_corner(press, corner_in(q, i, ctx)) * press.load * ctx.step.inverse_square
        return load

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
                    load = stuck_load(i, c, ctx)
                    number = c + 1
        if load == 0.0:
            if was[3] > 0.0:
                store_row(ctx.state.contact.pinch_places, g, wp.vec4(0.0))
            return
        sweep = ctx.state.contact.sweeps[ctx.sweep + number - 1]
        pull = load_row(ctx.state.contact.pinch_pulls, g)
        if int(was[3]) != number:
            off = (xyz(x) - (sweep.position - sweep.motion)) + xyz(load4(ctx.position_lo, i))
            was = pack((sweep.to_local - sweep.turn) * off, float(number))
            store_row(ctx.state.contact.pinch_places, g, was)
            pull = wp.vec4(0.0)
        store_row(ctx.state.contact.pinch_pulls, g, pack(xyz(pull), load))
        give = firm_of(x[3], ctx)
        store4(ctx.p, i, held_pull(load4(ctx.p, i), limited_pull(xyz(pull), give, ctx), give, _way_to(was, x, sweep), ctx))

    return hold_pinched


def make_feel_pinched(features: Features):
    """Return the stage before particle i arrives: the force of the hold, and if friction bears it."""

    @wp.func
    def let_slide(i: int, c: int, ctx: Context):
        store_row(ctx.state.contact.pinch_places, ctx.body.particles + i, wp.vec4(0.0))
        if wp.static(features.surface):
            slot = ctx.body.particles + i
            for place in range(ctx.model.panel_start[slot], ctx.model.panel_start[slot + 1]):
                entry = ctx.model.particle_panels[place] * ctx.colliders.shape[0]
                ctx.state.contact.presses[entry + c].stuck = wp.vec3(0.0)
                ctx.state.contact.presses[entry + ctx.colliders[c].opposite - 1].stuck = wp.vec3(0.0)

    @wp.func
    def feel_pinched(i: int, ctx: Context):
        if ctx.frame.squeezes == 0:
            return
        g = ctx.body.particles + i
        place = load_row(ctx.state.contact.pinch_places, g)
        if place[3] == 0.0:
            return
        c = int(place[3]) - 1
        other = ctx.colliders[c].opposite - 1
        sweep, x = ctx.state.contact.sweeps[ctx.sweep + c], load4(ctx.x, i)
        held, give = load_row(ctx.state.contact.pinch_pulls, g), firm_of(x[3], ctx)
        missing = _way_to(place, x, sweep) - xyz(load4(ctx.d, i))
        pull = limited_pull(xyz(held), give, ctx) + missing / give
        store_row(ctx.state.contact.pinch_pulls, g, pack(pull, held[3]))
        across = wp.normalize(ctx.state.contact.sweeps[ctx.sweep + other].position - sweep.position)
        first, second = held[3] * across, -held[3] * across
        sticks = bool(True)
        mu = wp.sqrt(ctx.material.static_friction * ctx.colliders[c].static_friction)
        if wp.length(pull - wp.dot(pull, across) * across) > 2.0 * mu * held[3]:
            sticks = False
            let_slide(i, c, ctx)
        if touch_of(i, c, ctx) == float(ctx.substep + 1):
            touch = float(ctx.substep + 2) * wp.where(sticks, 1.0, -1.0)
            _set_touch(i, c, touch, ctx)
            _set_touch(i, other, touch, ctx)
        elif wp.static(features.surface):
            first = ctx.step.inverse_square * load_of(i, c, ctx)
            second = ctx.step.inverse_square * load_of(i, other, ctx)
        _add_force(i, c, 0.5 * pull + first, ctx)
        _add_force(i, other, 0.5 * pull + second, ctx)

    return feel_pinched
