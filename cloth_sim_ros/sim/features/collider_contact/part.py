# SPDX-License-Identifier: Apache-2.0
"""What is placed into a collider leaves it without a velocity, as if it had lain beside it before.

Else it would be flung out, and gain energy. The first substep after anything was changed measures how deep each
particle is in a collider, and the next ones take it out little by little. Particles and facets of a sheet are pushed
out by contact, and that part of their displacement is taken from their velocity. A rope is moved before its solve,
which else would bring its neighbours up to that speed.
"""

import warp as wp

from cloth_sim_ros.sim.arrays.context import Context
from cloth_sim_ros.sim.arrays.model import Features
from cloth_sim_ros.sim.arrays.state import ColliderMotion, State
from cloth_sim_ros.sim.colliders import make_signed_distance
from cloth_sim_ros.sim.features.collider_contact.arrays import EXTENT, OVERLAPS, Sweep
from cloth_sim_ros.sim.features.collider_contact.broad_phase import make_near_of, next_of
from cloth_sim_ros.sim.features.collider_contact.ccd import make_ccd
from cloth_sim_ros.sim.features.collider_contact.facet import Facet, point_of, slip_at
from cloth_sim_ros.sim.features.collider_contact.sweep import UNLIMITED, Apart, is_measured, pace, separated, slip_of
from cloth_sim_ros.sim.features.grasp.hold import HELD
from cloth_sim_ros.sim.kernels.intrinsics import load4, store4, xyz

# Overlap of what is placed, as a fraction of the thickness, from which on it is moved out without a velocity.
SMALL = wp.constant(0.1)


@wp.func
def longer(one: wp.vec3, other: wp.vec3) -> wp.vec3:
    """Return the longer one of two vectors."""
    return wp.where(wp.length_sq(one) < wp.length_sq(other), other, one)


@wp.func
def _place_of(i: int, ctx: Context) -> int:
    return 4 * (ctx.body.particles + i)


@wp.func
def is_placed(b: int, s: State) -> bool:
    """Return True if body b was placed into a collider when anything was changed last."""
    return s.contact.extents[wp.static(EXTENT) * b + wp.static(OVERLAPS)] > 0.0


@wp.func
def left_of(i: int, ctx: Context) -> float:
    """Return what is left of the overlap [m] of particle i as it was placed."""
    if ctx.placed:
        return ctx.state.contact.overlaps[_place_of(i, ctx) + 3]
    return 0.0


@wp.func
def parted_of(i: int, ctx: Context) -> wp.vec3:
    """Return by how much particle i was moved out of an overlap [m] in this substep."""
    parted = wp.vec3(0.0)
    if ctx.placed:
        for k in range(3):
            parted[k] = ctx.state.contact.overlaps[_place_of(i, ctx) + k]
    return parted


@wp.func
def _put_parted(i: int, parted: wp.vec3, ctx: Context):
    for k in range(3):
        ctx.state.contact.overlaps[_place_of(i, ctx) + k] = parted[k]


@wp.func
def note_parted(i: int, moved: wp.vec3, ctx: Context):
    """Note by how much particle i is moved out of an overlap [m] in this substep, if by more than so far."""
    if wp.length_sq(moved) > 0.0:  # few are moved, so what was noted is read for these alone
        if wp.length_sq(moved) > wp.length_sq(parted_of(i, ctx)):
            _put_parted(i, moved, ctx)


@wp.func
def take_parted(i: int, ctx: Context) -> wp.vec3:
    """Return the same, and take it off what is left."""
    parted = parted_of(i, ctx)
    if wp.length_sq(parted) > 0.0:
        ctx.state.contact.overlaps[_place_of(i, ctx) + 3] = wp.max(left_of(i, ctx) - wp.length(parted), 0.0)
        _put_parted(i, wp.vec3(0.0), ctx)
    return parted


@wp.func
def measure(i: int, overlap: float, apart: Apart, ctx: Context):
    """Note the overlap [m] of a point of particle i, if it is measured now and is no small error of contact."""
    if apart.left == UNLIMITED and overlap > SMALL * ctx.material.thickness:
        ctx.state.contact.extents[wp.static(EXTENT) * ctx.body.index + wp.static(OVERLAPS)] = 1.0
        wp.atomic_max(ctx.state.contact.overlaps, _place_of(i, ctx) + 3, overlap)


@wp.func
def forget_overlaps(t: int, width: int, ctx: Context):
    """Stage that begins a frame: overlaps are measured anew if anything was changed."""
    if ctx.frame.wakes > 0:
        for i in range(t, ctx.body.count, width):
            ctx.state.contact.overlaps[_place_of(i, ctx) + 3] = 0.0
        ctx.state.contact.extents[wp.static(EXTENT) * ctx.body.index + wp.static(OVERLAPS)] = 0.0


