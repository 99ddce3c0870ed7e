# SPDX-License-Identifier: Apache-2.0
"""What keeps objects apart: corners against triangles, and edges against edges.

search.py lists the pairs that may meet. In each substep the nearest points of two parts, where they were when it began,
tell from which side they come: along the line between them the two stay apart by both thicknesses. A part that would
come through within a substep is put back on its side, as the line does not turn.

Each pair finds by itself what it asks of its particles, and each particle then does it. A particle of several pairs is
split between them (mass splitting, Tonge et al. 2012), so that all together do not ask too much and momentum is kept.
What is asked is summed in whole numbers, so that the order of pairs decides no bit.
"""

import warp as wp

from cloth_sim_ros.sim.intrinsics import load_row, next_place, store_row, xyz
from cloth_sim_ros.sim.meeting.cooperative import Crew, cooperative, number_of, recorded, sync_all
from cloth_sim_ros.sim.meeting.nearest import nearest
from cloth_sim_ros.sim.meeting.pairs import CLOSE, Pair, Pairs, pair_of, room_of
from cloth_sim_ros.sim.meeting.surfaces import Members, Surface, number_of_body, place, surface_of
from cloth_sim_ros.sim.physics.friction import friction_correction
from cloth_sim_ros.sim.stages.contact import NOISE
from cloth_sim_ros.sim.stages.grasp import HELD
from cloth_sim_ros.sim.stages.motion import pack
from cloth_sim_ros.sim.state import Material

_PASSES = 4  # of all pairs in an iteration: each finds what the one before left of layers upon layers
_METRE = wp.constant(wp.float64(1 << 44))  # units of it in sums of moves
_CLAIM = wp.constant(wp.float64(1 << 34))  # the same in sums of claims
ASKED = 7  # numbers of a particle: where to move, what its pairs lack, and where to move by hits alone
_PARTING = wp.constant(0.1)  # [m/s] at which parts that are too near to one another come apart


@wp.struct
class Close:
    """Of pairs that may touch in this substep: their particles, the weights of these in the line between the nearest
    points, that line's direction, how far they are apart when it begins, how far they shall be [m], and how urgent that
    is; their static and kinetic friction. counts: (W,). some: (1,) whether there is one.
    """

    pairs: wp.array2d(dtype=Pair)
    weights: wp.array2d(dtype=wp.vec4)
    lines: wp.array2d(dtype=wp.vec3)
    gaps: wp.array2d(dtype=wp.vec3)
    frictions: wp.array2d(dtype=wp.vec2)
    counts: wp.array(dtype=int)
    some: wp.array(dtype=int)


@wp.func
def _friction(a: Material, b: Material) -> wp.vec2:
    """Static and kinetic, of two bodies."""
    static = wp.sqrt(a.static_friction * b.static_friction)
    return wp.vec2(static, wp.sqrt(a.kinetic_friction * b.kinetic_friction))


@wp.func
def _look(members: Members, pairs: Pairs, close: Close, w: int, t: int, width: int):
    """List the pairs of world w that are close; thread t of `width`, as in what follows."""
    for k in range(t, wp.min(pairs.counts[w, 1], pairs.parts.shape[1]), width):
        room = room_of(members, pairs, w, k)
        if room > 0.0:
            pairs.starts[w, k] = pairs.kept[w, k] + room
            continue
        pair = pair_of(members, pairs, w, k)
        is_corner, panels = pairs.parts[w, k][0] >= 0, pairs.panels[w, k]
        of_a, of_b = members.surfaces[pair.surfaces[0]], members.surfaces[pair.surfaces[3]]
        a, c = place(of_a, pair.particles[0]), place(of_b, pair.particles[2])
        b, d = place(of_b, pair.particles[1]), place(of_b, pair.particles[3])
        if not is_corner:
            b = place(of_a, pair.particles[1])
        m = nearest(is_corner, a, b, c, d)
        start = m.weights[0] * a + m.weights[1] * b + m.weights[2] * c + m.weights[3] * d
        apart = wp.length(start)
        pairs.starts[w, k] = apart
        body_a, body_b = number_of_body(members, panels[0]), number_of_body(members, panels[1])
        seen = m.inside or (of_a.bodies[body_a].is_rope and of_b.bodies[body_b].is_rope)
        if seen and apart >= NOISE:  # what lies in one place has no sides
            n = start / apart
            moved = float(0.0)
            for q in range(4):
                moves = load_row(members.surfaces[pair.surfaces[q]].displacements, pair.particles[q])
                moved += m.weights[q] * wp.dot(n, xyz(moves))
            kept = pairs.kept[w, k]
            if apart + moved < wp.static(CLOSE) * kept:
                # What was nearer comes apart at a pace that flings nothing.
                wanted = wp.min(kept, apart + _PARTING * of_a.frames[0].dt)
                close.some[0] = 1
                place_in_list = next_place(close.counts, w)
                close.pairs[w, place_in_list] = pair
                close.weights[w, place_in_list] = m.weights
                close.lines[w, place_in_list] = n
                # Of many that ask the same particle, those who have nearly come through are heard first.
                urgency = kept / wp.max(apart, 1.0e-3 * kept)
                close.gaps[w, place_in_list] = wp.vec3(apart, wanted, urgency * urgency)
                close.frictions[w, place_in_list] = _friction(of_a.materials[body_a], of_b.materials[body_b])


