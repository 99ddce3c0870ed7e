# SPDX-License-Identifier: Apache-2.0
"""Sheets that tear: a spring that is strained too far fails for good, and with it what lies over it.

A spring without a rest length is none to the solve along lines, and a triangle whose corners are one particle has no
area. So nothing but these stages knows of tearing: they take from a world's own copy of the model what has failed.
Springs fail after a substep. What goes with them follows at the end of the frame: bending springs, triangles, the
bending of the sheet. Where the frame leaves the body faulty, and it is put back, its springs are whole again.
"""

import warp as wp

from cloth_sim_ros.sim.arrays.context import Here
from cloth_sim_ros.sim.arrays.model import Features
from cloth_sim_ros.sim.kernels.intrinsics import load4, xyz

# Arrays of the model of which each world has its own.
LEFT = ("line_rests", "panels", "panel_parts", "plate_weights", "curve_stencil_gradients", "curve_gradients")
GONE = wp.constant(-1.0e6)  # in place of a rest length
# Of the strength, by which springs differ: what is strained evenly would fail everywhere at once.
SPREAD = wp.constant(0.01)
NEEDS = 13  # panels without which a panel does not bend, see topology/plate.py


@wp.func
def strength(i: int, j: int) -> float:
    """Of the spring between two particles, against the mean: always the same for the same spring."""
    u = wp.randf(wp.rand_init(wp.min(i, j), wp.max(i, j)))
    return 1.0 + SPREAD * (2.0 * u - 1.0)


def make_tear(features: Features):
    """The stage that has springs fail: thread t of `width` its share."""

    @wp.func
    def tear(t: int, width: int, here: Here):
        seams = here.model.seams[here.body.index]
        for k in range(seams.others + t, seams.end, width):
            rest = here.state.line_rests[k]
            if rest > 0.0:
                i, j = here.model.line_nodes[k], here.model.line_others[k]
                low = load4(here.low, j) - load4(here.low, i)
                e = xyz((load4(here.x, j) - load4(here.x, i)) + low)
                longest = (1.0 + seams.strain * strength(i, j)) * rest
                if wp.dot(e, e) > longest * longest:
                    here.state.line_rests[k] = -rest
                    here.state.tearing[here.body.index] = 1
                    if wp.static(features.order == 2):
                        here.state.events[2 * here.body.index + here.substep % 2] = here.substep + 1

    return tear


@wp.func
def settle_springs(t: int, width: int, here: Here):
    """The stage that has the springs that failed in this frame be gone, or whole where the body is put back."""
    seams = here.model.seams[here.body.index]
    if here.state.tearing[here.body.index] == 0:
        return
    for k in range(seams.others + t, seams.end, width):
        rest = here.state.line_rests[k]
        if here.model.line_others[k] >= 0 and rest < 0.0 and rest > GONE:
            here.state.line_rests[k] = wp.where(here.state.faulty[here.body.index] == 1, -rest, GONE)


@wp.func
def is_gone(slot: int, here: Here) -> bool:
    """Whether there was a spring and it failed."""
    return slot >= 0 and here.state.line_rests[wp.max(slot, 0)] < 0.0


@wp.func
def drop_over(t: int, width: int, here: Here):
    """The stage that drops bending springs over springs that failed, and triangles at them."""
    seams = here.model.seams[here.body.index]
    if here.state.tearing[here.body.index] == 0:
        return
    for k in range(seams.bends + t, seams.others, width):
        for q in range(seams.needs_width):
            if is_gone(here.model.line_needs[seams.needs + (k - seams.bends) * seams.needs_width + q], here):
                here.state.line_rests[k] = GONE
    for k in range(here.body.panels + t, here.body.panels_end, width):
        sides = here.model.panel_sides[k]
        if is_gone(sides[0], here) or is_gone(sides[1], here) or is_gone(sides[2], here):
            corner = here.state.panels[k][0]
            here.state.panels[k] = wp.vec3i(corner, corner, corner)


@wp.func
def is_whole(k: int, here: Here) -> bool:
    """Whether panel k is part of the surface."""
    panel = here.state.panels[k]
    return panel[0] != panel[1]


@wp.func
def bends_still(k: int, here: Here) -> bool:
    """Whether panel k and all that its bending takes are there."""
    whole = bool(True)
    for q in range(wp.static(NEEDS)):
        whole = whole and is_whole(here.model.panel_needs[wp.static(NEEDS) * k + q], here)
    return whole


@wp.func
def own_parts(k: int, here: Here) -> int:
    """Bits of the corners and sides of panel k that no panel before it has (see Model.panel_parts)."""
    panel = here.state.panels[k]
    bits = int(0)
    for place in range(3):
        a, b = panel[place], panel[(place + 1) % 3]
        has_corner, has_side = bool(True), bool(True)
        g = here.body.particles + a
        for p in range(here.model.panel_start[g], here.model.panel_start[g + 1]):
            other = here.model.particle_panels[p]
            if other < k and is_whole(other, here):
                has_corner = False
                corners = here.state.panels[other]
                has_side = has_side and corners[0] != b and corners[1] != b and corners[2] != b
        bits += wp.where(has_corner, 1 << place, 0) + wp.where(has_side, 1 << (3 + place), 0)
    return bits


@wp.func
def share_parts(t: int, width: int, here: Here):
    """The stage that shares corners and sides anew among the triangles that are left, for contact between objects."""
    if here.state.tearing[here.body.index] == 0:
        return
    for k in range(here.body.panels + t, here.body.panels_end, width):
        bits = int(0)
        if is_whole(k, here):
            bits = own_parts(k, here)
        here.state.panel_parts[k] = wp.vec2i(here.body.index, bits)


@wp.func
def weigh_again(t: int, width: int, here: Here):
    """The stage that sums the weights of a plate over the triangles that still bend."""
    if here.state.tearing[here.body.index] == 0:
        return
    first = here.body.plate
    for e in range(first + t, first + here.body.count * here.body.plate_width, width):
        place = here.model.plate_sums[e]
        if place >= 0:
            sum = float(0.0)
            for p in range(here.model.plate_starts[place], here.model.plate_starts[place + 1]):
                if bends_still(here.model.plate_part_panels[p], here):
                    sum += here.model.plate_parts[p]
            here.state.plate_weights[e] = sum


@wp.func
def flatten(t: int, width: int, here: Here):
    """The stage that has triangles that bend no more not be curved at rest either."""
    if here.state.tearing[here.body.index] == 0:
        return
    size = here.model.curve_width
    for c in range(here.body.curves + t, here.body.curves_end, width):
        if not bends_still(here.model.curve_panels[c], here):
            for q in range(size):
                here.state.curve_stencil_gradients[size * c + q] = 0.0
    first, end = here.body.particles, here.body.particles + here.body.count
    for k in range(here.model.curve_start[first] + t, here.model.curve_start[end], width):
        if not bends_still(here.model.curve_panels[here.model.curve_entries[k][0]], here):
            here.state.curve_gradients[k] = 0.0


@wp.func
def finish_tearing(t: int, width: int, here: Here):
    """The stage that ends it."""
    if t == 0:
        here.state.tearing[here.body.index] = 0


def followers(features: Features) -> list:
    """The stages at the end of a frame, in order."""
    own = [share_parts] if features.meets else []
    bending = [weigh_again] if features.plate else []
    curved = [flatten] if features.curved else []
    return [settle_springs, drop_over, *own, *bending, *curved, finish_tearing]
