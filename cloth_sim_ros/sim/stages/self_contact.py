# SPDX-License-Identifier: Apache-2.0
"""Contact of an object with itself: corners against triangles, and edges against edges.

sim/pair_search.py lists the pairs that may meet in a frame. In each substep the nearest points of two parts, where they
were when it began, tell from which side they come: along the line between them the two stay apart by twice the
thickness. A part that would come through within a substep is put back on its side, as the line does not turn.

Each pair finds by itself what it asks of its particles, and each particle then does it. What is asked is summed in
whole numbers, so that the order of pairs decides no bit.
"""

import warp as wp

from cloth_sim_ros.sim.intrinsics import load4, store4, store_row, xyz
from cloth_sim_ros.sim.model import Features
from cloth_sim_ros.sim.physics.friction import friction_correction
from cloth_sim_ros.sim.stages.contact import NOISE, least_mass, length_of
from cloth_sim_ros.sim.stages.here import Here
from cloth_sim_ros.sim.stages.motion import pack

PAIRS_A_PANEL = 64  # room in the list of pairs
PASSES = 3  # of all pairs in an iteration: each finds what the one before left of layers upon layers
THREADS = 16384  # of a launch over all pairs
_WAY = wp.constant(wp.float64(1 << 58))  # units a square metre in sums of moves times their sizes
_SIZE = wp.constant(wp.float64(1 << 40))  # units a metre in sums of sizes
PARTING = wp.constant(0.1)  # [m/s] at which parts that are too near to one another come apart
_ANYWHERE = wp.constant(1.0e-6)  # of an edge: nearer to its end the corner's own test sees to it


@wp.func
def weights_at(p: wp.vec3, a: wp.vec3, b: wp.vec3, c: wp.vec3) -> wp.vec3:
    """The weights of the corners of the point of a triangle that is nearest to p (Ericson 2005, sec. 5.1.5)."""
    ab = b - a
    ac = c - a
    d1 = wp.dot(ab, p - a)
    d2 = wp.dot(ac, p - a)
    d3 = wp.dot(ab, p - b)
    d4 = wp.dot(ac, p - b)
    d5 = wp.dot(ab, p - c)
    d6 = wp.dot(ac, p - c)
    va = d3 * d6 - d5 * d4
    vb = d5 * d2 - d1 * d6
    vc = d1 * d4 - d3 * d2
    if d1 <= 0.0 and d2 <= 0.0:
        return wp.vec3(1.0, 0.0, 0.0)
    if d3 >= 0.0 and d4 <= d3:
        return wp.vec3(0.0, 1.0, 0.0)
    if d6 >= 0.0 and d5 <= d6:
        return wp.vec3(0.0, 0.0, 1.0)
    if vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        return wp.vec3(1.0 - d1 / (d1 - d3), d1 / (d1 - d3), 0.0)
    if vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        return wp.vec3(1.0 - d2 / (d2 - d6), 0.0, d2 / (d2 - d6))
    if va <= 0.0 and d4 >= d3 and d5 >= d6:
        share = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        return wp.vec3(0.0, 1.0 - share, share)
    return wp.vec3(va, vb, vc) / (va + vb + vc)


@wp.struct
class Meeting:
    """Two points that are nearest to one another: the weights of four particles in the difference of the two, and
    whether they lie inside of both parts, so that no other pair sees to them."""

    weights: wp.vec4
    inside: bool


@wp.func
def meeting_of(is_corner: bool, a: wp.vec3, b: wp.vec3, c: wp.vec3, d: wp.vec3) -> Meeting:
    """Of a corner a and a triangle b c d, or of two edges a b and c d."""
    m = Meeting()
    m.inside = True
    if is_corner:
        w = weights_at(a, b, c, d)
        m.weights = wp.vec4(1.0, -w[0], -w[1], -w[2])
    else:
        near = wp.closest_point_edge_edge(a, b, c, d, 1.0e-9)
        m.weights = wp.vec4(1.0 - near[0], near[0], near[1] - 1.0, -near[1])
        m.inside = wp.min(wp.min(near[0], 1.0 - near[0]), wp.min(near[1], 1.0 - near[1])) > _ANYWHERE
    return m


