"""Dihedral bending of a cloth."""

import warp as wp

from cloth_sim_ros.sim.model import Body, Model
from cloth_sim_ros.sim.physics.bending import hinge_gradients, wrap_angle
from cloth_sim_ros.sim.physics.distance import multiplier_change
from cloth_sim_ros.sim.physics.integrate import Step, carried
from cloth_sim_ros.sim.schedules.native import load4, store4
from cloth_sim_ros.sim.state import Material, State


@wp.func
def _at(x: wp.uint64, d: wp.uint64, i: int, origin: wp.vec4) -> wp.vec3:
    """Where a particle is, from `origin`, so that the difference of positions is exact before d is added."""
    p = load4(x, i) - origin
    q = load4(d, i)
    return wp.vec3(p[0] + q[0], p[1] + q[1], p[2] + q[2])


@wp.func
def _push(d: wp.uint64, i: int, correction: wp.vec3):
    q = load4(d, i)
    store4(d, i, q + q[3] * wp.vec4(correction[0], correction[1], correction[2], 0.0))


def make_project(order: int):
    """The projection of hinge k for an integration order."""

    @wp.func
    def moved(i: int, s: State, body: Body, step: Step, low: wp.uint64, d: wp.uint64) -> wp.vec3:
        """What a dashpot takes as the motion of a particle in this substep [m]: not the carried rounding, not the
        base."""
        q = load4(d, i) - load4(low, i)
        result = wp.vec3(q[0], q[1], q[2])
        if wp.static(order == 2):
            if step.second:
                result -= carried(s.last_displacements[body.particles + i], step)
        return result

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
        low: wp.uint64,
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
        if sum <= 0.0:
            return
        slip = float(0.0)
        if material.damping > 0.0:
            slip = wp.dot(moved(t[0], s, body, step, low, d), g.i) + wp.dot(moved(t[1], s, body, step, low, d), g.j)
            slip += wp.dot(moved(t[2], s, body, step, low, d), g.k) + wp.dot(moved(t[3], s, body, step, low, d), g.l)
        multiplier = float(0.0)
        if not step.first:
            multiplier = s.tuple_multipliers[k][0]
        gamma = material.damping * step.inverse
        fraction = multiplier_change(wrap_angle(g.angle - rest[0]), slip, sum, alpha * rest[1], gamma, multiplier)
        change = fraction[0] / fraction[1]
        if step.store:
            s.tuple_multipliers[k] = wp.vec3(multiplier + change, 0.0, 0.0)
        _push(d, t[0], change * g.i)
        _push(d, t[1], change * g.j)
        _push(d, t[2], change * g.k)
        _push(d, t[3], change * g.l)

    return project_hinge
