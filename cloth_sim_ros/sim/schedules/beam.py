"""The direct solve of a rope's bending, beside that of its stretch (see lines.py), by one thread.

At joint j between two segments the turn vector kappa = w1 (x_j+1 - x_j) - w0 (x_j - x_j-1), w the inverse lengths, is
the difference of their unit tangents; the moment there is M = EI / span (kappa - rest), the force on the particles
-G^T M with the same weights G = (w0, -(w0 + w1), w1). Moments carry over like tensions: the prediction holds their
force, and one solve finds by how much they change. It is linear, and the same for x, y and z: a scalar, symmetric,
pentadiagonal matrix m + G^T (EI / span) G, factored as L D L^T from one end to the other.

A bent rest shape is a length of kappa; rest points where kappa did before the substep. With that held fast
|kappa - rest| is nowhere less than what kappa's length lacks, and at first the same, so that a solve gives no energy to
the rope whatever the substep (majorization, Hunter and Lange 2004); where rest pointed along the prediction, it would.
What it costs is that kappa is turned against EI / span rest^2, from substep to substep anew: a stiff rope of a bent
rest shape turns as in honey. Its moments pull along the segments too, which its tension has not met yet, and are not
carried over.
"""

import warp as wp

from cloth_sim_ros.sim.model import Body, Model
from cloth_sim_ros.sim.physics.bending import rest_turn
from cloth_sim_ros.sim.physics.integrate import Step
from cloth_sim_ros.sim.schedules.native import larger, load4, quotient, store4, xyz
from cloth_sim_ros.sim.state import BeamRow, Material, State

# Beyond this many times the particles' inertia float32 could not tell the one from the other: stiffer is as stiff.
STIFFEST = wp.constant(1.0e5)


@wp.func
def stiffness_at(j: int, m: Model, body: Body, material: Material, step: Step, d: wp.uint64) -> float:
    """EI / span at joint j of the body in units of mass x m^2, as far as it can be resolved."""
    joint = m.joints[body.segments + j]
    middle = joint[2] + joint[3]
    lightest = larger(load4(d, j)[3], larger(load4(d, j + 1)[3], load4(d, j + 2)[3]))
    compliance = material.compliance[2] * joint[1] * step.inverse_square
    return quotient(1.0, larger(compliance, lightest * middle * middle / STIFFEST))


@wp.func
def turn_at(j: int, m: Model, body: Body, x: wp.uint64, d: wp.uint64) -> wp.vec3:
    """What the turn vector at joint j lacks to its rest shape, which points where it did before the substep."""
    joint = m.joints[body.segments + j]
    di = xyz(load4(d, j))
    dj = xyz(load4(d, j + 1))
    dk = xyz(load4(d, j + 2))
    before = xyz(load4(x, j + 1) - load4(x, j))
    behind = xyz(load4(x, j + 2) - load4(x, j + 1))
    first = before + (dj - di)
    last = behind + (dk - dj)
    turn = last * joint[3] - first * joint[2]
    if joint[0] > 0.0:
        turn -= rest_turn(behind * joint[3] - before * joint[2], joint[0])
    return turn


@wp.func
def held_at(j: int, m: Model, s: State, body: Body, step: Step) -> wp.vec3:
    """The moment at joint j of which the displacement already knows: none in a first solve where rest is bent."""
    if step.first and m.joints[body.segments + j][0] > 0.0:
        return wp.vec3(0.0)
    return s.moments[body.segments + j]


@wp.func
def bend_by_moments(i: int, m: Model, s: State, body: Body, step: Step, d: wp.uint64):
    """Add to the prediction of particle i what the moments of the last substep do to it."""
    p = load4(d, i)
    if p[3] == 0.0:
        return
    joints = body.count - 2
    force = wp.vec3(0.0)
    for place in range(3):
        j = i - place
        if j >= 0 and j < joints:
            joint = m.joints[body.segments + j]
            weight = wp.where(place == 0, joint[2], wp.where(place == 1, -(joint[2] + joint[3]), joint[3]))
            force -= weight * held_at(j, m, s, body, step)
    move = (step.effective * step.effective * p[3]) * force
    store4(d, i, p + wp.vec4(move[0], move[1], move[2], 0.0))


@wp.func
def solve_beam(m: Model, s: State, body: Body, material: Material, step: Step, x: wp.uint64, d: wp.uint64):
    """One solve over all joints of a body: moves its particles and changes its moments."""
    square = step.effective * step.effective
    joints = body.count - 2
    # The three joints around a particle, the one that it begins, is the middle of, and ends.
    near = wp.vec3(0.0)
    change_near = wp.vec3(0.0)
    stiff_near = float(0.0)
    far = wp.vec3(0.0)
    change_far = wp.vec3(0.0)
    stiff_far = float(0.0)
    one = BeamRow()
    two = BeamRow()
    for i in range(body.count):
        weights = wp.vec3(0.0)
        change = wp.vec3(0.0)
        stiff = float(0.0)
        if i < joints:
            joint = m.joints[body.segments + i]
            weights = wp.vec3(joint[2], -(joint[2] + joint[3]), joint[3])
            stiff = stiffness_at(i, m, body, material, step, d)
            change = stiff * turn_at(i, m, body, x, d) - square * held_at(i, m, s, body, step)
        w = load4(d, i)[3]
        row = BeamRow()
        if w > 0.0:
            below = stiff_near * near[1] * near[0] + stiff_far * far[2] * far[1]
            beyond = stiff_far * far[2] * far[0]
            diagonal = quotient(1.0, w) + stiff * weights[0] * weights[0]
            diagonal += stiff_near * near[1] * near[1] + stiff_far * far[2] * far[2]
            row.second = beyond * two.inverse
            row.first = (below - row.second * two.pivot * one.first) * one.inverse
            left = row.first * row.first * one.pivot + row.second * row.second * two.pivot
            row.pivot = larger(diagonal - left, quotient(1.0, w))
            row.inverse = quotient(1.0, row.pivot)
            pull = -(weights[0] * change + near[1] * change_near + far[2] * change_far)
            row.move = pull - row.first * one.move - row.second * two.move
        s.beam[body.particles + i] = row
        two = one
        one = row
        far = near
        change_far = change_near
        stiff_far = stiff_near
        near = weights
        change_near = change
        stiff_near = stiff
    _move_back(s, body, d)
    for j in range(joints):
        stiff = stiffness_at(j, m, body, material, step, d)
        s.moments[body.segments + j] = (stiff * step.inverse_square) * turn_at(j, m, body, x, d)


@wp.func
def _move_back(s: State, body: Body, d: wp.uint64):
    """Substitute from the last particle to the first, and move them."""
    one = wp.vec3(0.0)
    two = wp.vec3(0.0)
    first = float(0.0)
    second = float(0.0)
    ahead = float(0.0)
    for r in range(body.count):
        i = body.count - 1 - r
        row = s.beam[body.particles + i]
        move = wp.vec3(0.0)
        p = load4(d, i)
        if p[3] > 0.0:
            move = row.inverse * row.move - first * one - second * two
            store4(d, i, p + wp.vec4(move[0], move[1], move[2], 0.0))
        two = one
        one = move
        second = ahead
        first = row.first
        ahead = row.second