def make_meet(features: Features):
    """Return a Warp function: normal and gap [m] of a point of particle i, and the part of it that ends an overlap.

    See make_ccd. A rope is moved out of an overlap by `part`, so that its contact has no part in that.
    """
    meet, leans = make_ccd(features.shapes, features.leans), features.leans

    @wp.func
    def meet_at(
        i: int, collider: ColliderMotion, sweep: Sweep, p: wp.vec3, slip: wp.vec3, thickness: float, ctx: Context
    ) -> tuple[wp.vec4, float]:
        apart = pace(collider, left_of(i, ctx), ctx)
        met, parts, overlap = meet(collider.shape, collider.size, collider.data, p, slip, thickness, apart)
        measure(i, overlap, apart, ctx)
        if wp.static(leans):
            met[3] += wp.max(parts - wp.dot(parted_of(i, ctx), wp.transpose(sweep.to_local) * xyz(met)), 0.0)
            parts = 0.0
        return met, parts

    return meet_at


def make_meet_between(features: Features):
    """Return the same for a point of a facet, with weights of its corners."""
    meet, leans = make_ccd(features.shapes, features.leans), features.leans

    @wp.func
    def meet_between(
        corners: wp.vec3i,
        weights: wp.vec3,
        collider: ColliderMotion,
        sweep: Sweep,
        facet: Facet,
        thickness: float,
        ctx: Context,
    ) -> tuple[wp.vec4, float]:
        left = wp.max(wp.max(left_of(corners[0], ctx), left_of(corners[1], ctx)), left_of(corners[2], ctx))
        p, slip, apart = point_of(facet, weights), slip_at(facet, weights), pace(collider, left, ctx)
        met, parts, overlap = meet(collider.shape, collider.size, collider.data, p, slip, thickness, apart)
        for k in range(3):
            if weights[k] > 0.0:
                measure(corners[k], overlap, apart, ctx)
        if wp.static(leans):
            parted = weights[0] * parted_of(corners[0], ctx) + (weights[1] + weights[2]) * parted_of(corners[1], ctx)
            met[3] += wp.max(parts - wp.dot(parted, wp.transpose(sweep.to_local) * xyz(met)), 0.0)
            parts = 0.0
        return met, parts

    return meet_between


def _make_way_out(features: Features):
    """Return a Warp function: the way [m] out of collider c in this substep of a point at `at` as it begins.

    left: what is left of its overlap [m].
    """
    signed_distance = make_signed_distance(features.shapes)

    @wp.func
    def way_out(at: wp.vec3, left: float, c: int, ctx: Context) -> wp.vec3:
        collider, sweep = ctx.colliders[c], ctx.state.contact.sweeps[ctx.sweep + c]
        from_it = at - sweep.position
        local = sweep.to_local * from_it - slip_of(from_it, wp.vec3(0.0), sweep)
        met = signed_distance(collider.shape, local, collider.size, collider.data)
        out = separated(ctx.material.thickness - met[3], pace(collider, left, ctx))
        return out * (wp.transpose(sweep.to_local) * xyz(met))

    return way_out


@wp.func
def _start_of(i: int, ctx: Context) -> wp.vec3:
    return xyz(load4(ctx.x, i)) + xyz(load4(ctx.position_lo, i))


@wp.func
def _weights_beside(i: int, point: int, c: int, ctx: Context) -> wp.vec3:
    """Return the weights of a point of a rope, and the move of particle i that moves it by 1.

    point: 0 is the particle itself; 1 and 2 are where collider c pressed the segment that begins and ends there.
    """
    k = i - wp.where(point == 2, 1, 0)
    if point == 0:
        return wp.vec3(1.0, 0.0, 1.0)
    if k < 0 or k + 1 >= ctx.body.count:
        return wp.vec3(0.0)
    entry = (ctx.body.panels + k) * ctx.colliders.shape[0] + c
    if ctx.state.contact.presses[entry].when < ctx.substep - 1:
        return wp.vec3(0.0)
    weights = ctx.state.contact.presses[entry].weights
    beyond = weights[1] + weights[2]
    share = wp.where(k == i, weights[0], beyond) / (weights[0] * weights[0] + beyond * beyond)
    return wp.vec3(weights[0], beyond, share)


def make_part(features: Features):
    """Return a Warp function that moves particle i of a rope out of an overlap before its solve, if there was any.

    If a collider pressed a segment beside the particle deeper, it goes with that.
    """
    near_of, way_out = make_near_of(features.listed), _make_way_out(features)
    points = 3 if features.surface else 1

    @wp.func
    def part(i: int, ctx: Context):
        packed = load4(ctx.d, i)
        if not ctx.placed or is_measured(ctx) or packed[3] <= HELD * load4(ctx.x, i)[3]:
            return
        near, way = near_of(ctx), wp.vec3(0.0)
        c = next_of(-1, near, False)
        while c < ctx.colliders.shape[0]:
            for point in range(wp.static(points)):
                weights = _weights_beside(i, point, c, ctx)
                k = wp.max(i - wp.where(point == 2, 1, 0), 0)
                beyond = wp.min(k + 1, ctx.body.count - 1)
                at = weights[0] * _start_of(k, ctx) + weights[1] * _start_of(beyond, ctx)
                left = wp.max(left_of(k, ctx), wp.where(weights[1] > 0.0, left_of(beyond, ctx), 0.0))
                way = longer(way, weights[2] * way_out(at, left, c, ctx))
            c = next_of(c, near, False)
        note_parted(i, way, ctx)
        ctx.state.rope.targets[ctx.body.particles + i] += way
        store4(ctx.d, i, packed + wp.vec4(way[0], way[1], way[2], 0.0))

    return part
