# SPDX-License-Identifier: Apache-2.0
"""The stages of a substep besides the constraints: one function per element, made for the features of a batch.

Every executor runs sweep and panels, then predict, then (constraints, chain, contact) in each iteration, then finish.
Particle indices count within the body. x, position_lo and d are addresses (intrinsics.py) of its positions, of their
low parts that float32 lost, and of its displacements.
"""

import warp as wp

from cloth_sim_ros.sim.arrays.context import Context
from cloth_sim_ros.sim.arrays.model import Features
from cloth_sim_ros.sim.arrays.state import Material
from cloth_sim_ros.sim.features.air.panels import make_push
from cloth_sim_ros.sim.features.collider_contact.part import take_parted
from cloth_sim_ros.sim.features.plate.bending import make_bending_force
from cloth_sim_ros.sim.kernels.intrinsics import (
    array_address,
    divide,
    inverse_root,
    load4,
    load_pair,
    load_row,
    pack,
    quotient,
    store4,
    store_row,
    xyz,
)
from cloth_sim_ros.sim.physics.distance import SHORTEST
from cloth_sim_ros.sim.physics.integrate import (
    LEAST_SHARE,
    MOST_ASIDE,
    MOST_TAUT,
    MOST_WEIGHTS,
    Step,
    carried,
    eased_by,
    share_of_inverse_mass,
    split_sum,
)
from cloth_sim_ros.sim.scene.forces import make_pull


@wp.func
def spring_constants(material: Material) -> wp.vec3:
    """Return the constants [N/m] of structural, shear and bending springs of scale 1."""
    c = material.compliance
    return wp.vec3(1.0 / wp.max(c[0], 1.0e-30), 1.0 / wp.max(c[1], 1.0e-30), 1.0 / wp.max(c[2], 1.0e-30))


@wp.func
def force_of_spring(e: wp.vec3, rest: float, constant: float, lost: float, damping: float, apart: wp.vec3) -> wp.vec3:
    """Return the force [N] of the spring and dashpot along e [m] on the particle where e begins.

    apart: de/dt [m/s]. lost: the part of the rest length that float32 lost, relative to it. Without it all springs of a
    grid would be strained alike by up to 6e-8. This is a thousandth of what its own weight does to a stiff sheet.
    """
    inverse = inverse_root(wp.max(wp.dot(e, e), SHORTEST * SHORTEST))
    pull = (1.0 - rest * inverse) - lost
    if damping > 0.0:
        pull += damping * wp.dot(e, apart) * inverse * inverse
    return (constant * pull) * e


@wp.func
def spring_force(i: int, ctx: Context, v: wp.vec3) -> wp.vec3:
    """Return the force of all springs and dashpots around particle i [N], gathered, for explicit methods."""
    xi = load4(ctx.x, i)
    li = load4(ctx.position_lo, i)
    constants = spring_constants(ctx.material)
    force = wp.vec3(0.0)
    # Fetch one spring ahead: a load from a GPU's memory takes longer than the arithmetic of a spring.
    ahead = load_pair(ctx.model.incident_springs, ctx.body.incident_springs + i)
    for q in range(1, ctx.body.incident_width + 1):
        spring = ahead
        ahead = load_pair(
            ctx.model.incident_springs,
            ctx.body.incident_springs + wp.min(q, ctx.body.incident_width - 1) * ctx.body.count + i,
        )
        j = spring[0]
        kind = load4(array_address(ctx.model.spring_types, 0), spring[1])
        e = xyz((load4(ctx.x, j) - xi) + (load4(ctx.position_lo, j) - li))
        apart = wp.vec3(0.0)
        if ctx.material.damping > 0.0:
            apart = xyz(load_row(ctx.state.velocities, ctx.body.particles + j)) - v
        scale = wp.where(kind[2] == 0.0, constants[0], wp.where(kind[2] == 1.0, constants[1], constants[2]))
        force += force_of_spring(e, kind[0], scale * kind[1], kind[3], ctx.material.damping, apart)
    return force


