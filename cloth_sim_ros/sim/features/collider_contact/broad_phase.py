# SPDX-License-Identifier: Apache-2.0
"""Broad phase: list the colliders that a body may touch in a frame, so that distant ones cost its particles nothing.

The list assumes that particles stay within a box around the body, and that each goes no farther than a margin in a
substep. For such a particle, the contact test skips every collider that is not listed. A particle that leaves the box
or goes farther tests all colliders, so the list saves work without changing the result. A collider that it touches is
listed for the rest of the frame. Forces and friction of unlisted colliders are 0.

Scenes with few colliders have no list: every particle tests all of them.
"""

import warp as wp

from cloth_sim_ros.sim.arrays.context import Context
from cloth_sim_ros.sim.arrays.model import Features
from cloth_sim_ros.sim.arrays.state import ColliderMotion
from cloth_sim_ros.sim.features.collider_contact.arrays import BOX, EXTENT, WORD, words_of
from cloth_sim_ros.sim.kernels.intrinsics import load4, load_row, lowest_bit, pack, store_row, xyz
from cloth_sim_ros.sim.physics.path import longest

FEW = 8  # largest number of colliders without a list, which would cost as much as it saves
_ALL = wp.constant(wp.uint64(0xFFFFFFFFFFFFFFFF))
_NONE = 1 << 30
_FAR = wp.constant(1.0e30)
_ROUNDING = wp.constant(1.0e-5)  # rounding error as a fraction of a coordinate
_ARC = wp.constant(2.23)  # largest ratio of a rotation angle (up to pi) to the distance of its unit quaternions


@wp.struct
class Near:
    """The colliders that a body may touch, as bits in `count` words from index `first` on, and the list's validity.

    bits: the first word, as it was when the stage began. middle, half: center and half size of the box [m]. margin:
    largest displacement in a substep [m]. some: True if a collider is not listed.
    """

    words: wp.array(dtype=wp.uint64)
    first: int
    count: int
    bits: wp.uint64
    middle: wp.vec3
    half: wp.vec3
    margin: float
    some: bool


@wp.func
def moved_of(c: ColliderMotion, share: float) -> wp.vec2:
    """Return bounds of the distance [m] and the angle [rad] that a collider moves in a share of the frame."""
    q0 = c.start_orientation
    q1 = c.end_orientation
    apart = wp.min(wp.length(q1 - q0), wp.length(q1 + q0))
    way = longest(wp.length(c.end_position - c.start_position), c.bends.start, c.bends.end)
    return wp.vec2(share * way, share * longest(_ARC * apart, c.bends.start_turn, c.bends.end_turn))


def make_near_of(listed: bool):
    """Return a Warp function that reads the list of a body, once a thread and stage; empty if not `listed`."""

    @wp.func
    def near_of(ctx: Context) -> Near:
        near = Near()
        if wp.static(listed):
            near.words = ctx.state.contact.near
            near.count = words_of(ctx.colliders.shape[0])
            near.first = ctx.body.index * near.count
            near.bits = near.words[near.first]
            near.some = ctx.state.contact.extents[wp.static(EXTENT) * ctx.body.index + 7] > 0.0
            if near.some:
                first = wp.static(EXTENT) * ctx.body.index + wp.static(BOX)
                near.margin = ctx.state.contact.extents[first + 3]
                for k in range(3):
                    near.middle[k] = ctx.state.contact.extents[first + k]
                    near.half[k] = ctx.state.contact.extents[first + 4 + k]
        return near

    return near_of


@wp.func
def strays(near: Near, at: wp.vec3, d: wp.vec3) -> bool:
    """Return True if the list does not hold for a particle that comes to `at` by `d`, also if it is not finite."""
    if not near.some:
        return False
    off = at - near.middle
    inside = wp.abs(off[0]) <= near.half[0] and wp.abs(off[1]) <= near.half[1] and wp.abs(off[2]) <= near.half[2]
    return not (inside and wp.length_sq(d) <= near.margin * near.margin)


@wp.func
def next_of(c: int, near: Near, stray: bool) -> int:
    """Return the next collider after c that a particle tests; after the last one, a number past the end."""
    behind = c + 1
    if stray or not near.some:
        return behind
    q = behind / wp.static(WORD)
    if q >= near.count:
        return wp.static(_NONE)
    bits = near.bits
    if q > 0:
        bits = near.words[near.first + q]
    bits &= _ALL << wp.uint64(behind % wp.static(WORD))
    while bits == wp.uint64(0):
        q += 1
        if q == near.count:
            return wp.static(_NONE)
        bits = near.words[near.first + q]
    return wp.static(WORD) * q + lowest_bit(bits)


@wp.func
def note(c: int, near: Near):
    """Add collider c, which touches the body, to the list if it is incomplete."""
    if near.some:
        bit = wp.uint64(1) << wp.uint64(c % wp.static(WORD))
        if near.words[near.first + c / wp.static(WORD)] & bit == wp.uint64(0):
            wp.atomic_or(near.words, near.first + c / wp.static(WORD), bit)


