# SPDX-License-Identifier: Apache-2.0
"""Bending of sheets: each particle sums the forces of its neighbours in the operator of topology/plate.py.

XPBD evaluates the operator at the predicted positions and moves particles by it before lines are solved. For a mode of
rate omega this is BDF2, or implicit Euler, with the stiffness omega^2 / (1 - (omega h)^2). It is stable if omega h < 1,
and exact for all but the shortest waves. A sheet stiffer than MOST allows is computed softer, and `report` says so.
"""

import warp as wp

from cloth_sim_ros.sim.arrays.context import Context
from cloth_sim_ros.sim.arrays.model import Body, Features, Model
from cloth_sim_ros.sim.arrays.state import Material
from cloth_sim_ros.sim.kernels.intrinsics import array_address, load4, store4, xyz
from cloth_sim_ros.sim.kernels.native import source
from cloth_sim_ros.sim.physics.integrate import carried
from cloth_sim_ros.sim.physics.plate import MOST_BENDING, rest_curvature

MOST = wp.constant(MOST_BENDING)  # limit of (omega h_e)^2 (1 + gamma), stiffest mode; gamma = dashpot time / h_e


@wp.func_native(source(__file__, "plate_sum"))
def plate_sum(
    i: int,
    base: int,
    width: int,
    across: int,
    along: int,
    neighbours: wp.array(dtype=int),
    weights: wp.array(dtype=float),
    a: wp.uint64,
    b: wp.uint64,
) -> wp.vec3:
    """Return sum_j w_ij (a_j - a_i + b_j - b_i) over neighbours j of particle i; a, b: addresses of rows of four."""
    ...


@wp.func
def around(i: int, m: Model, body: Body, a: wp.uint64, b: wp.uint64) -> wp.vec3:
    """Return the plate_sum of particle i of a body."""
    across, along = m.plate_strides[0], m.plate_strides[1]
    if across == 0:
        across = body.count
    if along == 0:
        along = body.plate_width
    return plate_sum(i, body.plate, body.plate_width, across, along, m.plate_neighbours, m.plate_weights, a, b)


@wp.func
def rigidity_of(material: Material, body: Body, inverse_square: float) -> float:
    """Return the rigidity [N m] that acts in a substep of 1 / sqrt(inverse_square) [s]."""
    asked = 1.0 / wp.max(material.compliance[2], 1.0e-30)
    return wp.min(asked, MOST * inverse_square / wp.max(material.largest_inverse_mass * body.plate_rate, 1.0e-30))


def make_plate_force(features: Features):
    """Return a Warp function: the force of a plate of rigidity 1 N m on particle i at positions a + b [1/m^2 x m]."""

    @wp.func
    def plate_force(i: int, ctx: Context, a: wp.uint64, b: wp.uint64) -> wp.vec3:
        force = -around(i, ctx.model, ctx.body, a, b)
        if wp.static(features.curved):
            g = ctx.body.particles + i
            for k in range(ctx.model.curve_start[g], ctx.model.curve_start[g + 1]):
                triangle = ctx.model.curve_entries[k]
                n = ctx.state.plate.curve_normals[triangle[0]]
                along = ctx.model.curve_gradients[k]
                if triangle[1] < 3:
                    along += ctx.state.plate.curve_pulls[triangle[0]][triangle[1]]
                force += along * n
        return force

    return plate_force


@wp.func
def curve_triangle(c: int, ctx: Context, a: wp.uint64, b: wp.uint64):
    """Store the normal and pulls of curved triangle c of the batch at positions a + b; its particles read them."""
    t = ctx.model.curve_corners[c]
    origin = load4(a, t[0])
    moment = wp.vec3()
    for k in range(ctx.model.curve_width):
        j = ctx.model.curve_stencil[c * ctx.model.curve_width + k]
        moment += ctx.model.curve_stencil_gradients[c * ctx.model.curve_width + k] * xyz(
            (load4(a, j) - origin) + load4(b, j)
        )
    p = xyz(load4(b, t[0]))
    q = xyz((load4(a, t[1]) - origin) + load4(b, t[1]))
    r = xyz((load4(a, t[2]) - origin) + load4(b, t[2]))
    found = rest_curvature(p, q, r, moment)
    ctx.state.plate.curve_normals[c] = found.normal
    ctx.state.plate.curve_pulls[c] = found.pull


def make_bending_force(features: Features):
    """Return a Warp function: the force of bending and its dashpots on particle i [N], for explicit methods."""
    plate_force = make_plate_force(features)

    @wp.func
    def bending_force(i: int, ctx: Context) -> wp.vec3:
        force = plate_force(i, ctx, ctx.x, ctx.position_lo)
        if ctx.material.damping > 0.0:
            v = array_address(ctx.state.velocities, ctx.body.particles)
            force -= (0.5 * ctx.material.damping) * around(i, ctx.model, ctx.body, v, v)
        return force / ctx.material.compliance[2]

    return bending_force


def make_bend(features: Features):
    """Return the stage that bends a sheet: it moves particle i from its displacement at `p` to that at `d`."""
    plate_force = make_plate_force(features)

    @wp.func
    def bend(
        i: int,
        ctx: Context,
    ):
        predicted = load4(ctx.p, i)
        rigidity = rigidity_of(ctx.material, ctx.body, ctx.step.inverse_square)
        # Limit the dashpots of bending before its rigidity.
        rate = ctx.material.largest_inverse_mass * ctx.body.plate_rate * rigidity
        room = MOST * ctx.step.inverse_square / wp.max(rate, 1.0e-30) - 1.0
        gamma = wp.clamp(ctx.material.damping * ctx.step.inverse, 0.0, wp.max(room, 0.0))
        force = plate_force(i, ctx, ctx.x, ctx.p)
        if gamma > 0.0:
            slip = around(i, ctx.model, ctx.body, ctx.p, ctx.p) - around(
                i, ctx.model, ctx.body, ctx.position_lo, ctx.position_lo
            )
            if wp.static(features.order == 2):
                if ctx.step.second:
                    base = ctx.body.plate
                    own = ctx.state.last_displacements[ctx.body.particles + i]
                    for q in range(ctx.body.plate_width):
                        k = base + q * wp.where(
                            ctx.model.plate_strides[0] == 0, ctx.body.count, ctx.model.plate_strides[0]
                        )
                        k += i * wp.where(
                            ctx.model.plate_strides[1] == 0, ctx.body.plate_width, ctx.model.plate_strides[1]
                        )
                        last = ctx.state.last_displacements[ctx.body.particles + ctx.model.plate_neighbours[k]] - own
                        slip -= 2.0 * ctx.model.plate_weights[k] * carried(last)
            force -= 0.5 * gamma * slip
        w = predicted[3]
        move = (w * rigidity / ctx.step.inverse_square) * force
        store4(ctx.d, i, wp.vec4(predicted[0] + move[0], predicted[1] + move[1], predicted[2] + move[2], w))

    return bend
