# SPDX-License-Identifier: Apache-2.0
"""The stages of a substep besides the constraints, one function an element, made for the features of a batch.

Every executor runs: sweep and panels, then predict, then per iteration (constraints, chain, contact), then finish.
Particle indices count within the body; x, low and d are addresses of its positions, of what float32 lost of them, and
of its displacements (intrinsics.py).
"""

import warp as wp

from cloth_sim_ros.sim.arrays.context import Here
from cloth_sim_ros.sim.arrays.model import Features
from cloth_sim_ros.sim.arrays.state import Material
from cloth_sim_ros.sim.features.air.panels import make_push
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
    MOST_TURNED,
    MOST_WEIGHTS,
    Step,
    carried,
    eased_by,
    predict_displacement,
    share_of_inverse_mass,
    split_sum,
)
from cloth_sim_ros.sim.scene.forces import make_pull


@wp.func
def spring_constants(material: Material) -> wp.vec3:
    """Constants [N/m] of structural, shear and bending springs of scale 1."""
    c = material.compliance
    return wp.vec3(1.0 / wp.max(c[0], 1.0e-30), 1.0 / wp.max(c[1], 1.0e-30), 1.0 / wp.max(c[2], 1.0e-30))


@wp.func
def constant_of_spring(kind: wp.vec4, constants: wp.vec3) -> float:
    """The constant [N/m] of a spring of type `kind` (Model.spring_types)."""
    return wp.where(kind[2] == 0.0, constants[0], wp.where(kind[2] == 1.0, constants[1], constants[2])) * kind[1]


@wp.func
def force_of_spring(e: wp.vec3, rest: float, constant: float, lost: float, damping: float, apart: wp.vec3) -> wp.vec3:
    """The force [N] of the spring and dashpot along e [m] on the particle where e begins; `apart` is de/dt [m/s].

    lost: what float32 lost of the rest length, over it. It would strain all springs of a grid alike, by up to 6e-8, a
    thousandth of what its own weight does to a stiff sheet.
    """
    inverse = inverse_root(wp.max(wp.dot(e, e), SHORTEST * SHORTEST))
    pull = (1.0 - rest * inverse) - lost
    if damping > 0.0:
        pull += damping * wp.dot(e, apart) * inverse * inverse
    return (constant * pull) * e


@wp.func
def spring_force(i: int, here: Here, v: wp.vec3) -> wp.vec3:
    """The force of all springs and dashpots around particle i [N], gathered, for explicit methods."""
    xi = load4(here.x, i)
    li = load4(here.low, i)
    constants = spring_constants(here.material)
    force = wp.vec3(0.0)
    # One spring ahead: the fetch from a GPU's memory takes longer than the arithmetic of a spring.
    ahead = load_pair(here.model.incident_springs, here.body.incident_springs + i)
    for q in range(1, here.body.incident_width + 1):
        spring = ahead
        ahead = load_pair(
            here.model.incident_springs,
            here.body.incident_springs + wp.min(q, here.body.incident_width - 1) * here.body.count + i,
        )
        j = spring[0]
        kind = load4(array_address(here.model.spring_types, 0), spring[1])
        e = xyz((load4(here.x, j) - xi) + (load4(here.low, j) - li))
        apart = wp.vec3(0.0)
        if here.material.damping > 0.0:
            apart = xyz(load_row(here.state.velocities, here.body.particles + j)) - v
        force += force_of_spring(e, kind[0], constant_of_spring(kind, constants), kind[3], here.material.damping, apart)
    return force


def make_elastic_force(features: Features):
    """A Warp function: the force of springs, bending and their dashpots on particle i [N], for explicit methods."""
    bending_force = make_bending_force(features) if features.plate else None

    @wp.func
    def elastic_force(i: int, here: Here, v: wp.vec3) -> wp.vec3:
        force = spring_force(i, here, v)
        if wp.static(bending_force is not None):
            force += bending_force(i, here)
        return force

    return elastic_force


@wp.func
def first_share(step: Step) -> float:
    """Leapfrog: velocities live half a step before the positions, so the first kick is half a kick."""
    return wp.where(step.second, 1.0, 0.5)


@wp.func
def prediction(base: wp.vec3, v: wp.vec3, a: wp.vec3, eased: float, w: float, low: wp.vec3, step: Step) -> wp.vec4:
    """The predicted displacement plus the low part [m], and the effective inverse mass [1/kg], under drag."""
    displacement = predict_displacement(base, v, a, step.effective, eased)
    # The implicit drag weighs like added mass; with it the static balance of drag, weight and springs is exact.
    return pack(displacement + low, w * eased)


