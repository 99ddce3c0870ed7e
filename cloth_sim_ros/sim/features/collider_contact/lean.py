# SPDX-License-Identifier: Apache-2.0
"""Contact of a rope's particles within its solve, as an augmented Lagrangian of Coulomb's law.

A collider that presses a particle by p_0 so far, in a place `gap` above it and after a slip s, corrects it by

    p = (p_0n - R gap) n + (p_0t - R s)    while that is within the cone of friction,

with p_n >= 0, and with the tangential part cut to the cone where it slides. R, a ratio of a contact's stiffness to the
mass of the particle, is finite, so that the rope is solved with the contact as one more spring. The multiplier p is
carried to the next substep, so that R does not matter for what rests (Alart and Curnier 1991; Daviet 2020, Simple and
scalable frictional contacts for thin nodal objects). The stage `contact` behind the solve takes what R left.
"""

import warp as wp

from cloth_sim_ros.sim.arrays.context import Context
from cloth_sim_ros.sim.arrays.model import Features
from cloth_sim_ros.sim.features.collider_contact.broad_phase import Near, next_of, strays
from cloth_sim_ros.sim.features.collider_contact.ccd import make_ccd
from cloth_sim_ros.sim.features.collider_contact.pinch import make_is_squeezed
from cloth_sim_ros.sim.features.collider_contact.sweep import pace, slip_of
from cloth_sim_ros.sim.features.grasp.hold import HELD
from cloth_sim_ros.sim.kernels.intrinsics import load4, load_row, pack, store_row, xyz

RATIO = wp.constant(100.0)  # R
ROUNDING = wp.constant(2.4e-7)  # rounding error of a gap as a fraction of the distance from the collider's origin


@wp.func
def ratio_along(softness: float) -> float:
    """Return R along the normal of a collider; softness: its compliance over the particle's inverse mass x h^2."""
    return RATIO / (1.0 + RATIO * softness)


@wp.func
def change_of(u: wp.vec3, n: wp.vec3, softness: float, rubbed: float) -> wp.vec3:
    """Return by how much a collider's correction [m] falls while the solve moves its particle by u [m].

    rubbed: 1 while the particle sticks, less where it slides.
    """
    along = wp.dot(u, n)
    return (ratio_along(softness) * along) * n + (RATIO * rubbed) * (u - along * n)


@wp.func
def exact_gap(gap: float, opened: float, size: float) -> float:
    """Return a gap [m], of which the part before this substep counts as 0 if rounding at that size [m] may be all of it.

    opened: the part in this substep [m], known with more digits. R times the rounding error would exceed a weight.
    """
    before = gap - opened
    return opened + wp.sign(before) * wp.max(wp.abs(before) - ROUNDING * size, 0.0)


def make_lean(features: Features):
    """Return a Warp function that finds what colliders do to particle i at the start of a rope's solve."""
    meet, is_squeezed = make_ccd(features.shapes), make_is_squeezed(features)

    @wp.func
    def lean(i: int, near: Near, ctx: Context):
        g, packed, position = ctx.body.particles + i, load4(ctx.d, i), xyz(load4(ctx.x, i))
        displacement, w = xyz(packed), packed[3]
        push, hold = wp.vec3(0.0), wp.mat33(0.0)
        ctx.state.rope.starts[g] = displacement
        stray = strays(near, position + displacement, displacement)
        c = next_of(-1, near, stray)
        while c < ctx.colliders.shape[0]:
            entry, sweep = g * ctx.colliders.shape[0] + c, ctx.state.contact.sweeps[ctx.sweep + c]
            ctx.state.contact.leans[entry] = wp.vec4(0.0)
            offset = (position - sweep.position) + displacement
            path = wp.length(displacement - sweep.motion)
            path += sweep.spin * (wp.length(offset) + path)
            away = wp.length(offset) - path - ctx.colliders[c].reach - ctx.material.thickness
            stored = load_row(ctx.state.contact.contacts, entry)
            if w > HELD * load4(ctx.x, i)[3] and (away < 0.0 or wp.length_sq(xyz(stored)) > 0.0):
                collider = ctx.colliders[c]
                slip = slip_of(position - sweep.position, displacement - xyz(load4(ctx.position_lo, i)), sweep)
                thickness, apart, p = ctx.material.thickness, pace(collider, ctx.step), sweep.to_local * offset
                met = meet(collider.shape, collider.size, collider.data, p, slip, thickness, apart)
                n, before = xyz(met), (ctx.step.effective * ctx.step.effective) * xyz(stored)
                softness = collider.compliance * ctx.step.inverse_square / w
                gap = exact_gap(met[3], wp.dot(slip, n), wp.length(offset))
                pressed = (wp.dot(before, n) / RATIO - gap) * ratio_along(softness)
                # What may be rounding neither parts the particle from the collider nor lets it slide.
                slack = RATIO * ROUNDING * wp.length(offset)
                if pressed >= -slack and not is_squeezed(i, collider, ctx):
                    rub = (before - wp.dot(before, n) * n) - RATIO * (slip - wp.dot(slip, n) * n)
                    mu_s = wp.sqrt(ctx.material.static_friction * collider.static_friction)
                    mu_k = wp.sqrt(ctx.material.kinetic_friction * collider.kinetic_friction)
                    rubbed, size = float(1.0), wp.length(rub)
                    if size > mu_s * wp.max(pressed, 0.0) + slack:
                        rubbed = mu_k * wp.max(pressed, 0.0) / size
                    local = pressed * n + rubbed * rub
                    back = wp.transpose(sweep.to_local)
                    push += back * local
                    n = back * n
                    along = wp.outer(n, n)
                    hold += ratio_along(softness) * along
                    hold += (RATIO * rubbed) * (wp.identity(n=3, dtype=float) - along)
                    store_row(ctx.state.contact.contacts, entry, pack(ctx.step.inverse_square * local, stored[3]))
                    ctx.state.contact.leans[entry] = pack(n, 1.0 + rubbed)
            c = next_of(c, near, stray)
        ctx.state.rope.pushes[g] = push
        ctx.state.rope.holds[g] = hold

    return lean
