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

from cloth_sim_ros.sim.arrays.state import Material
from cloth_sim_ros.sim.features.collider_contact.particle import NOISE
from cloth_sim_ros.sim.features.grasp.hold import HELD
from cloth_sim_ros.sim.features.self_contact.arrays import ASKED
from cloth_sim_ros.sim.features.self_contact.nearest import nearest
from cloth_sim_ros.sim.features.self_contact.pairs import CLOSE, Pairs, pair_of, room_of
from cloth_sim_ros.sim.features.self_contact.surfaces import Members, Surface, number_of_body, place, surface_of
from cloth_sim_ros.sim.kernels.cooperative import CooperativeGroup, cooperative, number_of, recorded, sync_all
from cloth_sim_ros.sim.kernels.intrinsics import (
    add_exactly,
    exact_sum,
    load_row,
    next_place,
    pack,
    store_row,
    sum_of_four,
    xyz,
)
from cloth_sim_ros.sim.physics.friction import friction_correction

_PASSES = 4  # of all pairs in an iteration: each finds what the one before left of layers upon layers
_CLAIM = wp.constant(wp.float64(1 << 34))  # units of a metre in sums of claims
MOVE, HIT, CLAIM = wp.constant(0), wp.constant(3), wp.constant(6)
# Parts that are too near to one another come apart by this share of what they lack in a substep, and at most at this
# pace [m/s]. If they did at once, they would bounce, and no heap would come to rest.
_EASE, _PARTING = wp.constant(0.3), wp.constant(0.1)


@wp.struct
class Close:
    """Of pairs that may touch in this substep, their four particles in a row: each with its arrays, its inverse mass
    [1/kg] and its weight in the line between the nearest points. Of each pair that line's direction, how far it shall
    come apart [m] and how urgent that is, and static and kinetic friction.

    slips: how far they have slipped, and what they lack of being apart [m]. met: the share of what they lack by which
    they came nearer in the substep before: that is a hit, the rest is pressure. counts: (W,). some: (1,) whether there
    is one.
    """

    particles: wp.array2d(dtype=int)
    surfaces: wp.array2d(dtype=int)
    inverse: wp.array2d(dtype=float)
    weights: wp.array2d(dtype=float)
    lines: wp.array2d(dtype=wp.vec3)
    gaps: wp.array2d(dtype=wp.vec2)
    frictions: wp.array2d(dtype=wp.vec2)
    slips: wp.array2d(dtype=wp.vec4)
    met: wp.array2d(dtype=float)
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
        known = m.inside or (of_a.bodies[body_a].is_rope and of_b.bodies[body_b].is_rope)
        if known and apart >= NOISE:  # what lies in one place has no sides
            n = start / apart
            moved = float(0.0)
            for q in range(4):
                moves = load_row(members.surfaces[pair.surfaces[q]].displacements, pair.particles[q])
                moved += m.weights[q] * wp.dot(n, xyz(moves))
            kept = pairs.kept[w, k]
            if apart + moved < wp.static(CLOSE) * kept:
                lacks = kept - apart
                wanted = wp.where(lacks > 0.0, wp.min(_EASE * lacks, _PARTING * of_a.frames[0].dt), lacks)
                close.some[0] = 1
                j = next_place(close.counts, w)
                for q in range(4):
                    surface = members.surfaces[pair.surfaces[q]]
                    moves = load_row(surface.displacements, pair.particles[q])
                    held = moves[3] <= wp.static(HELD) * load_row(surface.positions, pair.particles[q])[3]
                    close.particles[w, 4 * j + q] = pair.particles[q]
                    close.surfaces[w, 4 * j + q] = pair.surfaces[q]
                    close.inverse[w, 4 * j + q] = wp.where(held, 0.0, moves[3])
                    close.weights[w, 4 * j + q] = m.weights[q]
                close.lines[w, j] = n
                # Of many that ask the same particle, those who have nearly come through are heard first.
                urgency = kept / wp.max(apart, 1.0e-3 * kept)
                close.gaps[w, j] = wp.vec2(wanted, urgency * urgency)
                close.frictions[w, j] = _friction(of_a.materials[body_a], of_b.materials[body_b])