def make_forget_contacts(features: Features):
    """Return the stage that begins a frame: clear the contacts and forces of colliders.

    If bodies have a list of colliders, only the listed ones are cleared. What touched a rope in the last substep stays.
    """
    listed, pinches, leans = features.listed, features.pinches, features.leans
    near_of = make_near_of(listed)

    @wp.func
    def forget_contacts(t: int, width: int, ctx: Context):
        colliders, near = ctx.colliders.shape[0], near_of(ctx)
        taken = ctx.state.control.taken[ctx.body.index]
        if wp.static(pinches):
            for c in range(t, colliders, width):
                entry = ctx.body.index * colliders + c
                squeezed = ctx.state.contact.squeezed_in[entry]
                ctx.state.contact.squeezed_in[entry] = wp.where(squeezed > taken, 1, 0)
        near.some = wp.static(listed)  # the words hold the last list; the rest is from the frame before
        c = next_of(-1, near, False)
        while c < colliders:
            for i in range(t, ctx.body.count, width):
                entry = (ctx.body.particles + i) * colliders + c
                store_row(ctx.state.contact.contact_forces, entry, wp.vec4(0.0))
                kept = wp.vec4(0.0)
                if wp.static(pinches or leans):
                    # The first substep goes on from the last one of the frame before.
                    last = load_row(ctx.state.contact.contacts, entry)
                    if last[3] > float(taken):
                        kept = pack(wp.where(wp.static(leans), xyz(last), wp.vec3(0.0)), 1.0)
                store_row(ctx.state.contact.contacts, entry, kept)
            c = next_of(c, near, False)
        if wp.static(listed):
            if t == 0:
                for k in range(wp.static(BOX)):
                    ctx.state.contact.extents[wp.static(EXTENT) * ctx.body.index + k] = wp.where(
                        k < 3, _FAR, wp.where(k < 6, -_FAR, 0.0)
                    )

    return forget_contacts


@wp.func
def measure_extent(t: int, width: int, ctx: Context):
    """Stage after forget_contacts: measure the body's box and largest speed, and clear its list."""
    first = wp.static(EXTENT) * ctx.body.index
    lo, high, square = wp.vec3(_FAR), wp.vec3(-_FAR), float(0.0)
    for i in range(t, ctx.body.count, width):
        x = xyz(load4(ctx.x, i))
        lo, high = wp.min(lo, x), wp.max(high, x)
        square = wp.max(square, wp.length_sq(xyz(load_row(ctx.state.velocities, ctx.body.particles + i))))
    for k in range(3):
        if lo[k] < ctx.state.contact.extents[first + k]:
            wp.atomic_min(ctx.state.contact.extents, first + k, lo[k])
        if high[k] > ctx.state.contact.extents[first + 3 + k]:
            wp.atomic_max(ctx.state.contact.extents, first + 3 + k, high[k])
    if square > ctx.state.contact.extents[first + 6]:
        wp.atomic_max(ctx.state.contact.extents, first + 6, square)
    words = words_of(ctx.colliders.shape[0])
    for q in range(t, words, width):
        ctx.state.contact.near[ctx.body.index * words + q] = wp.uint64(0)


@wp.func
def list_colliders(t: int, width: int, ctx: Context):
    """Stage after measure_extent: list the colliders that particles within the box may touch in this frame."""
    first = wp.static(EXTENT) * ctx.body.index
    lo, high = wp.vec3(0.0), wp.vec3(0.0)
    for k in range(3):
        lo[k] = ctx.state.contact.extents[first + k]
        high[k] = ctx.state.contact.extents[first + 3 + k]
    substeps = float(ctx.frame.substeps)
    # Half as far again as the fastest particle goes, and a little for a body at rest.
    margin = 1.5 * ctx.frame.dt * substeps * wp.sqrt(ctx.state.contact.extents[first + 6]) + 0.05 * wp.length(high - lo)
    near = Near()
    near.words = ctx.state.contact.near
    near.count = words_of(ctx.colliders.shape[0])
    near.first = ctx.body.index * near.count
    near.middle = 0.5 * (lo + high)
    near.margin = margin
    near.half = 0.5 * (high - lo) + wp.vec3(margin)
    near.some = True
    if t == 0:
        ctx.state.contact.extents[first + wp.static(BOX + 3)] = margin
        for k in range(3):
            ctx.state.contact.extents[first + wp.static(BOX) + k] = near.middle[k]
            ctx.state.contact.extents[first + wp.static(BOX + 4) + k] = near.half[k]
    for c in range(t, ctx.colliders.shape[0], width):
        if may_meet(ctx.colliders[c], near, ctx.material.thickness, substeps):
            note(c, near)
        else:
            ctx.state.contact.extents[first + 7] = 1.0


@wp.func
def may_meet(c: ColliderMotion, near: Near, thickness: float, substeps: float) -> bool:
    """Return False if no particle that keeps to the box and margin can touch the collider in this frame.

    Such a particle ends at least `away` from the whole path of the collider's origin. Its displacement relative to the
    collider is at most `path`, plus the effect of the collider's rotation.
    """
    middle = 0.5 * (c.start_position + c.end_position) - near.middle
    beyond = wp.vec3(0.0)
    for k in range(3):
        beyond[k] = wp.max(wp.abs(middle[k]) - near.half[k], 0.0)
    moved = moved_of(c, 1.0 / substeps)
    away = wp.length(beyond) - 0.5 * substeps * moved[0]
    spin = 1.4143 * moved[1]  # bound: Frobenius norm of a rotation minus the identity over its angle
    path = near.margin + moved[0]
    slack = _ROUNDING * (wp.length(near.middle) + wp.length(near.half) + wp.length(middle) + path)
    return spin >= 1.0 or away * (1.0 - spin) - path * (1.0 + spin) - slack < c.reach + thickness
