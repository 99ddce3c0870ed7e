# SPDX-License-Identifier: Apache-2.0
"""The parts of two panels that may meet: corners, triangles and edges, and the list of them."""

import warp as wp

from cloth_sim_ros.sim.meeting.nearest import nearest
from cloth_sim_ros.sim.meeting.surfaces import Members, Panel, Surface, place

TESTS = 15  # of two triangles: three corners of each against the other, and nine pairs of sides
_SLACK = 0.05  # of the mean length of springs, that a particle may be off its way
# Of how far parts of one body are apart at rest, that they are kept apart at most. A rope then bends to a radius of 1.1
# times its own, and a sheet to 1.1 times its thickness: the chord of an arc of 2.26 radians is 0.8 of it.
OF_REST = 0.8


@wp.struct
class Pairs:
    """Lists of one frame, world by world. couples: panels near one another. parts: the particles of a corner and a
    triangle or, the first as -1 - its number, of two edges. sides: the two bodies. counts: (W, 2) couples and pairs.

    kept, starts: how far parts are kept apart, and how far they were when the substep began [m].

    clock: (4,) substeps since the last search, for how many it holds, whether one is due, and how old the list before
    was. failed: which panels were torn then. balls, drifts: middle and radius of the ball around a panel and all that
    it may meet, and its mean velocity. sums: (W, 4) of all velocities when the frame began, in whole numbers, and
    whether a particle is pinned. rounds: (64,) whether the bound had to shorten a way in each of its rounds.

    folded: (2,) whether parts of one body may meet, see flat.py, now and in the frame before. turns: (W x B,) how the
    rest shapes of bodies lie.
    """

    couples: wp.array2d(dtype=wp.vec2i)
    parts: wp.array2d(dtype=wp.vec4i)
    kept: wp.array2d(dtype=float)
    starts: wp.array2d(dtype=float)
    sides: wp.array2d(dtype=wp.vec2i)
    counts: wp.array2d(dtype=int)
    clock: wp.array(dtype=int)
    failed: wp.array(dtype=bool)
    balls: wp.array(dtype=wp.vec4)
    drifts: wp.array(dtype=wp.vec3)
    sums: wp.array2d(dtype=wp.int64)
    rounds: wp.array(dtype=int)
    folded: wp.array(dtype=int)
    turns: wp.array(dtype=wp.mat33)


@wp.func
def slack(members: Members, surface: Surface, body: int) -> float:
    """How far a particle of a body may be off its way [m]."""
    return wp.static(_SLACK) * surface.bodies[members.bodies[body][1]].spacing


@wp.func
def time_ahead(pairs: Pairs, surface: Surface) -> float:
    """For how long the next list holds [s]."""
    return float(pairs.clock[1]) * surface.frames[0].dt


@wp.func
def tests_of(a: Panel, b: Panel) -> int:
    """The tests of two panels as bits: three corners of a, three of b, and three sides of b for each of a.

    Of panels that share a part, one has its tests.
    """
    tests = wp.where(b.corners[1] != b.corners[2], a.own & 7, 0)
    tests |= wp.where(a.corners[1] != a.corners[2], b.own & 7, 0) << 3
    sides = (b.own >> 3) & 7
    for side in range(3):
        tests |= wp.where((a.own >> (3 + side)) & 1 == 1, sides, 0) << (6 + 3 * side)
    return tests


@wp.struct
class Ways:
    """Where the corners of a panel are, and at which velocities they go, in rows."""

    x: wp.mat33
    v: wp.mat33


@wp.func
def ways_of(surface: Surface, panel: Panel) -> Ways:
    """Those of a panel from the last search on."""
    ways = Ways()
    for q in range(3):
        x, v = place(surface, panel.corners[q]), wp.vec3(surface.going[panel.corners[q]])
        for k in range(3):
            ways.x[q, k] = x[k]
            ways.v[q, k] = v[k]
    return ways


@wp.func
def _share(parts: wp.vec4i) -> bool:
    """Whether two parts of one body have a particle in common."""
    if parts[0] >= 0:
        return parts[0] == parts[1] or parts[0] == parts[2] or parts[0] == parts[3]
    first = -1 - parts[0]
    return first == parts[2] or first == parts[3] or parts[1] == parts[2] or parts[1] == parts[3]


