"""A substep of third order along a rope: both stages of Radau IIA, their Newton steps, and what they leave behind.

See physics/complex_chain.py for the method. As in lines.py, the tension carries over from the last substep, here as it
grew there, and each segment is solved for its force and its length at once, so that a rigid rope is nothing special.
Both stages share the tangent of the second.
"""

import warp as wp

from cloth_sim_ros.sim.model import Body, Features, Model
from cloth_sim_ros.sim.physics.chain import edge_frame
from cloth_sim_ros.sim.physics.complex_chain import (
    LAMBDA,
    MU,
    ComplexMatrix,
    ComplexVector,
    admittance_of,
    applied,
    combined,
    combined_vectors,
    compliance_beside,
    even,
    first_part,
    first_part_of,
    moved_along,
    reciprocal,
    scaled,
    sum_of,
    times,
    turn_matrix,
    turned,
)
from cloth_sim_ros.sim.physics.distance import elongation, opened
from cloth_sim_ros.sim.physics.integrate import Step, split_sum
from cloth_sim_ros.sim.schedules.air import make_accelerate
from cloth_sim_ros.sim.schedules.native import inverse_root, load4, quick_quotient, root, store4, store_row, xyz
from cloth_sim_ros.sim.schedules.segments import LARGEST_TURN, NEWTON_STEPS, SETTLED_SPEED, STIFFEST, TORN
from cloth_sim_ros.sim.schedules.stage_lanes import pass_both_ends
from cloth_sim_ros.sim.schedules.stages import Moving, pack, rate_of
from cloth_sim_ros.sim.state import Frame, Material, StagedSegment, State


def make_predict_stages(features: Features):
    """The stage that predicts how far particle i moves by both stages without the rope, under linear drag."""
    accelerate = make_accelerate(features)

    @wp.func
    def predict_stages(i: int, moving: Moving, m: Model, s: State, body: Body, frame: Frame, step: Step, d: wp.uint64):
        g = body.particles + i
        v = moving.velocity
        pushed = accelerate(g, moving.w, v, m, s, frame)
        a = xyz(pushed)
        h = step.effective
        drag = h * pushed[3]
        first = moving.low
        second = moving.low
        if moving.w > 0.0:
            # What a constant force does under drag: (1 + h rate A)^-1 c^2 / 2.
            share = (h * h) / (1.0 + drag * (2.0 / 3.0 + drag / 6.0))
            first += (h / 3.0) * v + (share * (1.0 + drag) / 18.0) * a
            second += h * v + (share * (0.5 + drag / 6.0)) * a
        s.first_targets[g] = first
        s.targets[g] = second
        s.stages[g] = pack(first, drag)
        store4(d, i, pack(second, moving.w))

    return predict_stages


@wp.func
def mass_factor(i: int, s: State, body: Body) -> wp.vec2:
    """By what the mass of particle i counts with its drag."""
    return MU + s.stages[body.particles + i][3] * LAMBDA


@wp.func
def lacking(i: int, s: State, body: Body, d: wp.uint64) -> ComplexVector:
    """How far particle i lies from where it would be without the rope, at both stages [m]."""
    g = body.particles + i
    return combined_vectors(s.first_targets[g] - xyz(s.stages[g]), s.targets[g] - xyz(load4(d, i)))