@wp.func
def place(i: int, here: Here) -> wp.vec3:
    """Where particle i was when the substep began [m]."""
    return xyz(load4(here.x, i))


@wp.func
def ask(i: int, move: wp.vec3, here: Here):
    """Ask a particle to move [m], a metre at most."""
    size = wp.float64(wp.min(wp.length(move), 1.0))
    first = 4 * (here.body.particles + i)
    for k in range(3):
        wp.atomic_add(here.state.asked, first + k, wp.int64(wp.float64(move[k]) * size * _WAY))
    wp.atomic_add(here.state.asked, first + 3, wp.int64(size * _SIZE))


@wp.func
def keep_apart(particles: wp.vec4i, weights: wp.vec4, here: Here):
    """Ask the particles of two points to move so that these stay apart, with friction."""
    start, end, slip = wp.vec3(0.0), wp.vec3(0.0), wp.vec3(0.0)
    yielding = float(0.0)
    for k in range(4):
        packed = load4(here.d, particles[k])
        d = xyz(packed)
        start += weights[k] * place(particles[k], here)
        end += weights[k] * d
        slip += weights[k] * (d - xyz(load4(here.low, particles[k])))
        yielding += weights[k] * weights[k] * packed[3]
    end += start
    apart = wp.length(start)
    if apart < NOISE or yielding == 0.0:  # what lies in one place has no sides
        return
    n = start / apart
    # What was nearer comes apart at a pace that flings nothing.
    wanted = wp.min(2.0 * here.material.thickness, apart + PARTING * here.step.effective)
    gap = wp.dot(n, end) - wanted
    if gap >= 0.0:
        return
    move = -gap * n
    along = slip - wp.dot(slip, n) * n
    friction = here.material
    move += friction_correction(along, wp.vec3(0.0), -gap, friction.static_friction, friction.kinetic_friction)
    for k in range(4):
        w = weights[k] * load4(here.d, particles[k])[3]
        if w != 0.0:
            ask(particles[k], (w / yielding) * move, here)


@wp.func
def avoid(t: int, width: int, here: Here):
    """The stage that finds what pairs ask for: thread t of `width` its share."""
    begin = wp.static(PAIRS_A_PANEL) * here.body.panels
    room = wp.static(PAIRS_A_PANEL) * (here.body.panels_end - here.body.panels)
    for k in range(t, wp.min(here.state.pair_counts[here.body.index], room), width):
        pair = here.state.pairs[begin + k]
        is_corner = pair[0] >= 0
        particles = wp.vec4i(wp.where(is_corner, pair[0], -1 - pair[0]), pair[1], pair[2], pair[3])
        a, b = place(particles[0], here), place(particles[1], here)
        c, d = place(particles[2], here), place(particles[3], here)
        m = meeting_of(is_corner, a, b, c, d)
        if m.inside or here.body.is_rope:
            keep_apart(particles, m.weights, here)


def make_come_apart(features: Features):
    """The stage that moves particle i as its pairs ask: in their mean direction, each weighed by its size."""
    least = least_mass(features)

    @wp.func
    def come_apart(i: int, here: Here):
        slot = here.body.particles + i
        total = here.state.asked[4 * slot + 3]
        if total == wp.int64(0):
            return
        sum = wp.vec3(0.0)
        for k in range(3):
            sum[k] = float(wp.float64(here.state.asked[4 * slot + k]) / _WAY / (wp.float64(total) / _SIZE))
            here.state.asked[4 * slot + k] = wp.int64(0)
        here.state.asked[4 * slot + 3] = wp.int64(0)
        packed = load4(here.d, i)
        if packed[3] <= wp.static(least) * load4(here.x, i)[3]:
            return
        d = xyz(packed) + sum
        store4(here.d, i, pack(d, packed[3]))
        if wp.static(features.order == 2):
            # A hit: of the past nothing may come back.
            moved = d - xyz(load4(here.low, i))
            if wp.dot(moved - here.state.last_displacements[slot], sum) > NOISE * wp.length(sum):
                here.state.last_displacements[slot] = moved
                store_row(here.state.velocities, slot, pack(moved / length_of(here.step), 0.0))

    return come_apart
