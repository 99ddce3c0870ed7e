# SPDX-License-Identifier: Apache-2.0
"""The path of a collider or handle through a frame: it starts with the velocity of the frame before.

A cubic in the share s of the frame, in Hermite's form. Position: p(s) = p_0 + s d + b(s), where d is the displacement
and b(s) = s (1 - s) ((1 - s) b_0 + s b_1) bends the straight way. Velocities in displacements a frame are d + b_0 at
the start and d - b_1 at the end. Orientation: the turn of the shortest way, then one by the rotation vector b(s).
"""

import warp as wp


@wp.func
def bend_at(s: float, start_bend: wp.vec3, end_bend: wp.vec3) -> wp.vec3:
    """Return b(s) [m] or [rad]; 0 at both ends."""
    return s * (1.0 - s) * ((1.0 - s) * start_bend + s * end_bend)


@wp.func
def orientation_at(s: float, start: wp.quat, end: wp.quat, start_bend: wp.vec3, end_bend: wp.vec3) -> wp.quat:
    """Return the orientation at the share s of the way from `start` to `end`, which differ; bends are in [rad]."""
    turned = wp.quat_slerp(start, end, s)
    bend = bend_at(s, start_bend, end_bend)
    angle = wp.length(bend)
    if angle > 0.0:
        turned = wp.quat_from_axis_angle(bend / angle, angle) * turned
    return turned


@wp.func
def longest(way: float, start_bend: wp.vec3, end_bend: wp.vec3) -> float:
    """Return a bound of a frame's length of path [m] or [rad], if it is `way` without the bends."""
    return way + wp.length(start_bend) + wp.length(end_bend)
