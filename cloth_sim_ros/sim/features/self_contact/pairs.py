# SPDX-License-Identifier: Apache-2.0
"""Pairs of parts of two panels that may touch (corners, triangles and edges), and the list of them."""

import warp as wp

from cloth_sim_ros.sim.features.self_contact.nearest import nearest
from cloth_sim_ros.sim.features.self_contact.surfaces import Members, Panel, Surface, are_sewn
from cloth_sim_ros.sim.kernels.intrinsics import next_place

TESTS = 15  # tests of two triangles: three corners of each against the other, and nine pairs of sides
# Largest distance that parts of one body are kept apart, as a fraction of their distance at rest. A rope then bends to
# a radius of 1.1 times its own, and a sheet to 1.1 times its thickness: the chord of an arc of 2.26 radians is 0.8 of
# it.
OF_REST = 0.8
# _SLACK: distance that a particle may be off its path, as a fraction of the mean spring length. EAGER: fraction of that
# slack beyond which a particle is searched again if a search is due anyway.
_SLACK, EAGER = 0.1, 0.5
# Indices into Pairs.clock. AGE: substeps since all panels were searched. HOLDS: substeps for which their paths are
# straight. DUE: 1 if a search is due. WHOLE: 1 if it is for all panels, 2 if their paths are known already. WAS: AGE
# when the search was due. AGAIN: number of panels searched again since all were.
AGE, HOLDS, DUE, WHOLE, WAS, AGAIN = (wp.constant(k) for k in range(6))
CLOSE = 1.05  # ratio to the distance kept apart, below which other pairs may push two parts together


@wp.struct
class Way:
    """A panel and its path from one search of all panels to the next.

    number: its number in its world. x, moves, rest: start, displacement and rest position of each corner, in rows [m].
    thickness, slack: its thickness, and the distance that a corner may be off its path [m].
    """

    number: int
    panel: Panel
    x: wp.mat33
    moves: wp.mat33
    rest: wp.mat33
    thickness: float
    slack: float


@wp.struct
class Pairs:
    """Lists of one frame, world by world.

    couples: two panels near one another. parts: four particles, of a corner and a triangle or of two edges; the first
    particle of two edges is stored as -1 - its number. panels: the two panels of a pair. counts: (W, 2) numbers of
    couples and pairs.

    kept: distance that parts are kept apart [m]. starts: lower bound of their distance when the substep began [m].
    rooms: margin of their distance over CLOSE times `kept`, along their paths [m].

    clock: (6,) see above. step: length of the substeps that it counts [s]. ways: paths of all panels of all worlds.
    ranges: how far panels go in this substep [m]. off: largest distance of their corners from their paths [m]. astray:
    True if a panel needs a search for that. failed: True if a panel is torn. balls, drifts: center and radius of the
    ball around a panel and all that it may touch, and the displacement of that ball [m]. sums: (W, 9) sum of all
    velocities when the frame began, in integers, and 1 if a particle is pinned; then of this substep the sum of the
    displacements of colliders below particles that have to stop, their number, and 1 + the round from which on these
    count. rounds: (64,) 1 if the clamp shortened
    a displacement in that round.

    folded: (2,) 1 if parts of one body may touch, now and in the frame before (see early_out.py). turns: (W x B,)
    rotations of the rest shapes of bodies.
    """

    couples: wp.array2d(dtype=wp.vec2i)
    parts: wp.array2d(dtype=wp.vec4i)
    kept: wp.array2d(dtype=float)
    rooms: wp.array2d(dtype=float)
    starts: wp.array2d(dtype=float)
    panels: wp.array2d(dtype=wp.vec2i)
    counts: wp.array2d(dtype=int)
    clock: wp.array(dtype=int)
    step: wp.array(dtype=float)
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
    """Return the distance that a particle of a body may be off its path [m]."""
    return wp.static(_SLACK) * surface.bodies[members.bodies[body][1]].spacing


@wp.func
def is_due(pairs: Pairs, t: int) -> bool:
    """Return True if the search covers panel t, counted through all worlds."""
    return pairs.clock[WHOLE] > 0 or pairs.astray[t]


@wp.func
def tests_of(a: Panel, b: Panel) -> int:
    """Return the tests of two panels as bits: three corners of a, three of b, and three sides of b for each of a.

    If several panels share a part, only one of them has its tests.
    """
    tests = wp.where(b.corners[1] != b.corners[2], a.own & 7, 0)
    tests |= wp.where(a.corners[1] != a.corners[2], b.own & 7, 0) << 3
    sides = (b.own >> 3) & 7
    for side in range(3):
        tests |= wp.where((a.own >> (3 + side)) & 1 == 1, sides, 0) << (6 + 3 * side)
    return tests


