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
from cloth_sim_ros.sim.kernels.intrinsics import array_address, load4, load_row, pack, store4, store_row, xyz
from cloth_sim_ros.sim.kernels.native import source
from cloth_sim_ros.sim.physics.plate import MOST_BENDING, rest_curvature, turn_of_normal

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


@wp.func_native(source(__file__, "curve_sum"))
def curve_sum(
    begin: int,
    end: int,
    entries: wp.array(dtype=wp.vec2i),
    gradients: wp.array(dtype=float),
    normals: wp.array(dtype=wp.vec4),
    pulls: wp.array(dtype=wp.vec3),
) -> wp.vec3:
    """Return the sum of (gradient + pull) x normal over the curved triangles in these entries of a particle [1/m]."""
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
            force += curve_sum(
                ctx.model.curve_start[g],
                ctx.model.curve_start[g + 1],
                ctx.model.curve_entries,
                ctx.model.curve_gradients,
                ctx.state.plate.curve_normals,
                ctx.state.plate.curve_pulls,
            )
        return force

    return plate_force


@wp.func
def moment_of(c: int, m: Model, a: wp.uint64, b: wp.uint64) -> wp.vec3:
    """Return the moment of curved triangle c of the batch at positions a + b, see `rest_curvature`."""
    width = m.curve_width
    return plate_sum(m.curve_corners[c][0], c * width, width, 1, 0, m.curve_stencil, m.curve_stencil_gradients, a, b)


@wp.func
def curve_moment(c: int, m: Model, a: wp.uint64, b: wp.uint64, ahead: wp.uint64):
    """Return the corners of curved triangle c of the batch at positions a + b [m], and its moment at a + ahead."""
    t = m.curve_corners[c]
    origin = load4(a, t[0])
    p = xyz(load4(b, t[0]))
    q = xyz((load4(a, t[1]) - origin) + load4(b, t[1]))
    r = xyz((load4(a, t[2]) - origin) + load4(b, t[2]))
    return p, q, r, moment_of(c, m, a, ahead)


@wp.func
def rest_square(c: int, ctx: Context) -> float:
    """Return the square of the curvature at rest over curved triangle c of the batch: its moment there, along n.

    It is kept beside the normal; 0 is not known.
    """
    known = load_row(ctx.state.plate.curve_normals, c)[3]
    if known > 0.0:
        return known
    m, first, width = ctx.model, ctx.body.particles, ctx.model.curve_width
    origin, moment = m.rest[first + m.curve_stencil[c * width]], wp.vec3(0.0)
    for k in range(c * width + 1, (c + 1) * width):
        moment += m.curve_stencil_gradients[k] * (m.rest[first + m.curve_stencil[k]] - origin)
    return wp.length(moment)


def make_curve_triangle(explicit: bool):
    """Return a Warp function: store the normal and pulls of curved triangle c of the batch; its particles read them.

    Dashpots resist how the bend from rest changes, H' - n' kappa, so that a sheet that is curved at rest turns freely.
    The operator gives H'. Here the normal goes where n' takes it in the time of the dashpots, and pulls go with both.
    """

    @wp.func
    def curve_triangle(c: int, ctx: Context):
        m, t, damping = ctx.model, ctx.model.curve_corners[c], ctx.material.damping
        if wp.static(explicit):
            moved, ahead, share = ctx.position_lo, array_address(ctx.state.velocities, ctx.body.particles), damping
            p, q, r, moment = curve_moment(c, m, ctx.x, moved, moved)
            if damping > 0.0:
                moment += 0.5 * damping * moment_of(c, m, ahead, ahead)
        else:
            moved, ahead, share = ctx.d, array_address(ctx.state.plate.damped, ctx.body.particles), float(1.0)
            p, q, r, moment = curve_moment(c, m, ctx.x, moved, ahead)
        turn, square = wp.vec3(0.0), float(0.0)
        if damping > 0.0:
            to_p, to_q, to_r = xyz(load4(ahead, t[0])), xyz(load4(ahead, t[1])), xyz(load4(ahead, t[2]))
            if wp.static(not explicit):
                to_p -= xyz(load4(moved, t[0]))
                to_q -= xyz(load4(moved, t[1]))
                to_r -= xyz(load4(moved, t[2]))
            turn = share * turn_of_normal(p, q, r, to_p, to_q, to_r)
            square = rest_square(c, ctx)
            moment -= square * turn
        found = rest_curvature(p, q, r, moment)
        store_row(ctx.state.plate.curve_normals, c, pack(found.normal + turn, square))
        ctx.state.plate.curve_pulls[c] = found.pull

    return curve_triangle


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


@wp.func
def damping_of(ctx: Context, rigidity: float) -> float:
    """Return gamma, the time of the dashpots of bending over h_e; they are limited before the rigidity."""
    rate = ctx.material.largest_inverse_mass * ctx.body.plate_rate * rigidity
    room = MOST * ctx.step.inverse_square / wp.max(rate, 1.0e-30) - 1.0
    return wp.clamp(ctx.material.damping * ctx.step.inverse, 0.0, wp.max(room, 0.0))


@wp.func
def damp(i: int, ctx: Context):
    """Store d + gamma (d - base) for particle i: the operator is linear, so one sum gives bending and its dashpots."""
    g = ctx.body.particles + i
    d = load4(ctx.d, i)
    if ctx.material.damping > 0.0:
        rigidity = rigidity_of(ctx.material, ctx.body, ctx.step.inverse_square)
        d += damping_of(ctx, rigidity) * (d - load_row(ctx.state.lines.bases, g))
    store_row(ctx.state.plate.damped, g, d)


def make_bend(features: Features):
    """Return the stage that bends a sheet: it moves the displacement of particle i."""
    plate_force = make_plate_force(features)

    @wp.func
    def bend(i: int, ctx: Context):
        d = load4(ctx.d, i)
        rigidity = rigidity_of(ctx.material, ctx.body, ctx.step.inverse_square)
        force = plate_force(i, ctx, ctx.x, array_address(ctx.state.plate.damped, ctx.body.particles))
        move = (d[3] * rigidity / ctx.step.inverse_square) * force
        store4(ctx.d, i, wp.vec4(d[0] + move[0], d[1] + move[1], d[2] + move[2], d[3]))

    return bend