def make_predict(features: Features):
    """The stage that predicts the displacement of particle i and its effective inverse mass under linear drag."""
    push = make_push(features) if features.panels else None
    pull = make_pull(features.forces) if features.forces else None
    elastic_force = make_elastic_force(features) if features.method == "verlet" else None

    @wp.func
    def predict(i: int, here: Here):
        g = here.body.particles + i
        w = load4(here.x, i)[3]
        v = xyz(load_row(here.state.velocities, g))
        low = xyz(load4(here.low, i))
        base = wp.vec3(0.0)
        ahead = v
        if wp.static(features.order == 2):
            if here.step.second:
                base = carried(here.state.last_displacements[g])
                change = v - here.state.last_velocities[g]
                v += carried(change)
                ahead += change
        # Forces were taken at the velocity ahead; drag is implicit from there (Rosenbrock).
        a = here.frame.gravity - here.frame.global_damping * v
        eased = here.step.eased
        if wp.static(push is not None):
            pushed = push(g, here.model, here.state)
            a += w * (xyz(pushed) + pushed[3] * (ahead - v))
            eased = eased_by(here.frame.global_damping + w * pushed[3], here.step.effective)
        if wp.static(pull is not None):
            pulled = pull(xyz(load4(here.x, i)), ahead, 1.0 / wp.max(w, 1.0e-30), here.forces)
            a += w * (xyz(pulled) + pulled[3] * (ahead - v))
            eased = eased / (1.0 + eased * here.step.effective * w * pulled[3])
        if wp.static(elastic_force is not None):
            a = first_share(here.step) * (a + w * elastic_force(i, here, v))
        if wp.static(features.lines):
            h, least = here.step.effective, LEAST_SHARE * eased
            # Few are taut or go aside, so the roots and the quotients are found for these alone.
            taut = h * h * eased * w * here.state.tautness[g]
            if taut > MOST_TAUT * here.body.spacing:
                most = MOST_TAUT * here.body.spacing + MOST_WEIGHTS * wp.length(h * h * a)
                eased *= wp.clamp(quotient(most, taut), LEAST_SHARE, 1.0)
            aside = h * h * eased * w * load4(here.low, i)[3]
            if aside > MOST_ASIDE * here.body.spacing:
                eased *= share_of_inverse_mass(aside, base + h * v, h * h * a, here.body.spacing)
                eased = wp.max(eased, least)
            if here.step.weighs:
                store4(here.low, i, pack(low, 0.0))
                here.state.tautness[g] = 0.0
        # Chosen, not branched to, or a warp with a pinned particle would go both ways.
        moved = prediction(base, v, a, eased, w, low, here.step)
        if wp.static(features.supported):
            # A chain and its bending are solved where the collider will hold it, or they would cut its corner.
            square = here.step.effective * here.step.effective
            moved += pack(square * xyz(load_row(here.state.supports, g)), 0.0)
        store4(here.p, i, wp.where(w == 0.0, pack(low, 0.0), moved))

    return predict


# BDF2 extrapolates the last displacement. A substep may depart from it by this share of the spacing, as after a stroke
# of a collider or a stretched start. The next one is implicit Euler then, which is stable whatever came before. Hems of
# towels that swing depart by a tenth. A rope that comes from a wild start trembles on its winch beyond a twentieth.
SMOOTH_SHEET, SMOOTH_ROPE = 0.2, 0.05


@wp.func
def rate_of(change: wp.vec3, step: Step) -> wp.vec3:
    """A change over a substep [m], divided by its effective length [m/s]."""
    h = step.effective
    return wp.vec3(
        divide(change[0], h, step.inverse), divide(change[1], h, step.inverse), divide(change[2], h, step.inverse)
    )


# A substep that puts an overstretched rope together may move its particles by many segments. Of the velocity that this
# would leave, a particle gains at most this many segments a substep. Otherwise the next substep would tear it again.
MOST_SPACINGS = wp.constant(0.25)


@wp.func
def turned_by_bending(j: int, here: Here) -> float:
    """The angle [rad] by which joint j of a rope is bent away from rest, as its moment tells; 0 where there is none."""
    if j >= here.body.count - 2:
        return 0.0
    place = here.body.segments + j
    return wp.length(here.state.moments[place]) * here.material.compliance[2] * here.model.joints[place][1]


def make_finish(features: Features):
    """The stage that turns the displacement of particle i into its velocity and position."""
    smooth = SMOOTH_ROPE if features.chain else SMOOTH_SHEET

    @wp.func
    def finish(i: int, here: Here):
        g = here.body.particles + i
        low = xyz(load4(here.low, i))
        old = load4(here.x, i)
        total = xyz(load4(here.d, i))
        displacement = total - low  # 0 of what is pinned
        # Divided, not multiplied by 1/h: h x (1/h) is not 1 in float32, and that error would grow with every substep.
        velocity = rate_of(displacement, here.step)
        if wp.static(features.order == 2):
            base = wp.vec3(0.0)
            if here.step.second:
                base = carried(here.state.last_displacements[g])
            velocity = rate_of(displacement - base, here.step)
            not_smooth = (
                wp.length(displacement - here.state.last_displacements[g]) > wp.static(smooth) * here.body.spacing
            )
            if wp.static(features.supported):
                not_smooth = not_smooth or here.state.supports[g][3] > 0.0
            if wp.static(features.beam):
                not_smooth = not_smooth or turned_by_bending(i, here) > MOST_TURNED
            if not_smooth:
                here.state.events[2 * here.body.index + here.substep % 2] = here.substep + 1
            before = xyz(load_row(here.state.velocities, g))
            if wp.static(features.panels != ""):
                store_row(here.state.ahead_velocities, g, pack(velocity + (velocity - before), 0.0))
                store_row(here.state.ahead_positions, g, pack(xyz(old) + displacement + displacement, 0.0))
            here.state.last_velocities[g] = before
            here.state.last_displacements[g] = displacement
        if wp.static(features.chain):
            # A chain that was put together from afar: its particles did not move so, they were placed.
            if here.state.overstretched[here.body.index] > 0:
                kick = velocity - xyz(load_row(here.state.velocities, g))
                most = MOST_SPACINGS * here.body.spacing * here.step.inverse
                velocity -= kick * (1.0 - wp.min(1.0, most / wp.max(wp.length(kick), 1.0e-20)))
        store_row(here.state.velocities, g, pack(velocity, 0.0))
        position = xyz(old)
        pull = float(0.0)
        if wp.static(features.lines):
            pull = load4(here.low, i)[3]
        store4(here.low, i, pack(split_sum(position, total), pull))
        store4(here.x, i, pack(position + total, old[3]))

    return finish
