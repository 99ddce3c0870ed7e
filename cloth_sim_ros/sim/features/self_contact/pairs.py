# SPDX-License-Identifier: Apache-2.0
"""The parts of two panels that may meet: corners, triangles and edges, and the list of them."""

import warp as wp

from cloth_sim_ros.sim.features.self_contact.nearest import nearest
from cloth_sim_ros.sim.features.self_contact.surfaces import Members, Panel, Surface
from cloth_sim_ros.sim.kernels.intrinsics import next_place

TESTS = 15  # of two triangles: three corners of each against the other, and nine pairs of sides
# Of how far parts of one body are apart at rest, that they are kept apart at most. A rope then bends to a radius of 1.1
# times its own, and a sheet to 1.1 times its thickness: the chord of an arc of 2.26 radians is 0.8 of it.
OF_REST = 0.8
# Of the mean length of springs, that a particle may be off its way; and of that, from where on it is looked at again
# where a search is due anyway.
_SLACK, EAGER = 0.1, 0.5
# Numbers of Pairs.clock: substeps since all panels were looked at, and for how many their ways are straight; whether
# a search is due, and whether it is of all panels, 2 where their ways are found already; AGE when it was due; and how
# many panels were looked at again since all were.
AGE, HOLDS, DUE, WHOLE, WAS, AGAIN = (wp.constant(k) for k in range(6))
CLOSE = 1.05  # times how far they are kept apart, nearer than which other pairs may push two parts together


@wp.struct
class Way:
    """A panel, its number in its world, and its way from one search of all to the next: where corners start, how far
    they go, and where they are at rest, in rows [m]; its thickness, and how far a corner may be off its way [m]."""

    number: int
    panel: Panel
    x: wp.mat33
    moves: wp.mat33
    rest: wp.mat33
    thickness: float
    slack: float


@wp.struct
class Pairs:
    """Lists of one frame, world by world. couples: panels near one another. parts: the particles of a corner and a
    triangle or, the first as -1 - its number, of two edges. panels: of which two. counts: (W, 2) couples and pairs.

    kept, starts: how far parts are kept apart, and how far they at least were when the substep began [m].
    rooms: how much further than they are kept apart they come to be on their ways [m].

    clock: (6,) see above. ways: of all panels of all worlds. ranges: how far they go in this substep [m]. off: how far
    their corners are off their ways at most [m]. astray: whether that is so much that a search is for them. failed:
    which are torn. balls, drifts: middle and radius of the ball around a panel and all that it may meet, and how far
    that goes [m]. sums: (W, 4) of all velocities when the frame began, in whole numbers, and whether a particle is
    pinned. rounds: (64,) whether the bound had to shorten a way in each of its rounds.

    folded: (2,) whether parts of one body may meet, see flat.py, now and in the frame before. turns: (W x B,) how the
    rest shapes of bodies lie.
    """

    couples: wp.array2d(dtype=wp.vec2i)
    parts: wp.array2d(dtype=wp.vec4i)
    kept: wp.array2d(dtype=float)
    rooms: wp.array2d(dtype=float)
    starts: wp.array2d(dtype=float)
    panels: wp.array2d(dtype=wp.vec2i)
    counts: wp.array2d(dtype=int)
    clock: wp.array(dtype=int)
    ways: wp.array(dtype=Way)
    ranges: wp.array(dtype=float)
    off: wp.array(dtype=float)
    astray: wp.array(dtype=bool)
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
def is_due(pairs: Pairs, t: int) -> bool:
    """Whether a search is for what panel t of all worlds may meet."""
    return pairs.clock[WHOLE] > 0 or pairs.astray[t]


@wp.func
def time_ahead(pairs: Pairs, surface: Surface) -> float:
    """For how long ways are straight [s]."""
    return float(pairs.clock[HOLDS]) * surface.frames[0].dt


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


@wp.func
def way_of(members: Members, pairs: Pairs, surface: Surface, panel: Panel, number: int, time: float) -> Way:
    """That of a panel for a time [s]."""
    way = Way()
    way.number = number
    way.panel = panel
    a, b, c = panel.corners[0], panel.corners[1], panel.corners[2]
    way.x = wp.matrix_from_rows(surface.path_starts[a], surface.path_starts[b], surface.path_starts[c])
    way.moves = time * wp.matrix_from_rows(
        surface.path_velocities[a], surface.path_velocities[b], surface.path_velocities[c]
    )
    way.rest = wp.matrix_from_rows(surface.rest[a], surface.rest[b], surface.rest[c])
    way.thickness = surface.materials[members.bodies[panel.body][1]].thickness
    way.slack = slack(members, surface, panel.body)
    return way


@wp.func
def _share(parts: wp.vec4i) -> bool:
    """Whether two parts of one body have a particle in common."""
    if parts[0] >= 0:
        return parts[0] == parts[1] or parts[0] == parts[2] or parts[0] == parts[3]
    first = -1 - parts[0]
    return first == parts[2] or first == parts[3] or parts[1] == parts[2] or parts[1] == parts[3]