@wp.func
def way_of(members: Members, surface: Surface, panel: Panel, number: int, time: float) -> Way:
    """Return the path of a panel over `time` [s]."""
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
    """Return True if two parts of one body have a particle in common."""
    if parts[0] >= 0:
        return parts[0] == parts[1] or parts[0] == parts[2] or parts[0] == parts[3]
    first = -1 - parts[0]
    return first == parts[2] or first == parts[3] or parts[1] == parts[2] or parts[1] == parts[3]


@wp.func
def _are_sewn(members: Members, w: int, a: Panel, p: int, b: Panel, q: int) -> bool:
    """Return True if two parts, as in `list_test`, have particles that are sewn together."""
    sewn = bool(False)
    if members.sewn_start.shape[0] > 0:
        for k in range(wp.where(q < 0, 1, 2)):
            for j in range(wp.where(q < 0, 3, 2)):
                i = b.corners[(wp.max(q, 0) + j) % 3]
                sewn = sewn or are_sewn(members, w, a, a.corners[(p + k) % 3], b, i)
    return sewn


@wp.func
def _offsets(of_corner: bool, p: int, first: wp.mat33, q: int, second: wp.mat33) -> wp.mat33:
    """Return rows b - a, c - a, d - a of two parts: corner a and triangle b c d, or sides a b and c d of two panels."""
    a = first[p]
    if of_corner:
        return wp.matrix_from_rows(second[0] - a, second[1] - a, second[2] - a)
    return wp.matrix_from_rows(first[(p + 1) % 3] - a, second[q] - a, second[(q + 1) % 3] - a)


@wp.func
def _line(of_corner: bool, at: wp.mat33) -> wp.vec3:
    """Return the vector from the nearest point of the second part to that of the first, from their offsets [m]."""
    w = nearest(of_corner, wp.vec3(0.0), at[0], at[1], at[2]).weights
    return w[1] * at[0] + w[2] * at[1] + w[3] * at[2]


@wp.func
def _free_along(of_corner: bool, at: wp.mat33, n: wp.vec3) -> float:
    """Return how far the first part lies beyond the second along n, from their offsets [m]."""
    along = at * n
    second = wp.max(along[1], along[2])
    if of_corner:
        return -wp.max(second, along[0])
    return wp.min(along[0], 0.0) - second


@wp.func
def _parted(of_corner: bool, at: wp.mat33, after: wp.mat33, reach: float) -> bool:
    """Return True if one direction keeps two parts apart by `reach` [m] throughout.

    The direction is the triangle's normal, or the common normal of both edges. Paths are straight, so a test at both
    ends is enough. It costs less than a search for the nearest points.
    """
    along = wp.where(of_corner, at[1] - at[0], at[0])
    n = wp.cross(along, at[2] - wp.where(of_corner, at[0], at[1]))
    if wp.dot(n, at[1]) > 0.0:
        n = -n
    least = reach * wp.length(n)
    return _free_along(of_corner, at, n) > least and _free_along(of_corner, after, n) > least


@wp.func
def list_test(members: Members, pairs: Pairs, w: int, first: Way, p: int, second: Way, q: int):
    """List a pair if it may touch: corner p of one panel and the other panel or, if q >= 0, sides p and q."""
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
    if _are_sewn(members, w, a, p, b, q):
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
    """Four particles, and the index in Members.surfaces of the arrays of each."""

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
    """Return a lower bound of the margin by which a pair's distance exceeds CLOSE times `kept` [m]."""
    panels, first = pairs.panels[w, k], w * members.panels.shape[0]
    return pairs.rooms[w, k] - (pairs.off[first + panels[0]] + pairs.off[first + panels[1]])


@wp.func
def forget(pairs: Pairs, w: int, t: int, width: int):
    """Forget all pairs of panels that are searched again; thread t of `width`."""
    panels = pairs.ways.shape[0] / pairs.counts.shape[0]
    for k in range(t, wp.min(pairs.counts[w, 1], pairs.parts.shape[1]), width):
        of = pairs.panels[w, k]
        if pairs.astray[w * panels + of[0]] or pairs.astray[w * panels + of[1]]:
            pairs.rooms[w, k] = 1.0e30


@wp.func
def empty(pairs: Pairs):
    """Begin a search: clear the couples, and the pairs too if it is for all panels."""
    for w in range(pairs.counts.shape[0]):
        pairs.counts[w, 0] = 0
        if pairs.clock[WHOLE] > 0:
            pairs.counts[w, 1] = 0