@wp.func
def prepare_stages(
    k: int,
    eased: wp.vec2,
    m: Model,
    s: State,
    body: Body,
    material: Material,
    step: Step,
    x: wp.uint64,
    low: wp.uint64,
    d: wp.uint64,
) -> StagedSegment:
    """Everything that the tangent at segment k needs and that does not depend on others; `eased` is what its dashpot
    leaves of a gap."""
    g = body.particles + k
    segment = StagedSegment()
    segment.first = s.staged[body.segments + k].first
    segment.second = s.staged[body.segments + k].second
    rest = m.segment_length[body.segments + k]
    p = load4(d, k)
    q = load4(d, k + 1)
    e = xyz(load4(x, k + 1)) - xyz(load4(x, k))
    by_first = xyz(s.stages[g + 1]) - xyz(s.stages[g])
    by_second = xyz(q) - xyz(p)
    first = opened(e + by_first, k)
    second = opened(e + by_second, k)
    first_square = wp.dot(first, first)
    second_square = wp.dot(second, second)
    length = root(second_square)
    n = inverse_root(second_square) * second
    square = step.effective * step.effective
    first_pull = segment.first * square
    second_pull = segment.second * square
    alpha = material.compliance[0] * rest * step.inverse_square
    first_gap = root(first_square) - rest - alpha * first_pull
    second_gap = length - rest - alpha * second_pull
    gamma = material.damping * step.inverse
    if gamma > 0.0:
        lost = xyz(load4(low, k + 1) - load4(low, k))
        first_slip = elongation(first, by_first - lost)
        second_slip = elongation(second, by_second - lost)
        first_gap += gamma * (1.5 * first_slip + 0.5 * second_slip)
        second_gap += gamma * (2.5 * second_slip - 4.5 * first_slip)
    segment.gap = times(eased, combined(first_gap, second_gap))
    segment.along = alpha * eased
    # As in segments.py: something has to be left to divide by, and along a rigid segment no less than rounding leaves.
    least = wp.max(1.0e-9 * wp.max(p[3], q[3]), STIFFEST * body.yielding)
    segment.along[0] = wp.max(segment.along[0], least)
    segment.across = quick_quotient(wp.max(second_pull, 0.0), wp.max(length, 1.0e-3 * rest))
    segment.reach = wp.max(length, rest)
    segment.frame = edge_frame(n)
    pulls = combined_vectors((first_pull * inverse_root(first_square)) * first, second_pull * n)
    segment.held = turned(segment.frame, pulls)
    return segment


@wp.func
def forward_stages(segment: StagedSegment, y: ComplexMatrix, q: ComplexVector, near: float, far: wp.vec2):
    """Past a segment, from the particle before it with compliance y, in the segment's frame, and free displacement q.

    near: inverse mass of that particle; far: mass of the one behind, 0 where it is pinned. Returns the segment with
    what the way back needs, and what moves the one behind, in the segment's frame.
    """
    q = sum_of(q, turned(wp.transpose(segment.frame), applied(y, segment.held)))
    admittance = ComplexMatrix()
    if near + far[0] > 0.0:
        admittance = admittance_of(y, segment.along, segment.across)
    segment.compliance = y
    segment.admittance = admittance
    segment.free = q
    pull = applied(admittance, moved_along(turned(segment.frame, q), -segment.gap))
    return segment, ComplexVector(pull.re - segment.held.re, pull.im - segment.held.im)


@wp.func
def pass_forward(
    again: bool,
    m: Model,
    s: State,
    body: Body,
    material: Material,
    step: Step,
    x: wp.uint64,
    low: wp.uint64,
    d: wp.uint64,
) -> ComplexVector:
    """From the first particle to the last, which moves by what is returned; `again` after the first Newton step."""
    gamma = material.damping * step.inverse
    eased = reciprocal(wp.vec2(1.0 + gamma * LAMBDA[0], gamma * LAMBDA[1]))
    y = ComplexMatrix()
    q = ComplexVector()
    near = load4(d, 0)[3]
    if near > 0.0:
        y = even(near * reciprocal(mass_factor(0, s, body)))
        if again:
            q = lacking(0, s, body, d)
    frame = wp.identity(n=3, dtype=float)
    for k in range(body.segments_end - body.segments):
        segment = prepare_stages(k, eased, m, s, body, material, step, x, low, d)
        if k > 0:
            y = turn_matrix(y, frame, segment.frame)
        frame = segment.frame
        w = load4(d, k + 1)[3]
        mass = wp.vec2(0.0)
        if w > 0.0:
            mass = quick_quotient(1.0, w) * mass_factor(k + 1, s, body)
        segment, pull = forward_stages(segment, y, q, near, mass)
        s.staged[body.segments + k] = segment
        y = ComplexMatrix()
        q = ComplexVector()
        if w > 0.0:
            if again:
                pull = sum_of(pull, scaled(mass, turned(frame, lacking(k + 1, s, body, d))))
            y = compliance_beside(mass, segment.admittance)
            q = turned(wp.transpose(frame), applied(y, pull))
        near = w
    return q