@wp.func
def _offsets(of_corner: bool, p: int, first: wp.mat33, q: int, second: wp.mat33) -> wp.mat33:
    """Rows b - a, c - a and d - a of two parts: corner a and triangle b c d, or the sides a b and c d of two panels."""
    a = first[p]
    if of_corner:
        return wp.matrix_from_rows(second[0] - a, second[1] - a, second[2] - a)
    return wp.matrix_from_rows(first[(p + 1) % 3] - a, second[q] - a, second[(q + 1) % 3] - a)


@wp.func
def _line(of_corner: bool, at: wp.mat33) -> wp.vec3:
    """From the nearest point of the second of two parts to that of the first one, of their offsets [m]."""
    w = nearest(of_corner, wp.vec3(0.0), at[0], at[1], at[2]).weights
    return w[1] * at[0] + w[2] * at[1] + w[3] * at[2]


@wp.func
def _free_along(of_corner: bool, at: wp.mat33, n: wp.vec3) -> float:
    """How far the first of two parts lies beyond the second one along n, of their offsets [m]."""
    along = at * n
    second = wp.max(along[1], along[2])
    if of_corner:
        return -wp.max(second, along[0])
    return wp.min(along[0], 0.0) - second


@wp.func
def _parted(of_corner: bool, at: wp.mat33, after: wp.mat33, reach: float) -> bool:
    """Whether the triangle's plane, or what is normal to both edges, keeps two parts apart by `reach` [m] all the time.

    Ways are straight, so it does if it does so at both ends. It takes less than to find the nearest points.
    """
    along = wp.where(of_corner, at[1] - at[0], at[0])
    n = wp.cross(along, at[2] - wp.where(of_corner, at[0], at[1]))
    if wp.dot(n, at[1]) > 0.0:
        n = -n
    least = reach * wp.length(n)
    return _free_along(of_corner, at, n) > least and _free_along(of_corner, after, n) > least


@wp.func
def list_test(pairs: Pairs, w: int, first: Way, p: int, second: Way, q: int):
    """List a pair where it may meet: corner p of one panel and another or, where q is not below 0, sides p and q."""
    a, b, of_corner = first.panel, second.panel, q < 0
    parts = wp.vec4i(a.corners[p], b.corners[0], b.corners[1], b.corners[2])
    if q >= 0:
        parts = wp.vec4i(-1 - a.corners[p], a.corners[(p + 1) % 3], b.corners[q], b.corners[(q + 1) % 3])
    if a.body == b.body and _share(parts):
        return
    kept, strays = first.thickness + second.thickness, first.slack + second.slack
    at = _offsets(of_corner, p, first.x, q, second.x)
    after = at + _offsets(of_corner, p, first.moves, q, second.moves)
    if _parted(of_corner, at, after, kept + strays):
        return
    line = _line(of_corner, at)
    apart = wp.length(line)
    free = wp.min(apart, _free_along(of_corner, after, wp.normalize(line)))
    if free - strays >= kept:
        return
    if a.body == b.body:
        rest = _line(of_corner, _offsets(of_corner, p, first.rest, q, second.rest))
        kept = wp.min(kept, wp.static(OF_REST) * wp.length(rest))
        if free - strays >= kept:
            return
    n = next_place(pairs.counts[w], 1)
    if n < pairs.parts.shape[1]:
        pairs.parts[w, n] = parts
        pairs.panels[w, n] = wp.vec2i(first.number, second.number)
        pairs.kept[w, n] = kept
        pairs.rooms[w, n] = free - wp.static(CLOSE) * kept
        pairs.starts[w, n] = 0.0


@wp.struct
class Pair:
    """Particles, and of each the arrays that it is in."""

    particles: wp.vec4i
    surfaces: wp.vec4i


@wp.func
def pair_of(members: Members, pairs: Pairs, w: int, k: int) -> Pair:
    parts, panels = pairs.parts[w, k], pairs.panels[w, k]
    a = members.panels[panels[0]][0] * members.worlds + w
    b = members.panels[panels[1]][0] * members.worlds + w
    pair = Pair()
    pair.particles = wp.vec4i(wp.where(parts[0] >= 0, parts[0], -1 - parts[0]), parts[1], parts[2], parts[3])
    pair.surfaces = wp.vec4i(a, wp.where(parts[0] >= 0, b, a), b, b)
    return pair


@wp.func
def room_of(members: Members, pairs: Pairs, w: int, k: int) -> float:
    """How much further than they are kept apart the parts of a pair are, by what is known of their panels [m]."""
    panels, first = pairs.panels[w, k], w * members.panels.shape[0]
    return pairs.rooms[w, k] - (pairs.off[first + panels[0]] + pairs.off[first + panels[1]])


@wp.func
def forget(pairs: Pairs, w: int, t: int, width: int):
    """Forget all pairs of panels that are looked at again; thread t of `width`."""
    panels = pairs.ways.shape[0] / pairs.counts.shape[0]
    for k in range(t, wp.min(pairs.counts[w, 1], pairs.parts.shape[1]), width):
        of = pairs.panels[w, k]
        if pairs.astray[w * panels + of[0]] or pairs.astray[w * panels + of[1]]:
            pairs.rooms[w, k] = 1.0e30


@wp.func
def empty(pairs: Pairs):
    """Begin a search: the couples are its own, and the list of pairs where it is of all panels."""
    for w in range(pairs.counts.shape[0]):
        pairs.counts[w, 0] = 0
        if pairs.clock[WHOLE] > 0:
            pairs.counts[w, 1] = 0
