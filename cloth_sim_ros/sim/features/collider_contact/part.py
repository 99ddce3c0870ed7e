# SPDX-License-Identifier: Apache-2.0
"""What overlaps a collider as a substep begins leaves it without a velocity, as if it had lain beside it before.

Else what is placed into a collider would be flung out, and gain energy. Particles and facets of a sheet are pushed out
by contact, and that part of their displacement is taken from their velocity. A rope is moved before its solve, which
else would bring its neighbours up to that speed.
"""

import warp as wp

from cloth_sim_ros.sim.arrays.context import Context
from cloth_sim_ros.sim.arrays.model import Features
from cloth_sim_ros.sim.arrays.state import ColliderMotion
from cloth_sim_ros.sim.colliders import make_signed_distance
from cloth_sim_ros.sim.features.collider_contact.arrays import Sweep
from cloth_sim_ros.sim.features.collider_contact.broad_phase import make_near_of, next_of
from cloth_sim_ros.sim.features.collider_contact.ccd import make_ccd
from cloth_sim_ros.sim.features.collider_contact.facet import Facet, point_of, slip_at
from cloth_sim_ros.sim.features.collider_contact.sweep import overlapped, pace, separated, slip_of
from cloth_sim_ros.sim.features.grasp.hold import HELD
from cloth_sim_ros.sim.kernels.intrinsics import load4, store4, xyz


@wp.func
def longer(one: wp.vec3, other: wp.vec3) -> wp.vec3:
    """Return the longer one of two vectors."""
    return wp.where(wp.length_sq(one) < wp.length_sq(other), other, one)


@wp.func
def parted_of(i: int, ctx: Context) -> wp.vec3:
    """Return by how much particle i was moved out of an overlap [m] in this substep."""
    if ctx.state.contact.parted_in[ctx.body.index] != ctx.substep + 1:
        return wp.vec3(0.0)
    return ctx.state.contact.parted[ctx.body.particles + i]


@wp.func
def note_parted(i: int, moved: wp.vec3, ctx: Context):
    """Note by how much particle i is moved out of an overlap [m] in this substep, if by more than so far."""
    if wp.length_sq(moved) > wp.length_sq(parted_of(i, ctx)):
        ctx.state.contact.parted[ctx.body.particles + i] = moved
        ctx.state.contact.parted_in[ctx.body.index] = ctx.substep + 1


@wp.func
def take_parted(i: int, ctx: Context) -> wp.vec3:
    """Return the same, and forget it."""
    parted = parted_of(i, ctx)
    if wp.length_sq(parted) > 0.0:
        ctx.state.contact.parted[ctx.body.particles + i] = wp.vec3(0.0)
    return parted


@wp.func
def note_overlap(overlap: float, ctx: Context):
    """Note that the body overlaps a collider, if by more than 0 [m]."""
    if overlap > 0.0:
        ctx.state.contact.overlaps_in[2 * ctx.body.index + ctx.substep % 2] = ctx.substep + 1


def make_meet(features: Features):
    """Return a Warp function: normal and gap [m] of a point of particle i, and the part of it that ends an overlap.

    See make_ccd. A rope is moved out of an overlap by `part`, so that its contact has no part in that.
    """
    meet, leans = make_ccd(features.shapes), features.leans

    @wp.func
    def meet_at(
        i: int, collider: ColliderMotion, sweep: Sweep, p: wp.vec3, slip: wp.vec3, thickness: float, ctx: Context
    ) -> tuple[wp.vec4, float]:
        apart = pace(collider, ctx)
        met, overlap = meet(collider.shape, collider.size, collider.data, p, slip, thickness, apart)
        note_overlap(overlap, ctx)
        if wp.static(leans):
            met[3] += wp.max(overlap - wp.dot(parted_of(i, ctx), wp.transpose(sweep.to_local) * xyz(met)), 0.0)
            overlap = 0.0
        return met, overlap

    return meet_at


def make_meet_between(features: Features):
    """Return the same for a point of a facet, with weights of its corners."""
    meet, leans = make_ccd(features.shapes), features.leans

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
        p, slip, apart = point_of(facet, weights), slip_at(facet, weights), pace(collider, ctx)
        met, overlap = meet(collider.shape, collider.size, collider.data, p, slip, thickness, apart)
        note_overlap(overlap, ctx)
        if wp.static(leans):
            parted = weights[0] * parted_of(corners[0], ctx) + (weights[1] + weights[2]) * parted_of(corners[1], ctx)
            met[3] += wp.max(overlap - wp.dot(parted, wp.transpose(sweep.to_local) * xyz(met)), 0.0)
            overlap = 0.0
        return met, overlap

    return meet_between


def _make_way_out(features: Features):
    """Return a Warp function: the way [m] out of collider c in this substep of a point at `at` as it begins."""
    signed_distance = make_signed_distance(features.shapes)

    @wp.func
    def way_out(at: wp.vec3, c: int, ctx: Context) -> wp.vec3:
        collider, sweep = ctx.colliders[c], ctx.state.contact.sweeps[ctx.sweep + c]
        from_it = at - sweep.position
        local = sweep.to_local * from_it - slip_of(from_it, wp.vec3(0.0), sweep)
        met = signed_distance(collider.shape, local, collider.size, collider.data)
        out = separated(ctx.material.thickness - met[3], pace(collider, ctx))
        return out * (wp.transpose(sweep.to_local) * xyz(met))

    return way_out


@wp.func
def _start_of(i: int, ctx: Context) -> wp.vec3:
    return xyz(load4(ctx.x, i)) + xyz(load4(ctx.position_lo, i))


def _make_way_beside(features: Features):
    """Return a Warp function: the way [m] of particle i if collider c pressed a segment beside it, the longer one."""
    way_out = _make_way_out(features)

    @wp.func
    def way_beside(i: int, c: int, ctx: Context) -> wp.vec3:
        way = wp.vec3(0.0)
        for k in range(wp.max(i - 1, 0), wp.min(i + 1, ctx.body.count - 1)):
            press = ctx.state.contact.presses[(ctx.body.panels + k) * ctx.colliders.shape[0] + c]
            if press.when >= ctx.substep - 1:
                first, beyond = press.weights[0], press.weights[1] + press.weights[2]
                out = way_out(first * _start_of(k, ctx) + beyond * _start_of(k + 1, ctx), c, ctx)
                share = wp.where(k == i, first, beyond) / (first * first + beyond * beyond)
                way = longer(way, share * out)
        return way

    return way_beside


def make_part(features: Features):
    """Return a Warp function that moves particle i of a rope out of an overlap before its solve, if there was any."""
    near_of, way_out, way_beside = make_near_of(features.listed), _make_way_out(features), _make_way_beside(features)

    @wp.func
    def part(i: int, ctx: Context):
        packed = load4(ctx.d, i)
        if not overlapped(ctx) or packed[3] <= HELD * load4(ctx.x, i)[3]:
            return
        near, way = near_of(ctx), wp.vec3(0.0)
        c = next_of(-1, near, False)
        while c < ctx.colliders.shape[0]:
            way = longer(way, way_out(_start_of(i, ctx), c, ctx))
            if wp.static(features.surface):
                way = longer(way, way_beside(i, c, ctx))
            c = next_of(c, near, False)
        note_parted(i, way, ctx)
        ctx.state.rope.targets[ctx.body.particles + i] += way
        store4(ctx.d, i, packed + wp.vec4(way[0], way[1], way[2], 0.0))

    return part
