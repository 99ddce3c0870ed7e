# SPDX-License-Identifier: Apache-2.0
"""Places of facets in a substep and in a collider's axes, and where a collider touches them."""

import warp as wp

from cloth_sim_ros.sim.arrays.context import Context, note_searches, note_work
from cloth_sim_ros.sim.arrays.model import Features
from cloth_sim_ros.sim.arrays.state import ColliderMotion
from cloth_sim_ros.sim.colliders import make_has_edges, make_is_beyond
from cloth_sim_ros.sim.features.collider_contact.arrays import Look, Sweep
from cloth_sim_ros.sim.features.collider_contact.broad_phase import Near, strays
from cloth_sim_ros.sim.features.collider_contact.facet import (
    CORNER,
    FAST,
    Deepest,
    Facet,
    farthest_of,
    longest_way,
    make_least,
    middle_of,
)
from cloth_sim_ros.sim.features.collider_contact.facet_search import make_balanced, make_touched
from cloth_sim_ros.sim.features.collider_contact.sweep import NOISE, slip_of
from cloth_sim_ros.sim.kernels.intrinsics import load4, xyz

# Displacement as a fraction of the thickness; a facet that moved less reuses its deepest point (non-convex shapes).
_STILL = wp.constant(0.02)


@wp.func
def corners_of(k: int, ctx: Context) -> wp.vec3i:
    """Return the corners of facet k; a segment has its second one twice."""
    corners = ctx.model.panels[k]
    return wp.vec3i(corners[0], corners[1], wp.where(corners[2] < 0, corners[1], corners[2]))


@wp.func
def corner_in(q: int, i: int, ctx: Context) -> int:
    """Return which corner of facet q particle i is."""
    corners = ctx.model.panels[q]
    return wp.where(corners[0] == i, 0, wp.where(corners[1] == i, 1, 2))


@wp.func
def is_close(corners: wp.vec3i, ctx: Context) -> bool:
    """Return True if a facet is tested in this substep, as its corners' own contact found."""
    first, close = ctx.body.particles, ctx.state.contact.close
    return close[first + corners[0]] + close[first + corners[1]] + close[first + corners[2]] > 0


@wp.func
def is_stray(corners: wp.vec3i, near: Near, ctx: Context) -> bool:
    """Return True if the list of colliders does not hold for a corner of a facet."""
    stray = bool(False)
    for k in range(3):
        d = xyz(load4(ctx.d, corners[k]))
        stray = stray or strays(near, xyz(load4(ctx.x, corners[k])) + d, d)
    return stray


@wp.func
def is_tested(corners: wp.vec3i, ctx: Context, collider: ColliderMotion, sweep: Sweep) -> bool:
    """Return True if a collider fits between particles and may reach the facet in the substep."""
    if collider.facets == 0:
        return False
    farthest = float(0.0)
    path = float(0.0)
    middle = wp.vec3(0.0)
    for k in range(3):
        middle += (xyz(load4(ctx.x, corners[k])) - sweep.position + xyz(load4(ctx.d, corners[k]))) / 3.0
    for k in range(3):
        d = xyz(load4(ctx.d, corners[k]))
        farthest = wp.max(farthest, wp.length(xyz(load4(ctx.x, corners[k])) - sweep.position + d - middle))
        path = wp.max(path, wp.length(d - sweep.motion))
    away = wp.length(middle)
    path += farthest
    path += sweep.spin * (away + path)
    return away - path < collider.reach + ctx.material.thickness


@wp.func
def place_of(i: int, ctx: Context, sweep: Sweep) -> wp.vec3:
    """Return the place of particle i at the end of the substep, in the axes of a collider [m]."""
    return sweep.to_local * ((xyz(load4(ctx.x, i)) - sweep.position) + xyz(load4(ctx.d, i)))


@wp.func
def slip_of_particle(i: int, ctx: Context, sweep: Sweep) -> wp.vec3:
    """Return the displacement of particle i in the axes of a collider [m]."""
    moved = xyz(load4(ctx.d, i)) - xyz(load4(ctx.position_lo, i))
    return slip_of(xyz(load4(ctx.x, i)) - sweep.position, moved, sweep)


