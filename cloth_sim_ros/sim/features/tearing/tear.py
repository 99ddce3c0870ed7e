# SPDX-License-Identifier: Apache-2.0
"""Sheets that tear: a spring that is strained too far fails for good, and so do the parts that need it.

The solve along lines ignores a spring without a rest length, and a triangle whose corners are one particle has no area.
So only these stages know of tearing: they remove failed parts from a world's own copy of the model. Springs fail after
a substep. Bending springs, triangles and the bending of the sheet follow at the end of the frame. If the frame leaves
the body faulty and it is put back, its springs are whole again.
"""

import warp as wp

from cloth_sim_ros.sim.arrays.context import Context
from cloth_sim_ros.sim.arrays.model import Features
from cloth_sim_ros.sim.kernels.intrinsics import load4, store_row, xyz

GONE = wp.constant(-1.0e6)  # value in place of a rest length
# Fraction of the strength by which springs differ. An evenly strained sheet would fail everywhere at once without it.
SPREAD = wp.constant(0.01)
NEEDS = 13  # number of panels that the bending of one panel needs, see topology/plate.py


@wp.func
def strength(i: int, j: int) -> float:
    """Return the ratio of a spring's strength to the mean, always the same for the same two particles."""
    u = wp.randf(wp.rand_init(wp.min(i, j), wp.max(i, j)))
    return 1.0 + SPREAD * (2.0 * u - 1.0)


def make_tear(features: Features):
    """Return the stage that lets springs fail; thread t of `width` does its share."""

    @wp.func
    def tear(t: int, width: int, ctx: Context):
        offsets = ctx.model.tear_offsets[ctx.body.index]
        for k in range(offsets.others + t, offsets.end, width):
            rest = ctx.state.tearing.line_rests[k]
            if rest > 0.0:
                i, j = ctx.model.line_nodes[k], ctx.model.line_others[k]
                lo = load4(ctx.position_lo, j) - load4(ctx.position_lo, i)
                e = xyz((load4(ctx.x, j) - load4(ctx.x, i)) + lo)
                longest = (1.0 + offsets.strain * strength(i, j)) * rest
                if wp.dot(e, e) > longest * longest:
                    ctx.state.tearing.line_rests[k] = -rest
                    ctx.state.tearing.tearing[ctx.body.index] = 1
                    if wp.static(features.order == 2):
                        ctx.state.events[2 * ctx.body.index + ctx.substep % 2] = ctx.substep + 1

    return tear


@wp.func
def settle_springs(t: int, width: int, ctx: Context):
    """Stage that removes the springs that failed in this frame, or restores them if the body is put back."""
    offsets = ctx.model.tear_offsets[ctx.body.index]
    if ctx.state.tearing.tearing[ctx.body.index] == 0:
        return
    for k in range(offsets.others + t, offsets.end, width):
        rest = ctx.state.tearing.line_rests[k]
        if ctx.model.line_others[k] >= 0 and rest < 0.0 and rest > GONE:
            ctx.state.tearing.line_rests[k] = wp.where(ctx.state.faulty[ctx.body.index] == 1, -rest, GONE)


@wp.func
def is_gone(slot: int, ctx: Context) -> bool:
    """Return True if `slot` holds a spring that failed."""
    return slot >= 0 and ctx.state.tearing.line_rests[wp.max(slot, 0)] < 0.0


@wp.func
def drop_over(t: int, width: int, ctx: Context):
    """Stage that removes bending springs over failed springs, and triangles next to them."""
    offsets = ctx.model.tear_offsets[ctx.body.index]
    if ctx.state.tearing.tearing[ctx.body.index] == 0:
        return
    for k in range(offsets.bends + t, offsets.others, width):
        for q in range(offsets.needs_width):
            if is_gone(ctx.model.line_needs[offsets.needs + (k - offsets.bends) * offsets.needs_width + q], ctx):
                ctx.state.tearing.line_rests[k] = GONE
    for k in range(ctx.body.panels + t, ctx.body.panels_end, width):
        sides = ctx.model.panel_sides[k]
        if is_gone(sides[0], ctx) or is_gone(sides[1], ctx) or is_gone(sides[2], ctx):
            corner = ctx.state.tearing.panels[k][0]
            ctx.state.tearing.panels[k] = wp.vec3i(corner, corner, corner)


