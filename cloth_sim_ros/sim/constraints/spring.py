"""Distance springs: structural, shear, bending over two edges. The hottest loop of a mesh: count its operations."""

import warp as wp

from cloth_sim_ros.sim.model import Body, Model
from cloth_sim_ros.sim.physics.distance import SHORTEST, elongation, multiplier_change, opening
from cloth_sim_ros.sim.physics.integrate import Step
from cloth_sim_ros.sim.schedules.native import as_index, load4, quotient, root, store_xyz
from cloth_sim_ros.sim.state import Material, State, compliance_of


def make_project(order: int):
    """The projection of spring k, whose packed record the schedule has fetched, of colour `group`."""

    @wp.func
    def project_spring(
        spring: wp.vec4,
        k: int,
        group: wp.vec4i,
        m: Model,
        s: State,
        body: Body,
        material: Material,
        step: Step,
        x: wp.uint64,
        low: wp.uint64,
        d: wp.uint64,
    ):
        i = as_index(spring[0])
        j = as_index(spring[1])
        xi = load4(x, i)
        xj = load4(x, j)
        di = load4(d, i)
        dj = load4(d, j)
        wi = di[3]
        wj = dj[3]
        de4 = dj - di
        e4 = (xj - xi) + de4
        square = e4[0] * e4[0] + e4[1] * e4[1] + e4[2] * e4[2]
        e = wp.vec3(e4[0], e4[1], e4[2])
        if square < SHORTEST * SHORTEST:
            e = opening(k)
            square = wp.dot(e, e)
        length = root(square)
        slip = float(0.0)
        if material.damping > 0.0:
            # A dashpot must not see the rounding that displacements carry: divided by a small step it is a speed.
            g = body.particles
            moved = de4 - (load4(low, j) - load4(low, i))
            slip = elongation(e, wp.vec3(moved[0], moved[1], moved[2]))
            if wp.static(order == 2):
                if step.second:
                    carried = s.last_displacements[g + j] - s.last_displacements[g + i]
                    slip -= wp.dot(e, carried) / (3.0 * length)
        multiplier = float(0.0)
        if not step.first:
            multiplier = s.spring_multipliers[k]
        gamma = material.damping * step.inverse
        alpha = compliance_of(material, group[1]) * step.inverse_square * spring[3]
        change = multiplier_change(length - spring[2], slip, wi + wj, alpha, gamma, multiplier)
        pull = quotient(change[0], change[1] * length)  # one division for the change and the direction together
        if step.store:
            s.spring_multipliers[k] = multiplier + pull * length
        correction = pull * wp.vec4(e[0], e[1], e[2], 0.0)
        store_xyz(d, i, di - wi * correction)
        store_xyz(d, j, dj + wj * correction)

    return project_spring
