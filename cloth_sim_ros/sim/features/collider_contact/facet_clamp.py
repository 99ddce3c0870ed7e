# SPDX-License-Identifier: Apache-2.0
"""Clamp displacements so that no facet passes through a collider within a substep.

A facet and a convex collider begin a substep on opposite sides of a plane between their nearest points. If the facet
would pass through the collider's surface, its corners stop at the plane (divide and truncate, Chen et al. 2025, Offset
geometric contact). The plane moves with the collider. For a non-convex collider it is the plane of its surface where
the facet touches it first.
"""

import warp as wp

from cloth_sim_ros.sim.arrays.context import Context, note_searches
from cloth_sim_ros.sim.arrays.model import Features
from cloth_sim_ros.sim.arrays.state import ColliderMotion
from cloth_sim_ros.sim.colliders import make_width
from cloth_sim_ros.sim.features.collider_contact.arrays import Sweep
from cloth_sim_ros.sim.features.collider_contact.broad_phase import make_near_of, next_of
from cloth_sim_ros.sim.features.collider_contact.facet import back, longest_way, make_least
from cloth_sim_ros.sim.features.collider_contact.facet_place import (
    corner_in,
    corners_of,
    facet_of,
    is_stray,
    is_tested,
    moved_since,
    slip_of_particle,
)
from cloth_sim_ros.sim.features.collider_contact.facet_search import ADVANCES, make_deepest
from cloth_sim_ros.sim.features.collider_contact.particle import Met, add_force, length_of
from cloth_sim_ros.sim.features.collider_contact.sweep import NOISE
from cloth_sim_ros.sim.kernels.intrinsics import load4, pack, store4, store_row, xyz

# Bits of State.pressed: a particle of a pressed or fast facet, the same after that stage, and one that stops.
PRESSED, MOVED, STOPS = wp.constant(1), wp.constant(2), wp.constant(4)
# Fractions of a facet's distance from a collider, and of its thickness, that no substep takes away.
_LEFT, _LEAST = wp.constant(0.1), wp.constant(0.1)
_ROUNDS = 3  # rounds in which a particle meets the planes of all its facets
# A facet is hit, and gives up all of its motion, if it moves into a plane by more than the thickness. On a collider
# that is not convex it may slide on into another part. There this share of its way is enough; with half, two of 120 of
# those that are thrown pass.
_HIT_HOLLOW = wp.constant(0.1)
_STEEP = wp.constant(0.25)  # least squared gradient of a plane, below which a facet is between two sides


@wp.func
def mark(corners: wp.vec3i, bit: int, ctx: Context):
    """Set a bit of all corners of a facet, as other threads may too at the same time."""
    for k in range(3):
        slot = ctx.body.particles + corners[k]
        ctx.state.contact.pressed[slot] = ctx.state.contact.pressed[slot] | bit


@wp.func
def _least(apart: float, thickness: float) -> float:
    """Return how near a facet that is `apart` [m] from a collider may come to it [m]."""
    return wp.max(_LEFT * apart, wp.min(_LEAST * thickness, apart))


@wp.func
def _given_up(start: wp.vec3, slip: wp.vec3, plane: wp.vec4, least: float) -> float:
    """Return the share of its displacement that a corner gives up to stay in front of a plane by `least` [m]."""
    goes, has = -wp.dot(xyz(plane), slip), wp.max(wp.dot(xyz(plane), start) + plane[3] - least, 0.0)
    return wp.where(goes > has, 1.0 - has / wp.max(goes, 1.0e-30), 0.0)


