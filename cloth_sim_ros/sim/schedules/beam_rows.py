"""The direct solve of a rope's bending by many threads: all tell what joints and rows are, and one eliminates.

The equations are those of beam.py, where one thread does everything in one walk. What depends on the row before is
little, and lies in shared memory.
"""

import warp as wp

from cloth_sim_ros.sim.model import Body, Model
from cloth_sim_ros.sim.physics.integrate import Step
from cloth_sim_ros.sim.schedules.beam import held_at, stiffness_at, turn_at
from cloth_sim_ros.sim.schedules.native import load4, quick_quotient, store4, sync, xyz
from cloth_sim_ros.sim.state import BeamRow, Material, State

ROWS = wp.constant(3)  # vec4 a particle: two of its row, and one of the joint that it begins


@wp.func
def _weights(j: int, m: Model, body: Body) -> wp.vec3:
    """By which the particles of joint j turn it [1/m]."""
    joint = m.joints[body.segments + j]
    return wp.vec3(joint[2], -(joint[2] + joint[3]), joint[3])


@wp.struct
class Joint:
    """One joint: the weights of its particles, its stiffness, and by how much its moment is to change."""

    weights: wp.vec3
    change: wp.vec3
    stiff: float


@wp.func
def _shown(j: int, m: Model, body: Body, rows: wp.uint64) -> Joint:
    """Joint j as a thread has shown it; without stiffness where there is none."""
    joint = Joint()
    if j >= 0 and j < body.count - 2:
        shown = load4(rows, ROWS * j + 2)
        joint.weights = _weights(j, m, body)
        joint.change = xyz(shown)
        joint.stiff = shown[3]
    return joint


@wp.func
def _row_of(w: float, begun: Joint, near: Joint, far: Joint):
    """The row of a particle of inverse mass w that one joint begins with, one has in its middle and one ends with:
    its pivot so far, what couples it to the two before it, and its inertia, 0 where it is pinned; and its pull."""
    row = wp.vec4(0.0)
    pull = wp.vec3(0.0)
    if w > 0.0:
        below = near.stiff * near.weights[1] * near.weights[0] + far.stiff * far.weights[2] * far.weights[1]
        beyond = far.stiff * far.weights[2] * far.weights[0]
        diagonal = quick_quotient(1.0, w) + begun.stiff * begun.weights[0] * begun.weights[0]
        diagonal += near.stiff * near.weights[1] * near.weights[1] + far.stiff * far.weights[2] * far.weights[2]
        row = wp.vec4(diagonal, below, beyond, quick_quotient(1.0, w))
        pull = -(begun.weights[0] * begun.change + near.weights[1] * near.change + far.weights[2] * far.change)
    return row, pull


@wp.func
def _eliminate(count: int, rows: wp.uint64):
    """From the first particle to the last: L D L^T, and what it makes of the pulls.

    In a row that is pinned all is 0, and so is what couples the next two to it.
    """
    one = BeamRow()
    two = BeamRow()
    row = load4(rows, 0)
    pull = load4(rows, 1)
    for i in range(count):
        # One ahead: the next row comes while this one is reckoned.
        after = ROWS * wp.min(i + 1, count - 1)
        next_row = load4(rows, after)
        next_pull = load4(rows, after + 1)
        here = BeamRow()
        here.second = row[2] * two.inverse
        here.first = (row[1] - here.second * two.pivot * one.first) * one.inverse
        left = here.first * here.first * one.pivot + here.second * here.second * two.pivot
        here.pivot = wp.max(row[0] - left, row[3])
        here.inverse = wp.where(row[3] > 0.0, quick_quotient(1.0, wp.max(here.pivot, 1.0e-30)), 0.0)
        here.move = xyz(pull) - here.first * one.move - here.second * two.move
        move = here.inverse * here.move
        store4(rows, ROWS * i, wp.vec4(move[0], move[1], move[2], here.first))
        store4(rows, ROWS * i + 1, wp.vec4(here.second, 0.0, 0.0, 0.0))
        two = one
        one = here
        row = next_row
        pull = next_pull


@wp.func
def _substitute(count: int, rows: wp.uint64):
    """From the last particle to the first: how they move."""
    one = wp.vec3(0.0)
    two = wp.vec3(0.0)
    first = float(0.0)
    second = float(0.0)
    ahead = float(0.0)
    row = load4(rows, ROWS * (count - 1))
    coupled = load4(rows, ROWS * (count - 1) + 1)[0]
    for r in range(count):
        i = count - 1 - r
        before = ROWS * wp.max(i - 1, 0)
        next_row = load4(rows, before)
        next_coupled = load4(rows, before + 1)[0]
        move = xyz(row) - first * one - second * two
        store4(rows, ROWS * i, wp.vec4(move[0], move[1], move[2], 0.0))
        two = one
        one = move
        second = ahead
        first = row[3]
        ahead = coupled
        row = next_row
        coupled = next_coupled


def make_solve_beam(threads: int):
    """A Warp function that all of `threads` threads call together, one solve over all joints of a body: it moves the
    particles and changes the moments. `rows` is the address of ROWS vec4 a particle that the threads share.
    """

    @wp.func
    def solve_beam_together(
        t: int,
        m: Model,
        s: State,
        body: Body,
        material: Material,
        step: Step,
        x: wp.uint64,
        d: wp.uint64,
        rows: wp.uint64,
    ):
        joints = body.count - 2
        for j in range(t, joints, threads):
            square = step.effective * step.effective
            stiff = stiffness_at(j, m, body, material, step, d)
            change = stiff * turn_at(j, m, body, x, d) - square * held_at(j, m, s, body, step)
            store4(rows, ROWS * j + 2, wp.vec4(change[0], change[1], change[2], stiff))
        sync()
        for i in range(t, body.count, threads):
            begun = _shown(i, m, body, rows)
            row, pull = _row_of(load4(d, i)[3], begun, _shown(i - 1, m, body, rows), _shown(i - 2, m, body, rows))
            store4(rows, ROWS * i, row)
            store4(rows, ROWS * i + 1, wp.vec4(pull[0], pull[1], pull[2], 0.0))
        sync()
        if t == 0:
            _eliminate(body.count, rows)
            _substitute(body.count, rows)
        sync()
        for i in range(t, body.count, threads):
            move = load4(rows, ROWS * i)
            store4(d, i, load4(d, i) + wp.vec4(move[0], move[1], move[2], 0.0))
        sync()
        for j in range(t, joints, threads):
            stiff = stiffness_at(j, m, body, material, step, d)
            s.moments[body.segments + j] = (stiff * step.inverse_square) * turn_at(j, m, body, x, d)

    return solve_beam_together