@wp.func
def facet_of(corners: wp.vec3i, ctx: Context, sweep: Sweep) -> Facet:
    """Return a facet in the axes of a collider."""
    facet = Facet()
    facet.a = place_of(corners[0], ctx, sweep)
    facet.b = place_of(corners[1], ctx, sweep)
    facet.c = place_of(corners[2], ctx, sweep)
    facet.slip_a = slip_of_particle(corners[0], ctx, sweep)
    facet.slip_b = slip_of_particle(corners[1], ctx, sweep)
    facet.slip_c = slip_of_particle(corners[2], ctx, sweep)
    facet.is_segment = corners[1] == corners[2]
    return facet


@wp.func
def moved_since(look: Look, facet: Facet) -> float:
    """Return the largest distance of any of its points from its place at that search [m]."""
    return wp.max(wp.length(facet.a - look.a), wp.max(wp.length(facet.b - look.b), wp.length(facet.c - look.c)))


@wp.func
def looked(facet: Facet, found: Deepest) -> Look:
    """Return the Look of a deepest point found now."""
    look = Look()
    look.a = facet.a
    look.b = facet.b
    look.c = facet.c
    look.weights = found.weights
    look.value = found.value
    look.known = 1
    return look


def _make_pressed_at(features: Features):
    """Return a Warp function: the weights of the point at which a collider presses a facet that touches it."""
    has_edges, balanced = make_has_edges(features.facet_shapes), make_balanced(features.facet_shapes)

    @wp.func
    def deepest(facet: Facet, found: Deepest, collider: ColliderMotion, thickness: float, ctx: Context) -> wp.vec3:
        return found.weights

    @wp.func
    def pressed_at(facet: Facet, found: Deepest, collider: ColliderMotion, thickness: float, ctx: Context) -> wp.vec3:
        # The load of a pinch is that of one point.
        if collider.opposite != 0 or wp.max(found.weights) > CORNER:
            return found.weights
        if not has_edges(collider.shape, collider.data):
            return found.weights
        note_searches(1, collider, ctx)
        return balanced(collider.shape, collider.size, collider.data, facet, found, thickness)

    return deepest if features.segments or has_edges is None else pressed_at


def make_touched_in(features: Features):
    """Return a Warp function: the weights of the point of a facet that touches one collider; 0 if none can."""
    shapes = features.facet_shapes
    touched, is_beyond = make_touched(shapes, features.segments), make_is_beyond(shapes)
    least, pressed_at = make_least(shapes), _make_pressed_at(features)

    @wp.func
    def touched_in(facet: Facet, entry: int, collider: ColliderMotion, thickness: float, ctx: Context) -> wp.vec3:
        way = longest_way(facet)
        look = ctx.state.contact.looks[entry]
        moved = moved_since(look, facet)
        # No point came nearer than by its displacement, nor was it nearer in between.
        if look.known == 1 and look.value - moved - way >= thickness:
            return wp.vec3(0.0)
        if wp.static(is_beyond is not None):
            if is_beyond(collider.shape, middle_of(facet), farthest_of(facet) + thickness, collider.data):
                return wp.vec3(0.0)
        note_work(1, ctx)
        slow = way <= FAST * thickness
        found = Deepest()
        found.value = least(collider.shape, collider.size, collider.data, facet, not slow)
        if found.value >= thickness - NOISE:  # true for most facets on a flat face
            ctx.state.contact.looks[entry] = looked(facet, found)
            return wp.vec3(0.0)
        known = wp.vec3(0.0)
        if look.known == 1 and moved <= _STILL * thickness and slow:
            known = look.weights
        off = wp.where(look.known == 1, look.value - moved - way, 0.0)
        touch = touched(collider.shape, collider.size, collider.data, facet, thickness, known, off)
        note_searches((touch.searches + 2) / 3, collider, ctx)  # farther off they cost less
        found = touch.deepest
        if touch.left == 0.0:  # otherwise the point is where the facet touched the collider first
            if wp.max(known) == 0.0:
                ctx.state.contact.looks[entry] = looked(facet, found)
            else:
                ctx.state.contact.looks[entry].weights = found.weights
            if found.value >= thickness - NOISE:
                return wp.vec3(0.0)
            return pressed_at(facet, found, collider, thickness, ctx)
        return found.weights

    return touched_in