def make_elastic_force(features: Features):
    """Return a Warp function: the force of springs, bending and dashpots on particle i [N], for explicit methods."""
    bending_force = make_bending_force(features) if features.plate else None

    @wp.func
    def elastic_force(i: int, ctx: Context, v: wp.vec3) -> wp.vec3:
        force = spring_force(i, ctx, v)
        if wp.static(bending_force is not None):
            force += bending_force(i, ctx)
        return force

    return elastic_force


@wp.func
def eased_under_lines(i: int, ctx: Context, eased: float, w: float, way: wp.vec3, a: wp.vec3) -> float:
    """Return `eased`, the share of the inverse mass w [1/kg] of particle i that acts, less what its lines take of it.

    way: displacement by its velocity [m]. a: acceleration by other forces [m/s^2].
    """
    g = ctx.body.particles + i
    square, left = ctx.step.effective * ctx.step.effective, eased
    # Few particles are taut or move sideways, so roots and quotients are computed for these alone.
    taut = square * left * w * ctx.state.lines.tautness[g]
    if taut > MOST_TAUT * ctx.body.spacing:
        most = MOST_TAUT * ctx.body.spacing + MOST_WEIGHTS * wp.length(square * a)
        left *= wp.clamp(quotient(most, taut), LEAST_SHARE, 1.0)
    lo = load4(ctx.position_lo, i)
    aside = square * left * w * lo[3]
    if aside > MOST_ASIDE * ctx.body.spacing:
        left *= share_of_inverse_mass(aside, way, square * a, ctx.body.spacing)
        left = wp.max(left, LEAST_SHARE * eased)
    if ctx.step.weighs:
        store4(ctx.position_lo, i, pack(xyz(lo), 0.0))
        ctx.state.lines.tautness[g] = 0.0
    return left


def make_predict(features: Features):
    """Return the stage that predicts the displacement and effective inverse mass of particle i under linear drag."""
    push = make_push(features) if features.panels else None
    pull = make_pull(features.forces) if features.forces else None
    elastic_force = make_elastic_force(features) if features.method == "verlet" else None

    @wp.func
    def predict(i: int, ctx: Context):
        g = ctx.body.particles + i
        w = load4(ctx.x, i)[3]
        v = xyz(load_row(ctx.state.velocities, g))
        lo = xyz(load4(ctx.position_lo, i))
        base = wp.vec3(0.0)
        ahead = v
        if wp.static(features.order == 2):
            if ctx.step.second:
                base = carried(ctx.state.last_displacements[g])
                change = v - ctx.state.last_velocities[g]
                v += carried(change)
                ahead += change
        # Forces were taken at the velocity ahead; drag is implicit from there (Rosenbrock).
        a = ctx.frame.gravity - ctx.frame.global_damping * v
        eased = ctx.step.eased
        if wp.static(push is not None):
            pushed = push(g, ctx.model, ctx.state)
            a += w * (xyz(pushed) + pushed[3] * (ahead - v))
            eased = eased_by(ctx.frame.global_damping + w * pushed[3], ctx.step.effective)
        if wp.static(pull is not None):
            pulled = pull(xyz(load4(ctx.x, i)), ahead, 1.0 / wp.max(w, 1.0e-30), ctx.numbers)
            a += w * (xyz(pulled) + pulled[3] * (ahead - v))
            eased = eased / (1.0 + eased * ctx.step.effective * w * pulled[3])
        if wp.static(elastic_force is not None):
            # The first kick is half a one: in leapfrog, velocities are half a step before the positions.
            a = wp.where(ctx.step.second, 1.0, 0.5) * (a + w * elastic_force(i, ctx, v))
        if wp.static(features.lines):
            eased = eased_under_lines(i, ctx, eased, w, base + ctx.step.effective * v, a)
        # Linearly implicit in the drag (Rosenbrock-Euler), so that it never reverses the relative velocity. Such drag
        # acts like added mass; with it the static balance of drag, weight and springs is exact.
        h = ctx.step.effective
        moved = pack(base + h * (v + (h * eased) * a) + lo, w * eased)
        if wp.static(features.chain):
            start = (base + ctx.step.effective * v) + lo
            ctx.state.rope.falls[g] = wp.where(w == 0.0, wp.vec3(0.0), xyz(moved) - start)
        # Select instead of branching, or a warp with a pinned particle would run both branches.
        store4(ctx.d, i, wp.where(w == 0.0, pack(lo, 0.0), moved))
        if wp.static(features.lines):
            store_row(ctx.state.lines.bases, g, pack(lo + base, 0.0))

    return predict