@wp.func
def is_whole(k: int, ctx: Context) -> bool:
    """Return True if panel k is part of the surface."""
    panel = ctx.state.tearing.panels[k]
    return panel[0] != panel[1]


@wp.func
def bends_still(k: int, ctx: Context) -> bool:
    """Return True if panel k and all panels that its bending needs are whole."""
    whole = bool(True)
    for q in range(wp.static(NEEDS)):
        whole = whole and is_whole(ctx.model.panel_needs[wp.static(NEEDS) * k + q], ctx)
    return whole


@wp.func
def own_parts(k: int, ctx: Context) -> int:
    """Return bits of the corners and sides of panel k that no panel before it has (see Model.panel_parts)."""
    panel = ctx.state.tearing.panels[k]
    bits = int(0)
    for place in range(3):
        a, b = panel[place], panel[(place + 1) % 3]
        has_corner, has_side = bool(True), bool(True)
        g = ctx.body.particles + a
        for p in range(ctx.model.panel_start[g], ctx.model.panel_start[g + 1]):
            other = ctx.model.particle_panels[p]
            if other < k and is_whole(other, ctx):
                has_corner = False
                corners = ctx.state.tearing.panels[other]
                has_side = has_side and corners[0] != b and corners[1] != b and corners[2] != b
        bits += wp.where(has_corner, 1 << place, 0) + wp.where(has_side, 1 << (3 + place), 0)
    return bits


@wp.func
def share_parts(t: int, width: int, ctx: Context):
    """Stage that shares corners and sides anew among the remaining triangles, for contact between objects."""
    if ctx.state.tearing.tearing[ctx.body.index] == 0:
        return
    for k in range(ctx.body.panels + t, ctx.body.panels_end, width):
        bits = int(0)
        if is_whole(k, ctx):
            bits = own_parts(k, ctx)
        ctx.state.tearing.panel_parts[k] = wp.vec2i(ctx.body.index, bits)


@wp.func
def weigh_again(t: int, width: int, ctx: Context):
    """Stage that sums the weights of a plate over the triangles that still bend."""
    if ctx.state.tearing.tearing[ctx.body.index] == 0:
        return
    first = ctx.body.plate
    for e in range(first + t, first + ctx.body.count * ctx.body.plate_width, width):
        place = ctx.model.plate_sums[e]
        if place >= 0:
            sum = float(0.0)
            for p in range(ctx.model.plate_starts[place], ctx.model.plate_starts[place + 1]):
                if bends_still(ctx.model.plate_part_panels[p], ctx):
                    sum += ctx.model.plate_parts[p]
            ctx.state.tearing.plate_weights[e] = sum


@wp.func
def flatten(t: int, width: int, ctx: Context):
    """Stage that removes the rest curvature of triangles that no longer bend."""
    if ctx.state.tearing.tearing[ctx.body.index] == 0:
        return
    size = ctx.model.curve_width
    for c in range(ctx.body.curves + t, ctx.body.curves_end, width):
        if not bends_still(ctx.model.curve_panels[c], ctx):
            for q in range(size):
                ctx.state.tearing.curve_stencil_gradients[size * c + q] = 0.0
            store_row(ctx.state.plate.curve_normals, c, wp.vec4(0.0))
    first, end = ctx.body.particles, ctx.body.particles + ctx.body.count
    for k in range(ctx.model.curve_start[first] + t, ctx.model.curve_start[end], width):
        if not bends_still(ctx.model.curve_panels[ctx.model.curve_entries[k][0]], ctx):
            ctx.state.tearing.curve_gradients[k] = 0.0


@wp.func
def finish_tearing(t: int, width: int, ctx: Context):
    """Stage that clears the tearing flag of a body."""
    if t == 0:
        ctx.state.tearing.tearing[ctx.body.index] = 0


def followers(features: Features) -> list:
    """Return the stages at the end of a frame, in order."""
    own = [share_parts] if features.coupled else []
    bending = [weigh_again] if features.plate else []
    curved = [flatten] if features.curved else []
    return [settle_springs, drop_over, *own, *bending, *curved, finish_tearing]
