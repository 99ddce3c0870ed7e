# SPDX-License-Identifier: Apache-2.0
"""Clamps at the ends of a rope with twist.

An end is clamped while its last two particles are pinned, or held by a handle, which turns the rope with it. All
segments from there on that the same handle holds turn with it too. While one end is free the twist runs out of it, far
faster than anything else moves.
"""

import warp as wp

from cloth_sim_ros.sim.arrays.context import Context
from cloth_sim_ros.sim.features.grasp.hold import grip_of, orientation_of
from cloth_sim_ros.sim.features.twist.arrays import Twist
from cloth_sim_ros.sim.kernels.intrinsics import load4


@wp.func
def any_across(t: wp.vec3) -> wp.vec3:
    """Return a unit vector across t, from the coordinate axis that is least aligned with t."""
    axis = wp.vec3(1.0, 0.0, 0.0)
    if wp.abs(t[0]) > wp.min(wp.abs(t[1]), wp.abs(t[2])):
        axis = wp.where(wp.abs(t[1]) < wp.abs(t[2]), wp.vec3(0.0, 1.0, 0.0), wp.vec3(0.0, 0.0, 1.0))
    return wp.normalize(axis - wp.dot(axis, t) * t)


@wp.func
def across(t: wp.vec3, u: wp.vec3) -> wp.vec3:
    """Return the unit vector across t that is nearest to u."""
    return wp.normalize(u - wp.dot(u, t) * t)


@wp.func
def start_of(twist: Twist, first: wp.vec3) -> wp.vec3:
    """Return the vector of the start, carried along with its tangent `first`; at first it is any across."""
    u = any_across(first)
    if twist.known != 0:
        u = across(first, twist.start)
    return u


@wp.func
def without_twist(twist: Twist, first: wp.vec3) -> Twist:
    """Return the state without twist, for a rope with a free end; `first` is the tangent at the start."""
    twist.start = start_of(twist, first)
    twist.known = 2
    twist.turned = twist.wanted
    twist.angle = 0.0
    return twist


@wp.func
def clamped_by(i: int, j: int, ctx: Context) -> int:
    """Return the holder of both particle i at an end and its neighbour j: 0 none, -1 pins, else 1 + handle."""
    tip = wp.where(load4(ctx.x, i)[3] == 0.0, -1, 0)
    neighbour = wp.where(load4(ctx.x, j)[3] == 0.0, -1, 0)
    if ctx.handles.shape[0] > 0:
        if tip == 0:
            tip = int(grip_of(i, ctx)[3])
        if neighbour == 0:
            neighbour = int(grip_of(j, ctx)[3])
    return wp.where(tip == 0 or neighbour == 0, 0, wp.max(tip, neighbour))


@wp.func
def held_by(start_by: int, end_by: int, ctx: Context) -> wp.vec2i:
    """Return the number of segments that the clamps at the start and at the end hold; one at least stays free.

    Pins hold one, as pinned particles farther on fix places and no turn.
    """
    last, start, end = ctx.body.count - 2, int(1), int(1)
    while start_by > 0 and start < last - 1 and clamped_by(start, start + 1, ctx) == start_by:
        start += 1
    while end_by > 0 and start + end < last and clamped_by(last - end + 1, last - end, ctx) == end_by:
        end += 1
    return wp.vec2i(start, end)


@wp.func
def turned_by(by: int, ahead: int, ctx: Context) -> wp.quat:
    """Return the orientation of a clamp, `ahead` substeps after this one begins."""
    q = wp.quat_identity()
    if by > 0:
        q = orientation_of(ctx.handles[by - 1], float(ctx.substep + ahead) / float(ctx.frame.substeps))
    return q


@wp.func
def turn_clamps(twist: Twist, start_by: int, end_by: int, first: wp.vec3, last: wp.vec3, ctx: Context) -> Twist:
    """Turn the vectors of both ends, whose tangents are `first` and `last`, with their present clamps."""
    if start_by != twist.start_by:
        twist.start_own = wp.quat_rotate_inv(turned_by(start_by, 0, ctx), twist.start)
    if end_by != twist.end_by:
        twist.end_own = wp.quat_rotate_inv(turned_by(end_by, 0, ctx), twist.end)
    twist.start_by = start_by
    twist.end_by = end_by
    twist.start = across(first, wp.quat_rotate(turned_by(start_by, 1, ctx), twist.start_own))
    twist.end = across(last, wp.quat_rotate(turned_by(end_by, 1, ctx), twist.end_own))
    return twist


@wp.func
def clamp(
    twist: Twist, start_by: int, end_by: int, first: wp.vec3, last: wp.vec3, carried: wp.vec3, ctx: Context
) -> Twist:
    """Start a twist with newly clamped ends: with the wanted angle at first, without twist after an end was free.

    carried: the vector of the start, carried along the rope to its end.
    """
    twist.angle = wp.where(twist.known == 0, twist.wanted, 0.0)
    twist.turned = twist.wanted
    twist.end = wp.quat_rotate(wp.quat_from_axis_angle(last, twist.angle - twist.wanted), carried)
    twist.known = 1
    twist.start_by = 0
    twist.end_by = 0
    return turn_clamps(twist, start_by, end_by, first, last, ctx)
