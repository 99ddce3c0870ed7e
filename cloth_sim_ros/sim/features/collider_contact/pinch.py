# SPDX-License-Identifier: Apache-2.0
"""Two colliders that pinch what is between them, with a load that does not follow from their depth in it.

A point that both touch is squeezed until it leaves the space between them. It lies in the middle, as the loads from
both sides cancel: they move nothing, but friction and wrenches have them. So neither the thickness of the thing nor
the length of a substep bounds the force of a pinch. What one of them alone has touched, however near the other, is not.

A squeezed particle is held where it was, as by a handle (see grasp/hold.py), or slides against a friction that acts
as its other forces do. Contact behind the lines of a sheet would come too late in a long substep, in which what hangs
from a few light particles moves them far. Where no particle is squeezed, facets are, and their corners are held.
"""

import warp as wp

from cloth_sim_ros.sim.arrays.context import Context
from cloth_sim_ros.sim.arrays.state import ColliderMotion
from cloth_sim_ros.sim.features.collider_contact.arrays import Sweep
from cloth_sim_ros.sim.features.collider_contact.facet_place import corner_in
from cloth_sim_ros.sim.kernels.intrinsics import load4, load_row, pack, store_row, xyz

_FACING = wp.constant(0.7)  # least cosine of the angle of a normal from the way to the opposite collider


@wp.func
def slack_of(collider: ColliderMotion, squeezed: bool, touched: bool) -> float:
    """Return how far from a collider a point that it squeezes, and has `touched`, may lie beyond the thickness [m].

    In a long substep other forces move a point by more than the thickness, before contact takes it back.
    """
    return wp.where(squeezed and touched, collider.reach, 0.0)


@wp.func
def across(c: int, ctx: Context) -> wp.vec3:
    """Return the direction from collider c to its opposite one, in which it presses."""
    opposite = ctx.state.contact.sweeps[ctx.sweep + ctx.colliders[c].opposite - 1].position
    return wp.normalize(opposite - ctx.state.contact.sweeps[ctx.sweep + c].position)


@wp.func
def middle_of(c: int, ctx: Context) -> Sweep:
    """Return the motion of the point halfway between collider c and its opposite one; it turns as c does."""
    sweep = ctx.state.contact.sweeps[ctx.sweep + c]
    opposite = ctx.state.contact.sweeps[ctx.sweep + ctx.colliders[c].opposite - 1]
    sweep.position = 0.5 * (sweep.position + opposite.position)
    sweep.motion = 0.5 * (sweep.motion + opposite.motion)
    return sweep


@wp.func
def is_between(squeezed: bool, gap: float, slack: float, normal: wp.vec3, c: int, ctx: Context) -> bool:
    """Return True if a point that the opposite one of collider c touches is squeezed.

    It is if collider c touches it at this gap, or has with this slack, and the local normal there points across.
    """
    if not squeezed or (gap >= 0.0 and slack == 0.0):
        return False
    return wp.dot(normal, ctx.state.contact.sweeps[ctx.sweep + c].to_local * across(c, ctx)) > _FACING


@wp.func
def depth_before_middle(squeezed: bool, collider: ColliderMotion, thickness: float) -> float:
    """Return how deep what is squeezed, and lies in the middle, is in a collider [m]."""
    return wp.where(squeezed, wp.max(thickness - collider.half_gap, 0.0), 0.0)


@wp.func
def touch_of(i: int, c: int, ctx: Context) -> float:
    """Return 2 + the last substep in which collider c, which pinches, touched particle i."""
    return load_row(ctx.state.contact.contacts, (ctx.body.particles + i) * ctx.colliders.shape[0] + c)[3]


@wp.func
def set_touch(i: int, c: int, ctx: Context):
    entry = (ctx.body.particles + i) * ctx.colliders.shape[0] + c
    store_row(ctx.state.contact.contacts, entry, wp.vec4(0.0, 0.0, 0.0, float(ctx.substep + 2)))