@wp.struct
class Touch:
    """What a pair lacks of being apart [m], 0 where it is, along a direction n, and how far it has slipped [m].

    met: the share of what it lacks by which it came nearer in the substep before: that is a hit, the rest is pressure.
    """

    lacks: float
    n: wp.vec3
    slip: wp.vec3
    met: float


@wp.func
def _touch_of(members: Members, pair: Pair, weights: wp.vec4, n: wp.vec3, gap: wp.vec3) -> Touch:
    touch = Touch()
    touch.n = n
    moved, slip, before = wp.vec3(0.0), wp.vec3(0.0), wp.vec3(0.0)
    for q in range(4):
        surface = members.surfaces[pair.surfaces[q]]
        d = xyz(load_row(surface.displacements, pair.particles[q]))
        moved += weights[q] * d
        slip += weights[q] * (d - xyz(load_row(surface.low, pair.particles[q])))
        if surface.last_displacements.shape[0] > 0:
            before += weights[q] * surface.last_displacements[pair.particles[q]]
    touch.lacks = wp.max(gap[1] - gap[0] - wp.dot(n, moved), 0.0)
    touch.slip = slip - wp.dot(slip, touch.n) * touch.n
    touch.met = wp.clamp(-wp.dot(n, before) / wp.max(touch.lacks, NOISE), 0.0, 1.0)
    return touch


@wp.func
def _units(lacks: float, urgency: float, weight: float) -> wp.int64:
    """How much of a particle a pair claims, in whole numbers."""
    return wp.int64(wp.float64(wp.min(lacks, 1.0) * urgency * wp.abs(weight)) * _CLAIM)


@wp.func
def _claim(members: Members, close: Close, w: int, t: int, width: int):
    """Sum what pairs lack at each particle: it is split between them in proportion."""
    for j in range(t, close.counts[w], width):
        pair, weights = close.pairs[w, j], close.weights[w, j]
        touch = _touch_of(members, pair, weights, close.lines[w, j], close.gaps[w, j])
        if touch.lacks > 0.0:
            for q in range(4):
                asked = members.surfaces[pair.surfaces[q]].asked
                wp.atomic_add(
                    asked,
                    wp.static(ASKED) * pair.particles[q] + 3,
                    _units(touch.lacks, close.gaps[w, j][2], weights[q]),
                )


