"""Bending of a rope: the turn between neighbouring segments, as one constraint of three components."""

import warp as wp

from cloth_sim_ros.sim.model import Body, Model
from cloth_sim_ros.sim.physics.bending import turn_residual
from cloth_sim_ros.sim.physics.integrate import Step
from cloth_sim_ros.sim.schedules.native import load4, store4
from cloth_sim_ros.sim.state import Material, State


@wp.func
def project_bend(
    type: int,
    k: int,
    alpha: float,
    m: Model,
    s: State,
    body: Body,
    material: Material,
    step: Step,
    x: wp.uint64,
    low: wp.uint64,
    d: wp.uint64,
):
    t = m.tuples[k]
    rest = m.tuple_rest[k]
    di = load4(d, t[0])
    dj = load4(d, t[1])
    dk = load4(d, t[2])
    first = (load4(x, t[1]) - load4(x, t[0])) + (dj - di)
    last = (load4(x, t[2]) - load4(x, t[1])) + (dk - dj)
    turn4 = last * rest[3] - first * rest[2]
    turn = wp.vec3(turn4[0], turn4[1], turn4[2])
    middle = rest[2] + rest[3]
    w = di[3] * rest[2] * rest[2] + dj[3] * middle * middle + dk[3] * rest[3] * rest[3]
    multiplier = wp.vec3(0.0)
    if not step.first:
        multiplier = s.tuple_multipliers[k]
    stiffness = alpha * rest[1]
    divisor = w + stiffness
    if divisor > 0.0:
        change = -(turn_residual(turn, rest[0]) + stiffness * multiplier) / divisor
        if step.store:
            s.tuple_multipliers[k] = multiplier + change
        c = wp.vec4(change[0], change[1], change[2], 0.0)
        store4(d, t[0], di + di[3] * rest[2] * c)
        store4(d, t[1], dj - dj[3] * middle * c)
        store4(d, t[2], dk + dk[3] * rest[3] * c)


def make_project(order: int):
    """The projection of bend k; a rope's dashpots act along its segments, not in bending."""
    return project_bend
