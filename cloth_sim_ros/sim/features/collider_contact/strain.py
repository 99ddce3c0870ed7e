# SPDX-License-Identifier: Apache-2.0
"""Strain around the particles that colliders touch, for explicit steps."""

import warp as wp

from cloth_sim_ros.sim.arrays.context import Context
from cloth_sim_ros.sim.kernels.intrinsics import load4, xyz

# Strain above which explicit steps heat a body, however slowly it came, and a collider may pass between particles.
TOO_STRAINED = wp.constant(0.62)


@wp.func
def widest_around(i: int, ctx: Context) -> float:
    """Return the largest distance of a point of the panels around particle i from the nearest of their corners [m].

    For a triangle it is at most the longest side over the root of 3 (Jung 1901), for a segment half of it. Sides are
    measured where the substep began, as other particles are moving now.
    """
    square = float(0.0)
    slot = ctx.body.particles + i
    for place in range(ctx.model.panel_start[slot], ctx.model.panel_start[slot + 1]):
        panel = ctx.model.panels[ctx.model.particle_panels[place]]
        a, b = xyz(load4(ctx.x, panel[0])), xyz(load4(ctx.x, panel[1]))
        longest = wp.length_sq(b - a)
        if panel[2] >= 0:
            c = xyz(load4(ctx.x, panel[2]))
            longest = wp.max(longest, wp.max(wp.length_sq(c - a), wp.length_sq(c - b))) * wp.static(4.0 / 3.0)
        square = wp.max(square, 0.25 * longest)
    return wp.sqrt(square)