@wp.func
def pressed_on(i: int, c: int, ctx: Context) -> float:
    """Return the force [N] with which contact pushes a sliding particle out of collider c in this substep."""
    pushed = load_row(ctx.state.contact.contacts, (ctx.body.particles + i) * ctx.colliders.shape[0] + c)
    return wp.length(xyz(pushed)) * ctx.step.inverse_square / load4(ctx.d, i)[3]


@wp.func
def share_of_friction(squeezed: bool, i: int, ctx: Context) -> float:
    """Return the share of friction that contact of particle i has: none if the pinch has it."""
    if squeezed:
        return wp.where(ctx.state.contact.pinch_places[ctx.body.particles + i][3] != 0.0, 0.0, 1.0)
    return 1.0


@wp.func
def may_squeeze(collider: ColliderMotion, ctx: Context) -> bool:
    """Return True if one point of the object fits into the gap to the opposite collider, not a bulge of it."""
    return collider.squeeze > 0.0 and collider.half_gap <= ctx.material.thickness


@wp.func
def has_touched(i: int, c: int, ctx: Context) -> bool:
    """Return True if collider c, which pinches, touched particle i now or a substep ago."""
    return touch_of(i, c, ctx) > float(ctx.substep)


@wp.func
def is_squeezed(i: int, collider: ColliderMotion, ctx: Context) -> bool:
    """Return True if a collider may squeeze particle i: its opposite one touched it now or a substep ago."""
    if may_squeeze(collider, ctx):
        return has_touched(i, collider.opposite - 1, ctx)
    return False


@wp.func
def is_facet_squeezed(entry: int, collider: ColliderMotion, ctx: Context) -> bool:
    """Return True if a collider may squeeze the facet of the press `entry`."""
    if may_squeeze(collider, ctx):
        first = entry - entry % ctx.colliders.shape[0]
        return ctx.state.contact.presses[first + collider.opposite - 1].when >= ctx.substep - 1
    return False


@wp.func
def note_squeezed(squeezed: bool, c: int, ctx: Context):
    """Note if collider c squeezes a particle of the body in this substep."""
    if squeezed:
        ctx.state.contact.squeezed_in[ctx.body.index * ctx.colliders.shape[0] + c] = ctx.substep + 2


@wp.func
def load_on_facet(squeezed: bool, c: int, points: float, ctx: Context) -> float:
    """Return the load [kg m] on a facet of so many points that collider c squeezes; 0 if particles have it."""
    if not squeezed:
        return 0.0
    place = ctx.body.index * ctx.colliders.shape[0] + c
    if ctx.state.contact.squeezed_in[place] > ctx.substep:
        return 0.0
    ctx.state.contact.squeezed_in[place] = -1
    return ctx.colliders[c].squeeze * points / ctx.step.inverse_square


@wp.func
def keeps_a_corner(corners: wp.vec3i, collider: ColliderMotion, ctx: Context) -> bool:
    """Return True if a pinch has a corner of a facet. Beside it, the way out of a collider may as well be its side."""
    held = bool(False)
    if collider.squeeze > 0.0:
        for k in range(3):
            held = held or ctx.state.contact.pinch_places[ctx.body.particles + corners[k]][3] != 0.0
    return held


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
def add_load(i: int, c: int, ctx: Context):
    """Add the load on the facets around particle i to the force of collider c."""
    if ctx.colliders[c].squeeze > 0.0 and ctx.step.first:
        add_force_of(i, c, load_of(i, c, ctx), ctx)


@wp.func
def share_of_corner(weights: wp.vec3, k: int, least: float) -> float:
    """Return the share of a facet's load that corner k bears; corners of less than the `least` weight bear none."""
    sum = float(0.0)
    for q in range(3):
        if weights[q] >= least:
            sum += weights[q]
    return wp.where(weights[k] >= least, weights[k] / wp.max(sum, least), 0.0)


@wp.func
def add_force_of(i: int, c: int, force: wp.vec3, ctx: Context):
    """Add a force of collider c on particle i [N] in this substep to the mean over the frame."""
    entry = (ctx.body.particles + i) * ctx.colliders.shape[0] + c
    row = load_row(ctx.state.contact.contact_forces, entry)
    store_row(ctx.state.contact.contact_forces, entry, row + pack(force / float(ctx.frame.substeps), 0.0))
