# SPDX-License-Identifier: Apache-2.0
"""Forces of the air on panels, which the particles around them sum up."""

import warp as wp

from cloth_sim_ros.sim.arrays.context import Context
from cloth_sim_ros.sim.arrays.model import Features, Model
from cloth_sim_ros.sim.arrays.state import Frame, Material, State
from cloth_sim_ros.sim.features.air.panel_simd import triangle_forces
from cloth_sim_ros.sim.kernels.intrinsics import array_address, load4, load_row, store_row, xyz
from cloth_sim_ros.sim.physics.aerodynamics import segment_force, triangle_force


@wp.struct
class Corners:
    """Positions [m] and velocities [m/s] of a panel's particles; a rope's segment has no third."""

    a: wp.vec3
    b: wp.vec3
    c: wp.vec3
    va: wp.vec3
    vb: wp.vec3
    vc: wp.vec3


def make_air(features: Features):
    """Return a Warp function: the force of the air [N] on one particle of a panel, and its drag rate [N s/m]."""

    @wp.func
    def air(p: Corners, frame: Frame, material: Material) -> wp.vec4:
        if wp.static(features.panels == "triangles"):
            relative = frame.wind - (p.va + p.vb + p.vc) / 3.0
            return triangle_force(p.a, p.b, p.c, relative, frame.air_density, frame.drag, frame.lift) / 3.0
        else:
            relative = frame.wind - (p.va + p.vb) / 2.0
            return segment_force(p.a, p.b, material.thickness, relative, frame.air_density, frame.drag) / 2.0

    return air


def make_panels(features: Features):
    """Return the stage that computes the air's force on all panels of a body; thread t of `width` does its share.

    Under BDF2 it takes the body extrapolated by one substep, so that the method stays of second order.
    """
    air = make_air(features)

    @wp.func
    def corners_of(k: int, m: Model, x: wp.uint64, v: wp.uint64) -> Corners:
        p = m.panels[k]
        corners = Corners()
        corners.a = xyz(load4(x, p[0]))
        corners.b = xyz(load4(x, p[1]))
        corners.va = xyz(load4(v, p[0]))
        corners.vb = xyz(load4(v, p[1]))
        if wp.static(features.panels == "triangles"):
            corners.c = xyz(load4(x, p[2]))
            corners.vc = xyz(load4(v, p[2]))
        return corners

    @wp.func
    def panel_forces(t: int, width: int, ctx: Context):
        x = ctx.x
        v = array_address(ctx.state.velocities, ctx.body.particles)
        if wp.static(features.order == 2):
            if ctx.step.second:
                x = array_address(ctx.state.air.ahead_positions, ctx.body.particles)
                v = array_address(ctx.state.air.ahead_velocities, ctx.body.particles)
        if wp.static(features.panels == "triangles"):
            if triangle_forces(ctx.model, ctx.state, ctx.body, ctx.frame, x, v):
                return
        for k in range(ctx.body.panels + t, ctx.body.panels_end, 2 * width):
            # Two panels at once, as memory latency dominates. The last panel may be stored twice, with equal values.
            beside = wp.min(k + width, ctx.body.panels_end - 1)
            one, two = corners_of(k, ctx.model, x, v), corners_of(beside, ctx.model, x, v)
            force, other = air(one, ctx.frame, ctx.material), air(two, ctx.frame, ctx.material)
            store_row(ctx.state.air.panel_forces, k, force)
            store_row(ctx.state.air.panel_forces, beside, other)

    return panel_forces


def make_push(features: Features):
    """Return a Warp function: the air's force [N] on particle g of the batch, and its drag rate [N s/m].

    Both are sums over the panels around the particle.
    """
    around = 6 if features.panels == "triangles" else 2  # panels around a particle within a grid, or along a rope
    Panels, Forces = wp.types.vector(around, int), wp.types.matrix((around, 4), float)

    @wp.func
    def push(g: int, m: Model, s: State) -> wp.vec4:
        total = wp.vec4(0.0)
        first, end = m.panel_start[g], m.panel_start[g + 1]
        panels = Panels()
        forces = Forces()
        for k in range(first, end, wp.static(around)):
            # Load all panels before adding any; surplus loads are added with weight 0.
            for q in range(wp.static(around)):
                panels[q] = m.particle_panels[wp.min(k + q, end - 1)]
            for q in range(wp.static(around)):
                forces[q] = load_row(s.air.panel_forces, panels[q])
            for q in range(wp.static(around)):
                total += wp.where(k + q < end, 1.0, 0.0) * forces[q]
        return total

    return push
