# SPDX-License-Identifier: Apache-2.0
"""Contact thickness of the particles of a stretched sheet, so that no collider fits between them."""

import warp as wp

from cloth_sim_ros.sim.arrays.context import Context
from cloth_sim_ros.sim.arrays.model import Body, Features
from cloth_sim_ros.sim.colliders.collider import STRETCHED
from cloth_sim_ros.sim.kernels.intrinsics import load4, xyz

NEARBY = wp.constant(3.0)  # reach of facets from their corners, stretched threefold, in gaps between particles
# Largest width of a gap as a multiple of the rest gap. Otherwise a cloth around a collider could expand without end.
_WIDEST = wp.constant(6.0)


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


@wp.func
def thick_enough(thickness: float, gap: float, roundness: float, body: Body) -> float:
    """Return the thickness [m] at which a collider of this least radius of curvature does not fit between particles.

    gap: largest distance of a point between them from the nearest one [m], as in Collider.enters. That test has shown
    that the collider is round enough for gaps STRETCHED times as wide as at rest.
    """
    rest = wp.static(STRETCHED) * body.gap
    least = 0.5 * (rest * rest / wp.max(thickness, 1.0e-9) - thickness)
    round = wp.max(roundness, least)
    wide = wp.min(gap, _WIDEST * body.gap)
    return wp.max(thickness, wide * wide / (round + wp.sqrt(round * round + wide * wide)))


@wp.func
def note_strain(strain: float, body: int, found: wp.array(dtype=float)):
    """Record the strain around a particle that a collider touches, if the strain may let the collider through.

    The frame of explicit steps is then repeated, see executors/trial.py.
    """
    if strain > wp.static(STRETCHED - 1.0):
        wp.atomic_max(found, body, strain)


def make_thickness_for(features: Features):
    """Return a Warp function: the contact thickness of particle i, and the widest gap of the panels around it [m].

    away: lower bound of their distance [m]; the gap is measured only if this is small. gap: the width if it is known
    already, else 0. Explicit steps skip this, see note_strain.
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
