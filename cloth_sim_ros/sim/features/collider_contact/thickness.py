# SPDX-License-Identifier: Apache-2.0
"""How thick the particles of a sheet are to a collider that could come between them, where the sheet is stretched."""

import warp as wp

from cloth_sim_ros.sim.arrays.context import Context
from cloth_sim_ros.sim.arrays.model import Body, Features
from cloth_sim_ros.sim.colliders.collider import STRETCHED
from cloth_sim_ros.sim.kernels.intrinsics import load4, xyz

NEARBY = wp.constant(3.0)  # gaps between particles: how far facets reach from their corners, stretched threefold
# As many times as wide a gap may count: what is around a collider would else drive itself apart without end.
_WIDEST = wp.constant(6.0)


@wp.func
def widest_around(i: int, ctx: Context) -> float:
    """How far a point of the panels around particle i lies from the nearest of their corners, at most [m].

    It is the longest side over the root of 3 in a triangle (Jung 1901), and its half in a segment. Sides are taken
    where the substep began, as other particles are moving now.
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


@wp.func
def thick_enough(thickness: float, gap: float, roundness: float, body: Body) -> float:
    """The thickness [m] at which a collider of this least radius of curvature does not come between particles.

    gap: the farthest that a point between them lies from the nearest of them [m], as in Collider.enters. As that has
    told, the collider is round enough for gaps that are STRETCHED times as wide as at rest.
    """
    rest = wp.static(STRETCHED) * body.gap
    least = 0.5 * (rest * rest / wp.max(thickness, 1.0e-9) - thickness)
    round = wp.max(roundness, least)
    wide = wp.min(gap, _WIDEST * body.gap)
    return wp.max(thickness, wide * wide / (round + wp.sqrt(round * round + wide * wide)))


@wp.func
def note_strain(strain: float, body: int, found: wp.array(dtype=float)):
    """Remember the strain around a particle that a collider touches, where that may open a way for it.

    The frame of explicit steps is then done again, see executors/trial.py.
    """
    if strain > wp.static(STRETCHED - 1.0):
        wp.atomic_max(found, body, strain)


def make_thickness_for(features: Features):
    """A Warp function: at which thickness particle i touches a collider, and how wide the panels around it are [m].

    These are looked at where it is not `away` from the collider. A `gap` above 0 is known already. Explicit steps do
    without, see note_strain.
    """

    @wp.func
    def thickness_for(i: int, roundness: float, away: float, gap: float, ctx: Context) -> wp.vec2:
        found = wp.vec2(ctx.material.thickness, gap)
        if wp.static(features.method == "xpbd" and not features.surface):
            if away < NEARBY * ctx.body.gap:
                if gap == 0.0:
                    found[1] = widest_around(i, ctx)
                found[0] = thick_enough(found[0], found[1], roundness, ctx.body)
        return found

    return thickness_for