def _make_given_up(features: Features):
    """Return a Warp function: shares of their displacements that a facet's corners give up for one collider."""
    shapes = features.facet_shapes
    deepest, width, lowest = make_deepest(shapes, features.segments), make_width(shapes), make_least(shapes)

    @wp.func
    def given_up(corners: wp.vec3i, entry: int, collider: ColliderMotion, sweep: Sweep, ctx: Context) -> wp.vec3:
        """Return the shares, and store the plane's gradient.

        They are 0 if the facet does not pass through, or was inside before, as in a soft collider.

        A pressed facet stays in front of the plane in any case, even if others hold a corner back.
        """
        none = wp.vec3(0.0)
        hollow = bool(False)
        if wp.static(width is not None):
            hollow = width(collider.shape, collider.data) > 0.0
        facet, thickness = facet_of(corners, ctx, sweep), ctx.material.thickness
        way, look = longest_way(facet), ctx.state.contact.looks[entry]
        # Lower bound of its distance when the substep began.
        off = wp.where(look.known == 1, look.value - moved_since(look, facet) - way, 0.0)
        pressed = ctx.state.contact.presses[entry].when == ctx.substep
        if collider.compliance > 0.0 or (off > 0.0 and not pressed) or way <= off - _least(off, thickness):
            return none
        # On its way over a flat face it comes no nearer.
        if lowest(collider.shape, collider.size, collider.data, facet, True) >= _LEAST * thickness:
            return none
        left, count = float(1.0), int(0)
        plane = wp.vec4(0.0)
        apart = float(0.0)
        # No point comes nearer than by its own displacement (conservative advancement).
        while count < wp.static(ADVANCES):
            was = back(facet, left)
            found = deepest(collider.shape, collider.size, collider.data, was, thickness, none)
            if count == 0 or hollow:
                plane = found.plane
                apart = wp.max(found.value, 0.0)
            note_searches(1, collider, ctx)
            # Rounding alone must not let a facet in that was stopped at the surface.
            if (count == 0 and found.value <= -NOISE) or left * way < found.value:
                return none
            if pressed or (count > 0 and found.value < 1.0e-3 * thickness):
                break
            left -= found.value / way
            count += 1
        front = xyz(plane)
        into = -wp.min(wp.vec3(wp.dot(front, facet.slip_a), wp.dot(front, facet.slip_b), wp.dot(front, facet.slip_c)))
        if wp.length_sq(front) < _STEEP or into > wp.where(hollow, _HIT_HOLLOW * way, thickness):
            front = none
        ctx.state.contact.presses[entry].front = front
        start, least = back(facet, 1.0), _least(apart, thickness)
        return wp.vec3(
            _given_up(start.a, facet.slip_a, plane, least),
            _given_up(start.b, facet.slip_b, plane, least),
            _given_up(start.c, facet.slip_c, plane, least),
        )

    return given_up


def make_facet_clamp(features: Features):
    """Return the stage that finds facets that pass through a collider, and the shares that their corners give up.

    Thread t of `width` does its share.
    """
    given_up, near_of = _make_given_up(features), make_near_of(features.listed)

    @wp.func
    def stop(t: int, width: int, ctx: Context):
        if ctx.state.contact.facets_moved_in[ctx.body.index] != ctx.substep + 1:
            return
        colliders, near, first = ctx.colliders.shape[0], near_of(ctx), ctx.body.particles
        for k in range(ctx.body.panels + t, ctx.body.panels_end, width):
            corners, moved = corners_of(k, ctx), int(0)
            for q in range(3):
                moved |= ctx.state.contact.pressed[first + corners[q]]
            if moved & MOVED != 0 and corners[0] != corners[1]:
                stray = is_stray(corners, near, ctx)
                c = next_of(-1, near, stray)
                while c < colliders:
                    sweep = ctx.state.contact.sweeps[ctx.sweep + c]
                    if is_tested(corners, ctx, ctx.colliders[c], sweep):
                        entry = k * colliders + c
                        shares = given_up(corners, entry, ctx.colliders[c], sweep, ctx)
                        if wp.max(shares) > 0.0:
                            ctx.state.contact.presses[entry].stops = shares
                            ctx.state.contact.presses[entry].stopped = ctx.substep
                            mark(corners, STOPS, ctx)
                    c = next_of(c, near, stray)

    return stop


@wp.func
def _share_of(i: int, q: int, c: int, ctx: Context) -> float:
    """Return the share of its displacement that particle i gives up for facet q and collider c."""
    press = ctx.state.contact.presses[q * ctx.colliders.shape[0] + c]
    return wp.where(press.stopped == ctx.substep, press.stops[corner_in(q, i, ctx)], 0.0)


