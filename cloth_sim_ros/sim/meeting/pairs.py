# SPDX-License-Identifier: Apache-2.0
"""The parts of two panels that may meet: corners, triangles and edges, and the list of them."""

import warp as wp

from cloth_sim_ros.sim.meeting.nearest import nearest
from cloth_sim_ros.sim.meeting.surfaces import Members, Panel, Surface, place

TESTS = 15  # of two triangles: three corners of each against the other, and nine pairs of sides
_SLACK = 0.05  # of the mean length of springs, that a particle may be off its way
# Of how far parts of one body are apart at rest, that they are kept apart at most. A rope then bends to a radius of 1.1
# times its own, and a sheet to 1.1 times its thickness: the chord of an arc of 2.26 radians is 0.8 of it.
_OF_REST = 0.8


@wp.struct
class Pairs:
    """Lists of one frame, world by world. couples: panels near one another. parts: the particles of a corner and a
    triangle or, the first as -1 - its number, of two edges. sides: the two bodies. counts: (W, 2) couples and pairs.

    kept, starts: how far parts are kept apart, and how far they were when the substep began [m].

    clock: (4,) substeps since the last search, for how many it holds, whether one is due, and how old the list before
    was. failed: which panels were torn then. balls, drifts: middle and radius of the ball around a panel and all that
    it may meet, and its mean velocity. sums: (W, 4) of all velocities at the last search, in whole numbers, and
    whether a particle is pinned. rounds: (2,) whether the bound has more to shorten, and how often it did so far.
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


@wp.func
def slack(members: Members, surface: Surface, body: int) -> float:
    """How far a particle of a body may be off its way [m]."""
    return wp.static(_SLACK) * surface.bodies[members.bodies[body][1]].spacing


@wp.func
def time_ahead(pairs: Pairs, surface: Surface) -> float:
    """For how long the next list holds [s]."""
    return float(pairs.clock[1]) * surface.frames[0].dt


@wp.func
def _parts(test: int, a: Panel, b: Panel) -> wp.vec4i:
    """The particles of a test of two panels: a corner of a and the triangle b or, with -1 - the first of them, two
    edges. The last is -1 where another couple has this test, or there is no such triangle."""
    place = test % 3
    if test < 6:
        has = (a.own >> place) & 1 == 1 and b.corners[1] != b.corners[2]
        return wp.vec4i(a.corners[place], b.corners[0], b.corners[1], wp.where(has, b.corners[2], -1))
    side = (test - 6) / 3
    has = (a.own >> (3 + side)) & 1 == 1 and (b.own >> (3 + place)) & 1 == 1
    end = wp.where(has, b.corners[(place + 1) % 3], -1)
    return wp.vec4i(-1 - a.corners[side], a.corners[(side + 1) % 3], b.corners[place], end)


@wp.func
def _share(parts: wp.vec4i) -> bool:
    """Whether two parts of one body have a particle in common."""
    if parts[0] >= 0:
        return parts[0] == parts[1] or parts[0] == parts[2] or parts[0] == parts[3]
    first = -1 - parts[0]
    return first == parts[2] or first == parts[3] or parts[1] == parts[2] or parts[1] == parts[3]


@wp.func
def _gap(of_a: Surface, of_b: Surface, parts: wp.vec4i, time: float) -> wp.vec2:
    """How far two parts are apart, and how far along the line between them after a time on their ways [m].

    Ways are straight, so in between they are no nearer than the lesser of both.
    """
    is_corner = parts[0] >= 0
    first = wp.where(is_corner, parts[0], -1 - parts[0])
    a, v = place(of_a, first), wp.vec3(of_a.going[first])
    b, v_b = place(of_b, parts[1]), wp.vec3(of_b.going[parts[1]])
    if not is_corner:
        b, v_b = place(of_a, parts[1]), wp.vec3(of_a.going[parts[1]])
    c, d = place(of_b, parts[2]), place(of_b, parts[3])
    w = nearest(is_corner, a, b, c, d).weights
    line = w[0] * a + w[1] * b + w[2] * c + w[3] * d
    # Where particles are then along the line, which goes from the second part, c and d, to the first.
    n = wp.normalize(line)
    at_b = wp.dot(n, b - a + time * (v_b - v))
    at_second = wp.max(
        wp.dot(n, c - a + time * (of_b.going[parts[2]] - v)), wp.dot(n, d - a + time * (of_b.going[parts[3]] - v))
    )
    if is_corner:
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
def list_test(members: Members, pairs: Pairs, w: int, test: int, a: Panel, b: Panel):
    """List the parts of one test of two panels where they may meet."""
    parts = _parts(test, a, b)
    if parts[3] < 0 or (a.body == b.body and _share(parts)):
        return
    of_a, of_b = members.surfaces[a.surface], members.surfaces[b.surface]
    gap = _gap(of_a, of_b, parts, time_ahead(pairs, of_a))
    kept = of_a.materials[members.bodies[a.body][1]].thickness + of_b.materials[members.bodies[b.body][1]].thickness
    free = wp.min(gap[0], gap[1]) - slack(members, of_a, a.body) - slack(members, of_b, b.body)
    if free >= kept:
        return
    if a.body == b.body:
        kept = wp.min(kept, wp.static(_OF_REST) * _apart_at_rest(of_a.rest, parts))
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
