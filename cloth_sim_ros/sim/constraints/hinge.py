"""Dihedral bending of a cloth."""

import warp as wp

from cloth_sim_ros.sim.model import Body, Model
from cloth_sim_ros.sim.physics.bending import hinge_gradients, wrap_angle
from cloth_sim_ros.sim.physics.distance import multiplier_change
from cloth_sim_ros.sim.physics.integrate import Step
from cloth_sim_ros.sim.schedules.native import load4, store4
from cloth_sim_ros.sim.state import Material, State


@wp.func
def _at(x: wp.uint64, d: wp.uint64, i: int, origin: wp.vec4) -> wp.vec3:
    """Where a particle is, from `origin`, so that the difference of positions is exact before d is added."""
    p = load4(x, i) - origin
    q = load4(d, i)
    return wp.vec3(p[0] + q[0], p[1] + q[1], p[2] + q[2])


@wp.func
def _push(d: wp.uint64, i: int, correction: wp.vec3) -> float:
    q = load4(d, i)
    store4(d, i, q + q[3] * wp.vec4(correction[0], correction[1], correction[2], 0.0))
    return q[3]


@wp.func
def _slip(d: wp.uint64, i: int, gradient: wp.vec3) -> float:
    q = load4(d, i)
    return q[0] * gradient[0] + q[1] * gradient[1] + q[2] * gradient[2]


@wp.func
def project_hinge(
    type: int,
    k: int,
    alpha: float,
    m: Model,
    s: State,
    body: Body,
    material: Material,
    step: Step,
    x: wp.uint64,
    d: wp.uint64,
):
    t = m.tuples[k]
    rest = m.tuple_rest[k]
    origin = load4(x, t[0])
    g = hinge_gradients(
        _at(x, d, t[0], origin), _at(x, d, t[1], origin), _at(x, d, t[2], origin), _at(x, d, t[3], origin)
    )
    w = wp.vec4(load4(d, t[0])[3], load4(d, t[1])[3], load4(d, t[2])[3], load4(d, t[3])[3])
    sum = w[0] * wp.dot(g.i, g.i) + w[1] * wp.dot(g.j, g.j) + w[2] * wp.dot(g.k, g.k) + w[3] * wp.dot(g.l, g.l)
    slip = _slip(d, t[0], g.i) + _slip(d, t[1], g.j) + _slip(d, t[2], g.k) + _slip(d, t[3], g.l)
    multiplier = float(0.0)
    if not step.first:
        multiplier = s.tuple_multipliers[k][0]
    gamma = material.damping * step.inverse
    quotient = multiplier_change(wrap_angle(g.angle - rest[0]), slip, sum, alpha * rest[1], gamma, multiplier)
    change = quotient[0] / quotient[1]
    if sum <= 0.0:
        change = 0.0
    if step.store:
        s.tuple_multipliers[k] = wp.vec3(multiplier + change, 0.0, 0.0)
    _push(d, t[0], change * g.i)
    _push(d, t[1], change * g.j)
    _push(d, t[2], change * g.k)
    _push(d, t[3], change * g.l)


def make_project(order: int):
    """The projection of hinge k; its damping takes the whole displacement of the substep as its rate in both orders."""
    return project_hinge