@wp.func
def _part(members: Members, close: Close, w: int, t: int, width: int):
    """Ask the particles of close pairs to move so that these stay apart, with friction."""
    for j in range(t, close.counts[w], width):
        pair, weights = close.pairs[w, j], close.weights[w, j]
        touch = _touch_of(members, pair, weights, close.lines[w, j], close.gaps[w, j])
        yielding = float(0.0)
        inverse = wp.vec4(0.0)
        for q in range(4):
            surface = members.surfaces[pair.surfaces[q]]
            units = _units(touch.lacks, close.gaps[w, j][2], weights[q])
            if units > wp.int64(0):
                inverse[q] = load_row(surface.displacements, pair.particles[q])[3]
                split = float(wp.float64(surface.asked[wp.static(ASKED) * pair.particles[q] + 3]) / wp.float64(units))
                yielding += weights[q] * weights[q] * inverse[q] * split
        if yielding > 0.0:
            friction, move = close.frictions[w, j], touch.lacks * touch.n
            move += friction_correction(touch.slip, wp.vec3(0.0), touch.lacks, friction[0], friction[1])
            for q in range(4):
                share = weights[q] * inverse[q] / yielding
                asked = members.surfaces[pair.surfaces[q]].asked
                first = wp.static(ASKED) * pair.particles[q]
                for c in range(3):
                    moves = wp.clamp(share * move[c], -1.0, 1.0)
                    wp.atomic_add(asked, first + c, wp.int64(wp.float64(moves) * _METRE))
                    if touch.met > 0.0:
                        wp.atomic_add(asked, first + 4 + c, wp.int64(wp.float64(touch.met * moves) * _METRE))


@wp.func
def _move(surface: Surface, i: int):
    """Move a particle as its pairs ask."""
    first = wp.static(ASKED) * i
    if surface.asked[first + 3] == wp.int64(0):
        return
    move, hit = _asked(surface.asked, first), _asked(surface.asked, first + 4)
    for k in range(wp.static(ASKED)):
        surface.asked[first + k] = wp.int64(0)
    packed = load_row(surface.displacements, i)
    if packed[3] <= wp.static(HELD) * load_row(surface.positions, i)[3]:
        return
    store_row(surface.displacements, i, pack(xyz(packed) + move, packed[3]))
    if surface.last_displacements.shape[0] > 0:
        # A hit changes the velocity at once. As if it had moved like that before, BDF2 carries just that on.
        surface.last_displacements[i] = surface.last_displacements[i] + hit
        v = load_row(surface.velocities, i)
        store_row(surface.velocities, i, v + pack(hit / surface.frames[0].dt, 0.0))


@wp.func
def _asked(asked: wp.array(dtype=wp.int64), first: int) -> wp.vec3:
    """A sum of moves [m]."""
    sum = wp.vec3(0.0)
    for k in range(3):
        sum[k] = float(wp.float64(asked[first + k]) / _METRE)
    return sum


@cooperative
def _keep_apart(members: Members, pairs: Pairs, close: Close, passes: int, crew: Crew):
    """Keep the pairs of all worlds apart, from where particles would go now."""
    if pairs.folded[0] == 0:
        return
    number = number_of(wp.tid(), crew)
    team = number / crew.width
    t = number - team * crew.width
    for w in range(team, members.worlds, crew.teams):
        _look(members, pairs, close, w, t, crew.width)
    sync_all(crew)
    if close.some[0] == 0:
        return
    for p in range(passes):
        for w in range(team, members.worlds, crew.teams):
            _claim(members, close, w, t, crew.width)
        sync_all(crew)
        for w in range(team, members.worlds, crew.teams):
            _part(members, close, w, t, crew.width)
        sync_all(crew)
        for w in range(team, members.worlds, crew.teams):
            for b in range(members.batches):
                surface = surface_of(members, b, w)
                for i in range(t, surface.positions.shape[0], crew.width):
                    _move(surface, i)
            if t == 0 and p == passes - 1:
                close.counts[w] = 0
                close.some[0] = 0
        sync_all(crew)


class Apart:
    """The launch that keeps the pairs of a search apart."""

    def __init__(self, members: Members, pairs: Pairs, crew: Crew, device: wp.Device) -> None:
        worlds, room = pairs.parts.shape
        self._close = Close()
        self._close.pairs = wp.zeros((worlds, room), dtype=Pair, device=device)
        self._close.weights = wp.zeros((worlds, room), dtype=wp.vec4, device=device)
        self._close.lines = wp.zeros((worlds, room), dtype=wp.vec3, device=device)
        self._close.gaps = wp.zeros((worlds, room), dtype=wp.vec3, device=device)
        self._close.frictions = wp.zeros((worlds, room), dtype=wp.vec2, device=device)
        self._close.counts = wp.zeros(worlds, dtype=int, device=device)
        self._close.some = wp.zeros(1, dtype=int, device=device)
        self._launch = recorded(_keep_apart, members, pairs, self._close, _PASSES, crew=crew, device=device)

    def launch(self) -> None:
        self._launch.launch()
