# SPDX-License-Identifier: Apache-2.0
"""What a handle does to the particles that it holds: a spring to where each of them lay when it was grasped.

The spring is taken at the end of the substep, as implicit Euler does: a particle of the inverse mass w that would move
by d, and whose place is t away, moves by (c d + w h^2 t) / (c + w h^2) where the compliance c of its spring is. To the
constraints that follow it has the inverse mass w c / (c + w h^2).

A rigid hold has a small c nonetheless, so that its force can be told, and begins a substep with the force of the last:
what the spring has to give way by vanishes as the load becomes steady (an augmented Lagrangian, Hestenes 1969).

What stands in the way of a held particle keeps it back. A rigid hold then brings it up at no more than CATCH_UP.
"""

import warp as wp

from cloth_sim_ros.sim.arrays.context import Context
from cloth_sim_ros.sim.arrays.state import HandleMotion
from cloth_sim_ros.sim.kernels.intrinsics import load4, load_row, store4, store_row, xyz

# What a rigid hold leaves of the inverse mass, and the most that it gives way by [m/N].
RIGID = wp.constant(1.0e-3)
FIRMEST = wp.constant(3.0e-6)
KEPT = wp.constant(0.99)  # of the last force, which is forgotten where nothing asks for it
CATCH_UP = wp.constant(1.0)  # [m/s] beside the motion of the handle
HELD = 2.0e-3  # of the inverse mass: what has less of it left is held, and no collider moves it


@wp.func
def grip_of(i: int, ctx: Context) -> wp.vec4:
    """The grip on particle i, as in State.grips; its last number is 0 where nothing holds it, or a pin does."""
    grip = wp.vec4(0.0)
    if ctx.state.grasp.held[ctx.body.index] > 0:
        if load4(ctx.x, i)[3] > 0.0:
            grip = load_row(ctx.state.grasp.grips, ctx.body.particles + i)
    return grip


@wp.func
def give_of(number: int, w: float, ctx: Context) -> float:
    """The compliance [m/N] of a handle's spring to one particle of the inverse mass w."""
    firm = wp.min(RIGID * w * ctx.step.effective * ctx.step.effective, FIRMEST)
    return wp.max(ctx.handles[number].compliance * float(ctx.handle_counts[number]), firm)


@wp.func
def orientation_of(handle: HandleMotion, after: float) -> wp.quat:
    """How a handle is turned when that share of the frame is over."""
    if wp.length_sq(handle.start_orientation - handle.end_orientation) > 0.0:
        return wp.quat_slerp(handle.start_orientation, handle.end_orientation, after)
    return handle.start_orientation


@wp.func
def _wanted(x: wp.vec4, grip: wp.vec4, substep: int, ctx: Context) -> wp.vec3:
    """How far a held particle at x is from where its handle wants it when that substep begins [m]."""
    after = float(substep) / float(ctx.frame.substeps)
    handle = ctx.handles[int(grip[3]) - 1]
    travel = after * (handle.end_position - handle.start_position)
    return (handle.start_position - xyz(x)) + travel + wp.quat_rotate(orientation_of(handle, after), xyz(grip))


@wp.func
def way_of(x: wp.vec4, grip: wp.vec4, ctx: Context) -> wp.vec3:
    """How far a held particle at x is from where its handle wants it at the end of the substep [m]."""
    way = _wanted(x, grip, ctx.substep + 1, ctx)
    if ctx.handles[int(grip[3]) - 1].compliance == 0.0:
        behind = _wanted(x, grip, ctx.substep, ctx)
        way += _limited(behind, CATCH_UP * ctx.frame.dt) - behind
    return way


@wp.func
def _limited(v: wp.vec3, most: float) -> wp.vec3:
    """A vector, shortened to this length where it is longer."""
    return v * wp.min(1.0, most / wp.max(wp.length(v), 1.0e-30))


@wp.func
def pull_before(g: int, number: int, give: float, ctx: Context) -> wp.vec3:
    """The force [N] with which a rigid hold of particle g of the batch begins a substep; a soft one has its spring.

    It is no more than what a spring of that compliance has when it gives way by what is caught up in a substep.
    """
    if ctx.handles[number].compliance > 0.0:
        return wp.vec3(0.0)
    return _limited(KEPT * xyz(load_row(ctx.state.grasp.grip_pulls, g)), CATCH_UP * ctx.frame.dt / give)


@wp.func
def hold(i: int, ctx: Context):
    """The stage that follows prediction: particle i moves as its handle has it."""
    grip = grip_of(i, ctx)
    if grip[3] == 0.0:
        return
    g = ctx.body.particles + i
    x = load4(ctx.x, i)
    number = int(grip[3]) - 1
    predicted = load4(ctx.p, i)
    give = give_of(number, x[3], ctx)
    moved = predicted[3] * ctx.step.effective * ctx.step.effective
    share = give / (give + moved)
    free = xyz(predicted) + moved * pull_before(g, number, give, ctx)
    d = share * free + (1.0 - share) * way_of(x, grip, ctx)
    store4(ctx.p, i, wp.vec4(d[0], d[1], d[2], share * predicted[3]))


@wp.func
def feel(i: int, ctx: Context):
    """The stage before particle i arrives: what its handle pulls at it with in this substep."""
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