@wp.func
def _units(lacks: float, urgency: float, weight: float) -> wp.int64:
    """How much of a particle a pair claims, in whole numbers."""
    return wp.int64(wp.float64(wp.min(lacks, 1.0) * urgency * wp.abs(weight)) * _CLAIM)


@wp.func
def _claim(members: Members, close: Close, w: int, t: int, group: CooperativeGroup, turn: int):
    """Find what close pairs lack, and sum it at each particle: that is split between them in proportion."""
    lane = t % group.sharing
    for j in range(t / group.sharing, close.counts[w], group.width / group.sharing):
        n, moved, slip, before = close.lines[w, j], wp.vec3(0.0), wp.vec3(0.0), wp.vec3(0.0)
        for k in range(4 * j + lane, 4 * j + 4, group.sharing):
            surface = members.surfaces[close.surfaces[w, k]]
            i = close.particles[w, k]
            weight = close.weights[w, k]
            d = xyz(load_row(surface.displacements, i)) + _asked(surface, i, 1 - turn, MOVE)
            moved += weight * d
            slip += weight * (d - xyz(load_row(surface.position_lo, i)))
            if surface.last_displacements.shape[0] > 0:
                before += weight * (surface.last_displacements[i] + _asked(surface, i, 1 - turn, HIT))
        lacks = wp.max(close.gaps[w, j][0] - wp.dot(n, sum_of_four(moved)), 0.0)
        slip, before = sum_of_four(slip), sum_of_four(before)
        if lane == 0:
            close.slips[w, j] = pack(slip - wp.dot(slip, n) * n, lacks)
            close.met[w, j] = wp.clamp(-wp.dot(n, before) / wp.max(lacks, NOISE), 0.0, 1.0)
        if lacks > 0.0:
            for k in range(4 * j + lane, 4 * j + 4, group.sharing):
                units = _units(lacks, close.gaps[w, j][1], close.weights[w, k])
                pair_corrections = members.surfaces[close.surfaces[w, k]].pair_corrections
                wp.atomic_add(pair_corrections, _place_of(close.particles[w, k], turn, CLAIM), units)


@wp.func
def _part(members: Members, close: Close, w: int, t: int, group: CooperativeGroup, turn: int):
    """Ask the particles of close pairs to move so that these stay apart, with friction."""
    lane = t % group.sharing
    for j in range(t / group.sharing, close.counts[w], group.width / group.sharing):
        lacks, yielding = close.slips[w, j][3], wp.vec3(0.0)
        for k in range(4 * j + lane, 4 * j + 4, group.sharing):
            weight = close.weights[w, k]
            units = _units(lacks, close.gaps[w, j][1], weight)
            if units > wp.int64(0):
                pair_corrections = members.surfaces[close.surfaces[w, k]].pair_corrections
                claims = pair_corrections[_place_of(close.particles[w, k], turn, CLAIM)]
                yielding[0] += weight * weight * close.inverse[w, k] * float(wp.float64(claims) / wp.float64(units))
        yielding = sum_of_four(yielding)
        if yielding[0] > 0.0:
            move, friction, met = lacks * close.lines[w, j], close.frictions[w, j], close.met[w, j]
            move += friction_correction(xyz(close.slips[w, j]), wp.vec3(0.0), lacks, friction[0], friction[1])
            for k in range(4 * j + lane, 4 * j + 4, group.sharing):
                pair_corrections = members.surfaces[close.surfaces[w, k]].pair_corrections
                place = _place_of(close.particles[w, k], turn, MOVE)
                moves = (close.weights[w, k] * close.inverse[w, k] / yielding[0]) * move
                add_exactly(pair_corrections, place, moves)
                if met > 0.0:
                    add_exactly(pair_corrections, place + HIT, met * moves)


