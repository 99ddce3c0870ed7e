"""Direct solves along chains: one Newton step over all segments of a rope, by one thread (see physics/chain.py).

Positions and multipliers start from where the last substep and iteration left them: the tension carries over, so that
the first tangent already knows the geometric stiffness, and the static balance does not depend on step or iterations.
"""

import warp as wp

from cloth_sim_ros.sim.model import Body, Model
from cloth_sim_ros.sim.physics.chain import edge_frame, particle_compliance, series_admittance, turn_frame
from cloth_sim_ros.sim.physics.distance import elongation, opened
from cloth_sim_ros.sim.physics.integrate import Step
from cloth_sim_ros.sim.schedules.native import load4, store4, xyz
from cloth_sim_ros.sim.state import Material, Segment, State


@wp.func
def _missing(i: int, s: State, body: Body, step: Step, d: wp.uint64) -> wp.vec3:
    """How far particle i lies from where it would be without the chain [m].

    Whatever moved the particle since the last solve (bending, contact) counts as part of where it would be.
    """
    g = body.particles + i
    now = xyz(load4(d, i))
    if step.first:
        s.targets[g] = now
    else:
        s.targets[g] += now - s.solved[g]
    return s.targets[g] - now


def make_solve_chain(order: int):
    """A Warp function that solves the chain of a body once; to be called by one thread."""

    @wp.func
    def eliminate(
        m: Model, s: State, body: Body, material: Material, step: Step, x: wp.uint64, d: wp.uint64
    ) -> wp.vec3:
        """Forward pass; returns the displacement of the last particle."""
        p = load4(d, 0)
        y = wp.identity(n=3, dtype=float) * p[3]
        frame = wp.identity(n=3, dtype=float)
        q = _missing(0, s, body, step, d)
        gamma = material.damping * step.inverse
        square = step.effective * step.effective
        xi = load4(x, 0)
        for k in range(body.segments_end - body.segments):
            xj = load4(x, k + 1)
            pj = load4(d, k + 1)
            de = xyz(pj) - xyz(p)
            e = opened((xyz(xj) - xyz(xi)) + de, k)
            length = wp.length(e)
            n = e / length
            g0 = body.particles + k
            slip = elongation(e, de - xyz(s.low[g0 + 1] - s.low[g0]))
            if wp.static(order == 2):
                if step.second:
                    slip -= wp.dot(n, s.last_displacements[g0 + 1] - s.last_displacements[g0]) / 3.0
            index = body.segments + k
            rest = m.segment_length[index]
            alpha = material.compliance[0] * rest * step.inverse_square
            tension = s.tensions[index] * square
            gap = (length - rest + gamma * slip - alpha * tension) / (1.0 + gamma)
            w = wp.max(p[3], pj[3])
            new = edge_frame(n)
            y = turn_frame(y, frame, new)
            frame = new
            # The edge's present tension pulls its first particle; the rest of the pull is solved for.
            q += wp.transpose(frame) * (y * wp.vec3(tension, 0.0, 0.0))
            admittance = wp.mat33(0.0)
            if w > 0.0:
                # Between a rigid edge and a pinned particle nothing would be left to divide by. Much softer, a load of
                # 1e5 times the mass stretches the tangent; much stiffer, rounding across the edge reaches it.
                along = wp.max(alpha / (1.0 + gamma), 1.0e-9 * w)
                across = wp.max(tension, 0.0) / wp.max(length, 1.0e-3 * rest)
                admittance = series_admittance(y, along, across)
            store = Segment()
            store.frame = frame
            store.admittance = admittance
            store.compliance = y
            store.free = q
            store.gap = gap
            s.segments[index] = store
            pull = admittance * (frame * q - wp.vec3(gap, 0.0, 0.0)) - wp.vec3(tension, 0.0, 0.0)
            y = particle_compliance(pj[3], admittance)
            missing = _missing(k + 1, s, body, step, d)
            push = frame * missing
            if pj[3] > 0.0:
                pull += push / pj[3]
            q = wp.transpose(frame) * (y * pull)
            p = pj
            xi = xj
        return q

    @wp.func
    def substitute(s: State, body: Body, step: Step, last: wp.vec3, d: wp.uint64):
        """Backward pass: displacements and tensions."""
        u = last
        count = body.segments_end - body.segments
        square = step.effective * step.effective
        for r in range(count):
            k = count - 1 - r
            index = body.segments + k
            segment = s.segments[index]
            force = segment.admittance * (segment.frame * (u - segment.free) + wp.vec3(segment.gap, 0.0, 0.0))
            s.tensions[index] += force[0] / square
            _move(k + 1, u, s, body, d)
            u = segment.free + wp.transpose(segment.frame) * (segment.compliance * force)
        _move(0, u, s, body, d)

    @wp.func
    def solve_chain(m: Model, s: State, body: Body, material: Material, step: Step, x: wp.uint64, d: wp.uint64):
        last = eliminate(m, s, body, material, step, x, d)
        substitute(s, body, step, last, d)

    return solve_chain


@wp.func
def _move(i: int, u: wp.vec3, s: State, body: Body, d: wp.uint64):
    p = load4(d, i)
    if p[3] > 0.0:
        p = p + wp.vec4(u[0], u[1], u[2], 0.0)
        store4(d, i, p)
    s.solved[body.particles + i] = xyz(p)
