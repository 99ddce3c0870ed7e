# SPDX-License-Identifier: Apache-2.0
"""Places of facets in a substep and in a collider's axes, and tests if a collider may touch them."""

import warp as wp

from cloth_sim_ros.sim.arrays.context import Context
from cloth_sim_ros.sim.arrays.state import ColliderMotion
from cloth_sim_ros.sim.features.collider_contact.arrays import Look, Sweep
from cloth_sim_ros.sim.features.collider_contact.broad_phase import Near, strays
from cloth_sim_ros.sim.features.collider_contact.facet import Facet
from cloth_sim_ros.sim.features.collider_contact.sweep import slip_of
from cloth_sim_ros.sim.kernels.intrinsics import load4, xyz


@wp.func
def corners_of(k: int, ctx: Context) -> wp.vec3i:
    """Return the corners of facet k; a segment has its second one twice."""
    corners = ctx.model.panels[k]
    return wp.vec3i(corners[0], corners[1], wp.where(corners[2] < 0, corners[1], corners[2]))


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
