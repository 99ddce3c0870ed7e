# SPDX-License-Identifier: Apache-2.0
"""Contact solve between objects: corners against triangles, and edges against edges.

search.py lists the pairs that may touch. In each substep, the nearest points of two parts at its start tell the side of
each. Along the line between them the two stay apart by both thicknesses. That line does not turn in the substep, so a
part that would pass through is put back on its side.

Each pair computes the corrections of its particles, and each particle then applies them. A particle of several pairs is
split between them (mass splitting, Tonge et al. 2012), so that together they do not overcorrect, and momentum is
conserved. Corrections are summed as integers, so the order of pairs does not change a bit of the result.
"""

import warp as wp

from cloth_sim_ros.sim.arrays.state import Material
from cloth_sim_ros.sim.features.collider_contact.sweep import NOISE
from cloth_sim_ros.sim.features.grasp.hold import HELD
from cloth_sim_ros.sim.features.self_contact.arrays import ASKED
from cloth_sim_ros.sim.features.self_contact.nearest import nearest
from cloth_sim_ros.sim.features.self_contact.pairs import CLOSE, Pairs, pair_of, room_of
from cloth_sim_ros.sim.features.self_contact.surfaces import Members, Surface, dt_of, number_of_body, place, surface_of
from cloth_sim_ros.sim.kernels.cooperative import CooperativeGroup, cooperative, number_of, recorded, sync_all
from cloth_sim_ros.sim.kernels.device import allocated
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
from cloth_sim_ros.sim.physics.friction import SLOW, friction_correction

_PASSES = 4  # passes over all pairs in an iteration; in stacked layers, each finds what the one before left over
_CLAIM = wp.constant(wp.float64(1 << 34))  # integer units per metre in sums of claims
MOVE, HIT, CLAIM = wp.constant(0), wp.constant(3), wp.constant(6)
# _EASE: fraction of the missing distance by which parts that are too near separate in a substep. _PARTING: largest
# speed of that [m/s]. If they separated at once, they would bounce, and no heap would come to rest.
_EASE, _PARTING = wp.constant(0.3), wp.constant(0.1)
_MOST_TURNED = wp.constant(0.5)  # cosine of the angle by which a line may turn in a substep, past a border


@wp.struct
class Close:
    """Pairs that may touch in this substep.

    particles, surfaces, inverse, weights: four entries a pair. They are the particle, the index of its arrays, its
    inverse mass [1/kg], and its weight in the line between the nearest points. lines: direction of that line. turns:
    where a particle is nearest to the border of a triangle, direction of that side (0 at a corner), and length of the
    line [m]; else 0. gaps: distance by which the pair shall separate [m], and its urgency. frictions: see
    `coefficient` of physics/friction.py.

    slips: the slip of the pair, and its missing distance [m]. met: share of the missing distance by which the parts
    approached in the substep before. That share is a hit, the rest is pressure. counts: (W,). some: (1,) 1 if there is
    a close pair.
    """

    particles: wp.array2d(dtype=int)
    surfaces: wp.array2d(dtype=int)
    inverse: wp.array2d(dtype=float)
    weights: wp.array2d(dtype=float)
    lines: wp.array2d(dtype=wp.vec3)
    turns: wp.array2d(dtype=wp.vec4)
    gaps: wp.array2d(dtype=wp.vec2)
    frictions: wp.array2d(dtype=wp.vec3)
    slips: wp.array2d(dtype=wp.vec4)
    met: wp.array2d(dtype=float)
    counts: wp.array(dtype=int)
    some: wp.array(dtype=int)


@wp.func
def _friction(a: Material, b: Material, dt: float) -> wp.vec3:
    """Return the friction of two bodies in a substep of length dt [s], see `coefficient` of physics/friction.py."""
    static = wp.sqrt(a.static_friction * b.static_friction)
    return wp.vec3(static, wp.sqrt(a.kinetic_friction * b.kinetic_friction), SLOW * dt)


@wp.func
def _look(members: Members, pairs: Pairs, close: Close, w: int, t: int, width: int):
    """List the close pairs of world w; thread t of `width`, as in the functions below."""
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
        if known and apart >= NOISE:  # parts in one place have no sides
            n = start / apart
            moved = float(0.0)
            for q in range(4):
                moves = load_row(members.surfaces[pair.surfaces[q]].displacements, pair.particles[q])
                moved += m.weights[q] * wp.dot(n, xyz(moves))
            kept = pairs.kept[w, k]
            if apart + moved < wp.static(CLOSE) * kept:
                lacks = kept - apart
                wanted = wp.where(lacks > 0.0, wp.min(_EASE * lacks, _PARTING * dt_of(of_a)), lacks)
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
                close.turns[w, j] = wp.vec4(0.0)
                if is_corner and wp.max(wp.vec3(m.weights[1], m.weights[2], m.weights[3])) == 0.0:
                    close.turns[w, j] = pack(_border(m.weights, b, c, d), apart)
                # If many pairs ask the same particle, those that have nearly passed through get most of it.
                urgency = kept / wp.max(apart, 1.0e-3 * kept)
                close.gaps[w, j] = wp.vec2(wanted, urgency * urgency)
                close.frictions[w, j] = _friction(of_a.materials[body_a], of_b.materials[body_b], dt_of(of_a))