@wp.func
def _move(surface: Surface, i: int, turn: int):
    """Move a particle as its pairs asked in a turn."""
    if surface.pair_corrections[_place_of(i, turn, CLAIM)] == wp.int64(0):
        return
    move, hit = _asked(surface, i, turn, MOVE), _asked(surface, i, turn, HIT)
    for k in range(wp.static(ASKED // 2)):
        surface.pair_corrections[_place_of(i, turn, k)] = wp.int64(0)
    packed = load_row(surface.displacements, i)
    store_row(surface.displacements, i, pack(xyz(packed) + move, packed[3]))
    if surface.last_displacements.shape[0] > 0:
        # A hit changes the velocity at once. As if it had moved like that before, BDF2 carries just that on.
        surface.last_displacements[i] = surface.last_displacements[i] + hit
        v = load_row(surface.velocities, i)
        store_row(surface.velocities, i, v + pack(hit / surface.frames[0].dt, 0.0))


@wp.func
def _place_of(i: int, turn: int, k: int) -> int:
    """Where number k of a turn of particle i is among all that is asked."""
    return wp.static(ASKED) * i + wp.static(ASKED // 2) * turn + k


@wp.func
def _asked(surface: Surface, i: int, turn: int, k: int) -> wp.vec3:
    """A sum of moves [m], MOVE or HIT."""
    return exact_sum(surface.pair_corrections, _place_of(i, turn, k))


@wp.func
def _move_all(members: Members, w: int, t: int, width: int, turn: int):
    """Move the particles of world w as they were asked to in a turn; thread t of `width`."""
    for b in range(members.batches):
        surface = surface_of(members, b, w)
        for i in range(t, surface.positions.shape[0], width):
            _move(surface, i, turn)


@cooperative
def _keep_apart(members: Members, pairs: Pairs, close: Close, passes: int, group: CooperativeGroup):
    """Keep the pairs of all worlds apart, from where particles would go now."""
    if pairs.folded[0] == 0:
        return
    number = number_of(wp.tid(), group)
    team = number / group.width
    t = number - team * group.width
    for w in range(team, members.worlds, group.teams):
        _look(members, pairs, close, w, t, group.width)
    sync_all(group)
    if close.some[0] == 0:
        return
    for p in range(passes):
        # What was asked in the pass before is done while the next is asked for, so that nobody waits for it.
        turn = p % 2
        for w in range(team, members.worlds, group.teams):
            _claim(members, close, w, t, group, turn)
        sync_all(group)
        for w in range(team, members.worlds, group.teams):
            _part(members, close, w, t, group, turn)
            _move_all(members, w, t, group.width, 1 - turn)
        sync_all(group)
    for w in range(team, members.worlds, group.teams):
        _move_all(members, w, t, group.width, (passes - 1) % 2)
        if t == 0:
            close.counts[w] = 0
            close.some[0] = 0


class ContactSolve:
    """The launch that keeps the pairs of a search apart."""

    def __init__(self, members: Members, pairs: Pairs, group: CooperativeGroup, device: wp.Device) -> None:
        worlds, room = pairs.parts.shape
        self._close = Close()
        for name in ("particles", "surfaces", "inverse", "weights"):
            dtype = int if name in ("particles", "surfaces") else float
            setattr(self._close, name, wp.zeros((worlds, 4 * room), dtype=dtype, device=device))
        for name, dtype in (("lines", wp.vec3), ("gaps", wp.vec2), ("frictions", wp.vec2), ("slips", wp.vec4)):
            setattr(self._close, name, wp.zeros((worlds, room), dtype=dtype, device=device))
        self._close.met = wp.zeros((worlds, room), dtype=float, device=device)
        self._close.counts = wp.zeros(worlds, dtype=int, device=device)
        self._close.some = wp.zeros(1, dtype=int, device=device)
        self._launch = recorded(_keep_apart, members, pairs, self._close, _PASSES, group=group, device=device)

    def launch(self) -> None:
        self._launch.launch()