# Largest departure of a substep from the last displacement, as a fraction of the spacing. A stroke of a collider or a
# stretched start exceeds it. The next substep is then implicit Euler, which is stable after any past, instead of BDF2.
# Hems of swinging towels depart by a tenth. A rope after a wild start trembles on its winch beyond a twentieth.
SMOOTH_SHEET, SMOOTH_ROPE = 0.2, 0.05


@wp.func
def rate_of(change: wp.vec3, step: Step) -> wp.vec3:
    """Return a change over a substep [m], divided by its effective length [m/s]."""
    h = step.effective
    return wp.vec3(
        divide(change[0], h, step.inverse), divide(change[1], h, step.inverse), divide(change[2], h, step.inverse)
    )


# Largest gain of velocity, in segments a substep, if an overstretched rope is put together. This may move particles by
# many segments, and the full velocity would tear the rope again in the next substep.
MOST_SPACINGS = wp.constant(0.25)


@wp.func
def shortest_beside(i: int, ctx: Context) -> float:
    """Return the rest length of the shorter segment beside particle i of a rope [m]."""
    first, last = ctx.body.segments, ctx.body.segments + ctx.body.count - 2
    before, behind = wp.max(first + i - 1, first), wp.min(first + i, last)
    return wp.min(ctx.model.segment_length[before], ctx.model.segment_length[behind])


def make_finish(features: Features):
    """Return the stage that turns the displacement of particle i into its velocity and position."""
    smooth = SMOOTH_ROPE if features.chain else SMOOTH_SHEET

    @wp.func
    def finish(i: int, ctx: Context):
        g = ctx.body.particles + i
        lo = xyz(load4(ctx.position_lo, i))
        old = load4(ctx.x, i)
        total = xyz(load4(ctx.d, i))
        displacement = total - lo  # 0 if pinned
        if wp.static(features.shapes != ()):
            displacement -= take_parted(i, ctx)
        # Divide, do not multiply by 1/h: h x (1/h) is not 1 in float32, and that error would grow with every substep.
        velocity = rate_of(displacement, ctx.step)
        if wp.static(features.order == 2):
            base = wp.vec3(0.0)
            if ctx.step.second:
                base = carried(ctx.state.last_displacements[g])
            velocity = rate_of(displacement - base, ctx.step)
            departure, spacing = displacement - ctx.state.last_displacements[g], float(ctx.body.spacing)
            if wp.static(features.chain):
                spacing = shortest_beside(i, ctx)
            if wp.length(departure) > wp.static(smooth) * spacing:
                ctx.state.events[2 * ctx.body.index + ctx.substep % 2] = ctx.substep + 1
            before = xyz(load_row(ctx.state.velocities, g))
            if wp.static(features.panels != ""):
                store_row(ctx.state.air.ahead_velocities, g, pack(velocity + (velocity - before), 0.0))
                store_row(ctx.state.air.ahead_positions, g, pack(xyz(old) + displacement + displacement, 0.0))
            ctx.state.last_velocities[g] = before
            ctx.state.last_displacements[g] = displacement
        if wp.static(features.chain):
            # Particles of a chain that was put together from afar were placed; their displacement is no velocity.
            if ctx.state.rope.overstretched[ctx.body.index] > 0:
                kick = velocity - xyz(load_row(ctx.state.velocities, g))
                most = MOST_SPACINGS * ctx.body.spacing * ctx.step.inverse
                velocity -= kick * (1.0 - wp.min(1.0, most / wp.max(wp.length(kick), 1.0e-20)))
        store_row(ctx.state.velocities, g, pack(velocity, 0.0))
        position = xyz(old)
        pull = float(0.0)
        if wp.static(features.lines):
            pull = load4(ctx.position_lo, i)[3]
        store4(ctx.position_lo, i, pack(split_sum(position, total), pull))
        store4(ctx.x, i, pack(position + total, old[3]))

    return finish