@wp.func
def _front_of(q: int, c: int, ctx: Context) -> wp.vec3:
    """Return the gradient of the plane of facet q in the axes of collider c; 0 if all motion is given up."""
    return ctx.state.contact.presses[q * ctx.colliders.shape[0] + c].front


@wp.func
def _slip_by(i: int, c: int, ctx: Context) -> wp.vec3:
    """Return the displacement of particle i relative to collider c, in world axes [m]."""
    sweep = ctx.state.contact.sweeps[ctx.sweep + c]
    return wp.transpose(sweep.to_local) * slip_of_particle(i, ctx, sweep)


@wp.func
def _kept_back(i: int, q: int, c: int, less: wp.vec3, ctx: Context) -> wp.vec3:
    """Return the change `less` of a displacement [m], and what keeps particle i in front of the plane of facet q."""
    share = _share_of(i, q, c, ctx)
    if share == 0.0:
        return less
    front = wp.transpose(ctx.state.contact.sweeps[ctx.sweep + c].to_local) * _front_of(q, c, ctx)
    lacks = -share * wp.dot(front, _slip_by(i, c, ctx)) - wp.dot(front, less)
    return less + (wp.max(lacks, 0.0) / wp.max(wp.length_sq(front), _STEEP)) * front


@wp.func
def _largest_share(i: int, places: wp.vec2i, ctx: Context) -> wp.vec3:
    """Return the largest share of particle i, the number of its collider, and the largest one of all motion."""
    found = wp.vec3(0.0)
    for place in range(places[0], places[1]):
        q = ctx.model.particle_panels[place]
        for c in range(ctx.colliders.shape[0]):
            share = _share_of(i, q, c, ctx)
            if share > found[0]:
                found[0] = share
                found[1] = float(c)
            if share > found[2] and wp.length_sq(_front_of(q, c, ctx)) == 0.0:
                found[2] = share
    return found


@wp.func
def _given_up_by(i: int, places: wp.vec2i, largest: wp.vec3, ctx: Context) -> wp.vec3:
    """Return the change of the displacement of particle i [m]."""
    slip = _slip_by(i, int(largest[1]), ctx)
    less, before = -largest[2] * slip, wp.vec3(0.0)
    for _k in range(_ROUNDS):
        before = less
        for place in range(places[0], places[1]):
            for c in range(ctx.colliders.shape[0]):
                less = _kept_back(i, ctx.model.particle_panels[place], c, less, ctx)
    return wp.where(wp.length(less - before) > NOISE, -largest[0] * slip, less)


def make_give_up_way(features: Features):
    """Return the stage after it: particle i gives up what its facets have found.

    What slides along a plane gives up motion along the normal alone, or cloth would not slide over an edge. Several
    planes are met one after another. If they are not met after _ROUNDS, it gives up its largest share of all motion.
    """

    @wp.func
    def stay(i: int, met: Met, ctx: Context):
        marks = ctx.state.contact.pressed[met.slot]
        if marks == 0:
            return
        ctx.state.contact.pressed[met.slot] = 0
        if marks & STOPS == 0 or load4(ctx.d, i)[3] == 0.0:
            return
        places = wp.vec2i(ctx.model.panel_start[met.slot], ctx.model.panel_start[met.slot + 1])
        largest, packed = _largest_share(i, places, ctx), load4(ctx.d, i)
        less = _given_up_by(i, places, largest, ctx)
        moved = xyz(packed) + less
        store4(ctx.d, i, pack(moved, packed[3]))
        add_force(met.slot * ctx.colliders.shape[0] + int(largest[1]), (met.share / packed[3]) * less, ctx)
        if wp.static(features.order == 2):
            # BDF2 carries the past displacement on. Setting it to the new one keeps the particle from bouncing.
            moved -= xyz(load4(ctx.position_lo, i))
            ctx.state.last_displacements[met.slot] = moved
            store_row(ctx.state.velocities, met.slot, pack(moved / length_of(ctx.step), 0.0))

    return stay