@wp.func
def _border(weights: wp.vec4, b: wp.vec3, c: wp.vec3, d: wp.vec3) -> wp.vec3:
    """Return the direction of the side of triangle b c d that a particle is nearest to; 0 if that is a corner."""
    if weights[1] == 0.0 and weights[2] != 0.0 and weights[3] != 0.0:
        return wp.normalize(d - c)
    if weights[2] == 0.0 and weights[1] != 0.0 and weights[3] != 0.0:
        return wp.normalize(d - b)
    if weights[3] == 0.0 and weights[1] != 0.0 and weights[2] != 0.0:
        return wp.normalize(c - b)
    return wp.vec3(0.0)


@wp.func
def _parted(n: wp.vec3, turn: wp.vec4, moved: wp.vec3) -> float:
    """Return by how much two parts move apart [m], along their line or, past a border, as that line turns."""
    if turn[3] > 0.0:
        side, end = xyz(turn), turn[3] * n + moved
        end -= wp.dot(side, end) * side
        if wp.dot(n, end) > _MOST_TURNED * wp.length(end):
            return wp.length(end) - turn[3]
    return wp.dot(n, moved)


@wp.func
def _units(lacks: float, urgency: float, weight: float) -> wp.int64:
    """Return the claim of a pair on a particle, as an integer."""
    return wp.int64(wp.float64(wp.min(lacks, 1.0) * urgency * wp.abs(weight)) * _CLAIM)


@wp.func
def _claim(members: Members, close: Close, w: int, t: int, group: CooperativeGroup, turn: int):
    """Find the missing distance of close pairs, and sum claims at each particle; they split it in proportion."""
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
        lacks = wp.max(close.gaps[w, j][0] - _parted(n, close.turns[w, j], sum_of_four(moved)), 0.0)
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
    """Ask the particles of close pairs to move so that the pairs stay apart, with friction."""
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
            move += friction_correction(xyz(close.slips[w, j]), wp.vec3(0.0), lacks, friction)
            for k in range(4 * j + lane, 4 * j + 4, group.sharing):
                pair_corrections = members.surfaces[close.surfaces[w, k]].pair_corrections
                place = _place_of(close.particles[w, k], turn, MOVE)
                moves = (close.weights[w, k] * close.inverse[w, k] / yielding[0]) * move
                add_exactly(pair_corrections, place, moves)
                if met > 0.0:
                    add_exactly(pair_corrections, place + HIT, met * moves)


@wp.func
def _move(surface: Surface, i: int, turn: int):
    """Apply the corrections of one turn to a particle."""
    if surface.pair_corrections[_place_of(i, turn, CLAIM)] == wp.int64(0):
        return
    move, hit = _asked(surface, i, turn, MOVE), _asked(surface, i, turn, HIT)
    for k in range(wp.static(ASKED // 2)):
        surface.pair_corrections[_place_of(i, turn, k)] = wp.int64(0)
    packed = load_row(surface.displacements, i)
    store_row(surface.displacements, i, pack(xyz(packed) + move, packed[3]))
    if surface.last_displacements.shape[0] > 0:
        # A hit changes the velocity at once. Adding it to the past displacement lets BDF2 carry on just that.
        surface.last_displacements[i] = surface.last_displacements[i] + hit
        v = load_row(surface.velocities, i)
        store_row(surface.velocities, i, v + pack(hit / dt_of(surface), 0.0))


@wp.func
def _place_of(i: int, turn: int, k: int) -> int:
    """Return the index of number k of a turn of particle i in pair_corrections."""
    return wp.static(ASKED) * i + wp.static(ASKED // 2) * turn + k


@wp.func
def _asked(surface: Surface, i: int, turn: int, k: int) -> wp.vec3:
    """Return a sum of corrections [m], MOVE or HIT."""
    return exact_sum(surface.pair_corrections, _place_of(i, turn, k))


@wp.func
def _move_all(members: Members, w: int, t: int, width: int, turn: int):
    """Apply the corrections of one turn to the particles of world w; thread t of `width`."""
    for b in range(members.batches):
        surface = surface_of(members, b, w)
        for i in range(t, surface.positions.shape[0], width):
            _move(surface, i, turn)


@cooperative
def _keep_apart(members: Members, pairs: Pairs, close: Close, passes: int, group: CooperativeGroup):
    """Keep the pairs of all worlds apart, starting from the displacements found so far."""
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
        # Corrections of the last pass are applied while the next are computed, so that no thread waits for them.
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


def contact_solve(members: Members, pairs: Pairs, group: CooperativeGroup, device: wp.Device) -> wp.Launch:
    """The launch that keeps the pairs of a search apart."""
    worlds, room = pairs.parts.shape
    shapes = dict.fromkeys(("particles", "surfaces", "inverse", "weights"), (worlds, 4 * room))
    shapes |= dict.fromkeys(("lines", "turns", "gaps", "frictions", "slips", "met"), (worlds, room))
    close = allocated(Close, device, counts=worlds, some=1, **shapes)
    return recorded(_keep_apart, members, pairs, close, _PASSES, group=group, device=device)