@wp.func
def _gap(of_corner: bool, p: int, first: Ways, q: int, second: Ways, time: float) -> wp.vec2:
    """How far two parts are apart, and how far along the line between them after a time on their ways [m]: corner p or
    side p of the first panel, and the second panel or its side q.

    Ways are straight, so in between they are no nearer than the lesser of both.
    """
    q = wp.where(of_corner, 1, q)
    r, t = (p + 1) % 3, (q + 1) % 3
    a, v = first.x[p], first.v[p]
    b = wp.where(of_corner, second.x[0], first.x[r])
    v_b = wp.where(of_corner, second.v[0], first.v[r])
    c, d = second.x[q], second.x[t]
    w = nearest(of_corner, a, b, c, d).weights
    line = w[0] * a + w[1] * b + w[2] * c + w[3] * d
    # Where particles are then along the line, which goes from the second part, c and d, to the first.
    n = wp.normalize(line)
    at_b = wp.dot(n, b - a + time * (v_b - v))
    at_c = wp.dot(n, c - a + time * (second.v[q] - v))
    at_second = wp.max(at_c, wp.dot(n, d - a + time * (second.v[t] - v)))
    if of_corner:
        return wp.vec2(wp.length(line), -wp.max(at_second, at_b))
    return wp.vec2(wp.length(line), wp.min(at_b, 0.0) - at_second)


@wp.func
def _apart_at_rest(rest: wp.array(dtype=wp.vec3), parts: wp.vec4i) -> float:
    """How far two parts of one body are apart in its rest shape [m]."""
    first = wp.where(parts[0] >= 0, parts[0], -1 - parts[0])
    a, b = rest[first], rest[parts[1]]
    c, d = rest[parts[2]], rest[parts[3]]
    w = nearest(parts[0] >= 0, a, b, c, d).weights
    return wp.length(w[0] * a + w[1] * b + w[2] * c + w[3] * d)


@wp.func
def list_test(members: Members, pairs: Pairs, w: int, a: Panel, first: Ways, p: int, b: Panel, second: Ways, q: int):
    """List a pair where it may meet: corner p of panel a and panel b or, where q is not below 0, side p and side q."""
    parts = wp.vec4i(a.corners[p], b.corners[0], b.corners[1], b.corners[2])
    if q >= 0:
        parts = wp.vec4i(-1 - a.corners[p], a.corners[(p + 1) % 3], b.corners[q], b.corners[(q + 1) % 3])
    if a.body == b.body and _share(parts):
        return
    of_a, of_b = members.surfaces[a.surface], members.surfaces[b.surface]
    gap = _gap(q < 0, p, first, q, second, time_ahead(pairs, of_a))
    kept = of_a.materials[members.bodies[a.body][1]].thickness + of_b.materials[members.bodies[b.body][1]].thickness
    free = wp.min(gap[0], gap[1]) - slack(members, of_a, a.body) - slack(members, of_b, b.body)
    if free >= kept:
        return
    if a.body == b.body:
        kept = wp.min(kept, wp.static(OF_REST) * _apart_at_rest(of_a.rest, parts))
        if free >= kept:
            return
    n = wp.atomic_add(pairs.counts, w, 1, 1)
    if n < pairs.parts.shape[1]:
        pairs.parts[w, n] = parts
        pairs.sides[w, n] = wp.vec2i(a.body, b.body)
        pairs.kept[w, n] = kept
        pairs.starts[w, n] = gap[0]


@wp.struct
class Pair:
    """Particles, and of each the arrays that it is in."""

    particles: wp.vec4i
    surfaces: wp.vec4i


@wp.func
def pair_of(members: Members, pairs: Pairs, w: int, k: int) -> Pair:
    parts, sides = pairs.parts[w, k], pairs.sides[w, k]
    a = members.bodies[sides[0]][0] * members.worlds + w
    b = members.bodies[sides[1]][0] * members.worlds + w
    pair = Pair()
    pair.particles = wp.vec4i(wp.where(parts[0] >= 0, parts[0], -1 - parts[0]), parts[1], parts[2], parts[3])
    pair.surfaces = wp.vec4i(a, wp.where(parts[0] >= 0, b, a), b, b)
    return pair
