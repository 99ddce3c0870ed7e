# SPDX-License-Identifier: Apache-2.0
"""Handles pull each held particle by a spring to the place where it lay when it was grasped.

The spring acts at the end of the substep, as in implicit Euler. Take a particle of inverse mass w that would move by d,
with its place t away, and a spring of compliance c. It moves by (c d + w h^2 t) / (c + w h^2). The constraints that
follow see the inverse mass w c / (c + w h^2).

A rigid hold also has a small c, so that its force can be reported. It begins a substep with the force of the last one.
The deflection of the spring then vanishes as the load becomes steady (an augmented Lagrangian, Hestenes 1969).

An obstacle keeps a held particle back. A rigid hold then brings it up at no more than CATCH_UP.
"""

import warp as wp

from cloth_sim_ros.sim.arrays.context import Context
from cloth_sim_ros.sim.arrays.state import HandleMotion
from cloth_sim_ros.sim.kernels.intrinsics import load4, load_row, store4, store_row, xyz
from cloth_sim_ros.sim.physics.path import bend_at, orientation_at

# RIGID: fraction of the inverse mass that a rigid hold leaves. FIRMEST: its largest compliance [m/N].
RIGID = wp.constant(1.0e-3)
FIRMEST = wp.constant(3.0e-6)
KEPT = wp.constant(0.99)  # fraction of the last force that a hold begins with; the rest decays if no load needs it
CATCH_UP = wp.constant(1.0)  # largest speed of a late particle relative to its handle [m/s]
# Largest speed at which a rigid hold begins to move a particle that its load let go [m/s]; it bounds the load.
RECOIL = wp.constant(5.0)
HELD = 2.0e-3  # fraction of the inverse mass; a particle with less left is held, and no collider moves it


@wp.func
def grip_of(i: int, ctx: Context) -> wp.vec4:
    """Return the grip on particle i, as in State.grips; its last number is 0 if it is pinned or not held."""
    grip = wp.vec4(0.0)
    if ctx.state.grasp.held[ctx.body.index] > 0:
        if load4(ctx.x, i)[3] > 0.0:
            grip = load_row(ctx.state.grasp.grips, ctx.body.particles + i)
    return grip


@wp.func
def firm_of(w: float, ctx: Context) -> float:
    """Return the compliance [m/N] of a rigid hold of one particle of inverse mass w."""
    effective = 2.0 / 3.0 * ctx.frame.dt  # of order 2, also where a substep is of order 1: the load stays where it is
    return wp.min(RIGID * w * effective * effective, FIRMEST)


@wp.func
def give_of(number: int, w: float, ctx: Context) -> float:
    """Return the compliance [m/N] of a handle's spring to one particle of inverse mass w."""
    return wp.max(ctx.handles[number].compliance * float(ctx.handle_counts[number]), firm_of(w, ctx))


@wp.func
def orientation_of(handle: HandleMotion, after: float) -> wp.quat:
    """Return the orientation of a handle after the share `after` of the frame."""
    if wp.length_sq(handle.start_orientation - handle.end_orientation) > 0.0:
        bends = handle.bends
        start, end = handle.start_orientation, handle.end_orientation
        return orientation_at(after, start, end, bends.start_turn, bends.end_turn)
    return handle.start_orientation


@wp.func
def _wanted(x: wp.vec4, grip: wp.vec4, substep: int, ctx: Context) -> wp.vec3:
    """Return the vector from a held particle at x to where its handle wants it as that substep begins [m]."""
    after = float(substep) / float(ctx.frame.substeps)
    handle = ctx.handles[int(grip[3]) - 1]
    travel = after * (handle.end_position - handle.start_position)
    travel += bend_at(after, handle.bends.start, handle.bends.end)
    return (handle.start_position - xyz(x)) + travel + wp.quat_rotate(orientation_of(handle, after), xyz(grip))


@wp.func
def way_of(x: wp.vec4, grip: wp.vec4, ctx: Context) -> wp.vec3:
    """Return the vector from a held particle at x to where its handle wants it at the end of the substep [m]."""
    way = _wanted(x, grip, ctx.substep + 1, ctx)
    if ctx.handles[int(grip[3]) - 1].compliance == 0.0:
        behind = _wanted(x, grip, ctx.substep, ctx)
        way += _limited(behind, CATCH_UP * ctx.frame.dt) - behind
    return way


@wp.func
def _limited(v: wp.vec3, most: float) -> wp.vec3:
    """Return a vector, shortened to length `most` if it is longer."""
    return v * wp.min(1.0, most / wp.max(wp.length(v), 1.0e-30))


@wp.func
def pull_before(g: int, number: int, give: float, ctx: Context) -> wp.vec3:
    """Return the force [N] with which a rigid hold of particle g of the batch begins a substep; 0 for a soft one.

    It is at most the force of a spring of that compliance, stretched by the way that RECOIL allows in a substep.
    """
    if ctx.handles[number].compliance > 0.0:
        return wp.vec3(0.0)
    return limited_pull(xyz(load_row(ctx.state.grasp.grip_pulls, g)), give, ctx)


@wp.func
def limited_pull(pull: wp.vec3, give: float, ctx: Context) -> wp.vec3:
    """Return the force [N] with which a rigid hold begins a substep, after a pull in the last one."""
    return _limited(KEPT * pull, RECOIL * ctx.frame.dt / give)


@wp.func
def held_pull(predicted: wp.vec4, pull: wp.vec3, give: float, way: wp.vec3, ctx: Context) -> wp.vec4:
    """Return a particle's predicted displacement [m] and inverse mass if it is held `way` [m] from where it is.

    pull: force with which the hold begins the substep [N]. give: its compliance [m/N].
    """
    moved = predicted[3] * ctx.step.effective * ctx.step.effective
    share, taken = give / (give + moved), moved / (give + moved)  # which is no difference of 1 where the hold is soft
    d = share * (xyz(predicted) + moved * pull) + taken * way
    return wp.vec4(d[0], d[1], d[2], share * predicted[3])


@wp.func
def hold(i: int, ctx: Context):
    """Stage after prediction: particle i moves as its handle has it."""
    grip = grip_of(i, ctx)
    if grip[3] == 0.0:
        return
    g = ctx.body.particles + i
    x = load4(ctx.x, i)
    number = int(grip[3]) - 1
    give = give_of(number, x[3], ctx)
    store4(ctx.d, i, held_pull(load4(ctx.d, i), pull_before(g, number, give, ctx), give, way_of(x, grip, ctx), ctx))


@wp.func
def feel(i: int, ctx: Context):
    """Stage before particle i arrives: record the force of its handle on it in this substep."""
    grip = grip_of(i, ctx)
    if grip[3] == 0.0:
        return
    g = ctx.body.particles + i
    x = load4(ctx.x, i)
    number = int(grip[3]) - 1
    missing, give = way_of(x, grip, ctx) - xyz(load4(ctx.d, i)), give_of(number, x[3], ctx)
    pull = pull_before(g, number, give, ctx) + missing / give
    pulled = wp.vec4(pull[0], pull[1], pull[2], 0.0)
    store_row(ctx.state.grasp.grip_pulls, g, pulled)
    total = pulled / float(ctx.frame.substeps)
    if ctx.substep > 0:
        total += load_row(ctx.state.grasp.grip_forces, g)
    store_row(ctx.state.grasp.grip_forces, g, total)
