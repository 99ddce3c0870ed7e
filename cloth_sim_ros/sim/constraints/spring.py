"""Distance springs: structural, shear, and bending over two edges."""

import warp as wp

from cloth_sim_ros.sim.model import Body, Model
from cloth_sim_ros.sim.physics.distance import direction, elongation, spring_multiplier
from cloth_sim_ros.sim.physics.integrate import Step
from cloth_sim_ros.sim.schedules.memory import load4, store4
from cloth_sim_ros.sim.state import Material, State


def make_project(order: int):
    """The projection of spring k for an integration order."""

    @wp.func
    def project_spring(
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
        pair = m.pairs[k]
        rest = m.pair_rest[k]
        xi = load4(x, pair[0])
        xj = load4(x, pair[1])
        di = load4(d, pair[0])
        dj = load4(d, pair[1])
        wi = di[3]
        wj = dj[3]
        de = wp.vec3(dj[0] - di[0], dj[1] - di[1], dj[2] - di[2])
        e = wp.vec3(xj[0] - xi[0], xj[1] - xi[1], xj[2] - xi[2]) + de
        n = direction(e)
        slip = elongation(e, de)
        if wp.static(order == 2):
            if step.second:
                base = s.last_displacements[body.particles + pair[1]] - s.last_displacements[body.particles + pair[0]]
                slip -= wp.dot(n, base) / 3.0
        multiplier = float(0.0)
        if not step.first:
            multiplier = s.pair_multipliers[k]
        gamma = material.damping / step.effective
        change = spring_multiplier(wp.length(e) - rest[0], slip, wi + wj, alpha * rest[1], gamma, multiplier)
        if step.store:
            s.pair_multipliers[k] = multiplier + change
        store4(d, pair[0], di - change * wi * wp.vec4(n[0], n[1], n[2], 0.0))
        store4(d, pair[1], dj + change * wj * wp.vec4(n[0], n[1], n[2], 0.0))

    return project_spring