@wp.func
def move_stages(i: int, z: ComplexVector, s: State, body: Body, d: wp.uint64):
    """Particle i moves by z at both stages, if it is not pinned."""
    p = load4(d, i)
    if p[3] > 0.0:
        g = body.particles + i
        s.stages[g] = s.stages[g] + pack(first_part_of(z), 0.0)
        store4(d, i, p + pack(2.0 * z.re, 0.0))


@wp.func
def pass_backward(z: ComplexVector, s: State, body: Body, step: Step, d: wp.uint64) -> wp.vec2i:
    """From the last particle, which moves by z, to the first. Whether that is smooth, so that a linear solve can tell
    it, and whether no other Newton step is needed; written so that NaN is not smooth."""
    smooth = bool(True)
    settled = bool(True)
    for r in range(body.segments_end - body.segments):
        k = body.segments_end - body.segments - 1 - r
        index = body.segments + k
        segment = s.staged[index]
        apart = ComplexVector(z.re - segment.free.re, z.im - segment.free.im)
        force = applied(segment.admittance, moved_along(turned(segment.frame, apart), segment.gap))
        before = sum_of(segment.free, turned(wp.transpose(segment.frame), applied(segment.compliance, force)))
        gain = wp.vec2(force.re[0], force.im[0])
        s.staged[index].first = segment.first + first_part(gain) * step.inverse_square
        s.staged[index].second = segment.second + 2.0 * gain[0] * step.inverse_square
        change = segment.frame * (2.0 * (z.re - before.re))
        turn = quick_quotient(change[1] * change[1] + change[2] * change[2], segment.reach * segment.reach)
        smooth = smooth and turn <= LARGEST_TURN and wp.abs(change[0]) <= TORN * segment.reach
        settled = settled and 0.5 * turn * segment.reach <= SETTLED_SPEED * step.effective
        move_stages(k + 1, z, s, body, d)
        z = before
    move_stages(0, z, s, body, d)
    return wp.vec2i(wp.where(smooth, 1, 0), wp.where(settled, 1, 0))


@wp.func
def solve_stages(
    iterations: int,
    m: Model,
    s: State,
    body: Body,
    material: Material,
    step: Step,
    x: wp.uint64,
    low: wp.uint64,
    d: wp.uint64,
) -> bool:
    """So many Newton steps, and more until it is settled, from where both stages are predicted; whether the motion is
    smooth."""
    for k in range(body.segments, body.segments_end):
        s.staged[k].first = s.tensions[k] + s.tension_changes[k] / 3.0
        s.staged[k].second = s.tensions[k] + s.tension_changes[k]
    steps = int(0)
    while steps < wp.max(iterations, NEWTON_STEPS):
        found = pass_both_ends(steps > 0, m, s, body, material, step, x, low, d)
        if found[0] < 0:
            found = pass_backward(pass_forward(steps > 0, m, s, body, material, step, x, low, d), s, body, step, d)
        steps += 1
        if found[0] == 0:
            return False
        if found[1] > 0 and steps >= iterations:
            return True
    return False


@wp.func
def keep_tensions(k: int, s: State):
    """What the next substep starts from: both stages extrapolated, or one solve would be of second order alone, since
    the first stage's change of tension is taken along the second's direction."""
    first = s.staged[k].first
    second = s.staged[k].second
    s.tensions[k] = second
    s.tension_changes[k] = 1.5 * (second - first)


@wp.func
def finish_stages(i: int, s: State, body: Body, step: Step, x: wp.uint64, low_address: wp.uint64, d: wp.uint64):
    """Turn the displacements of particle i at both stages into its velocity and position."""
    g = body.particles + i
    low = xyz(load4(low_address, i))
    old = load4(x, i)
    total = xyz(load4(d, i))
    stage = s.stages[g]
    first = xyz(stage)
    drag = stage[3]
    if step.store and old[3] > 0.0:
        push = (4.0 + 2.5 * drag) * (total - s.targets[g]) - (18.0 + 4.5 * drag) * (first - s.first_targets[g])
        s.chain_forces[g] = quick_quotient(step.inverse_square, old[3]) * push
    velocity = rate_of(2.5 * (total - low) - 4.5 * (first - low), step)
    store_row(s.velocities, g, pack(velocity, 0.0))
    position = xyz(old)
    store4(low_address, i, pack(split_sum(position, total), 0.0))
    store4(x, i, pack(position + total, old[3]))
