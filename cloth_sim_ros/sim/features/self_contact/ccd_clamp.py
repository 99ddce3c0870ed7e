# SPDX-License-Identifier: Apache-2.0
"""Clamp displacements so that no part passes through another in a substep.

Two parts begin a substep on opposite sides of the plane between their nearest points. They should also end it on two
sides of some plane of that direction. Otherwise each particle stops on its own side of the starting plane (divide and
truncate, Chen et al. 2025, Offset geometric contact). Paths are straight, so nothing crosses on the way either.

If nothing is pinned, planes move at the mean velocity of all bodies. A group that flies as a whole is not slowed. Where
a particle that has to stop lies on a collider, they move with that collider: it would else be pushed into it.
"""

import warp as wp

from cloth_sim_ros.sim.features.collider_contact.sweep import NOISE
from cloth_sim_ros.sim.features.self_contact.nearest import nearest
from cloth_sim_ros.sim.features.self_contact.pairs import Pair, Pairs, pair_of
from cloth_sim_ros.sim.features.self_contact.surfaces import Members, Surface, dt_of, panel_of, surface_of, velocity
from cloth_sim_ros.sim.kernels.compiled import compiled
from cloth_sim_ros.sim.kernels.cooperative import CooperativeGroup, cooperative, number_of, recorded, sync_all
from cloth_sim_ros.sim.kernels.intrinsics import load_row, store_row, xyz

ROUNDS = 64  # largest number of rounds: a particle that stops may block others; each round mends its pairs for good
_ROUNDING = wp.constant(1.0e-6)  # rounding error as a fraction of a displacement
_SPEED = wp.constant(wp.int64(1 << 24))  # integer units per m/s in sums of velocities
_MOTION = wp.constant(float(1 << 40))  # integer units per metre in sums of displacements
_LEFT = wp.constant(0.1)  # fraction of the distance of two parts that no substep takes away
_PARALLEL = wp.constant(0.01)  # sine of the angle of two edges below which they count as parallel
_LEAST = wp.constant(0.05)  # smallest distance of two parts, as a fraction of the distance that they are kept apart


@wp.func
def _mean_way(members: Members, pairs: Pairs, w: int) -> wp.vec3:
    """Return the mean displacement of all particles of world w in a substep [m]; 0 if any is pinned."""
    if pairs.sums[w, 3] > wp.int64(0):
        return wp.vec3(0.0)
    count, dt = float(0.0), float(0.0)
    for b in range(members.bodies.shape[0]):
        surface = members.surfaces[members.bodies[b][0] * members.worlds + w]
        count += float(surface.bodies[members.bodies[b][1]].count)
        dt = dt_of(surface)
    scale = dt / (float(_SPEED) * count)
    return scale * wp.vec3(float(pairs.sums[w, 0]), float(pairs.sums[w, 1]), float(pairs.sums[w, 2]))


@wp.func
def _carried(members: Members, pairs: Pairs, w: int) -> wp.vec3:
    """Return the displacement of planes in this substep [m]."""
    if pairs.sums[w, 8] == wp.int64(0):
        return _mean_way(members, pairs, w)
    scale = 1.0 / (_MOTION * float(pairs.sums[w, 7]))
    return scale * wp.vec3(float(pairs.sums[w, 4]), float(pairs.sums[w, 5]), float(pairs.sums[w, 6]))


@compiled
def _sum(members: Members, pairs: Pairs):
    """Sum the velocities of all particles of a world, and note if one is pinned."""
    panels = members.panels.shape[0]
    w = wp.tid() / panels
    panel = panel_of(members, wp.tid() - w * panels, w)
    surface = members.surfaces[panel.surface]
    for q in range(3):
        if (panel.own >> q) & 1 == 1:
            v = velocity(surface, panel.corners[q])
            for k in range(3):
                wp.atomic_add(pairs.sums, w, k, wp.int64(v[k] * float(_SPEED)))
            if load_row(surface.positions, panel.corners[q])[3] == 0.0:
                pairs.sums[w, 3] = wp.int64(1)


@wp.func
def _way(surface: Surface, i: int, carried: wp.vec3) -> wp.vec3:
    """Return the displacement of a particle in this substep, relative to the mean one [m]."""
    return xyz(load_row(surface.displacements, i) - load_row(surface.position_lo, i)) - carried


@wp.func
def _from(members: Members, pair: Pair, q: int) -> wp.vec3:
    """Return the place of particle q of a pair, relative to its first one, when the substep began [m].

    The difference includes the low parts of both positions.
    """
    of, of_first = members.surfaces[pair.surfaces[q]], members.surfaces[pair.surfaces[0]]
    i, first = pair.particles[q], pair.particles[0]
    high = load_row(of.positions, i) - load_row(of_first.positions, first)
    return xyz(high + (load_row(of.position_lo, i) - load_row(of_first.position_lo, first)))


@wp.func
def _direction(is_corner: bool, m: wp.vec4, b: wp.vec3, c: wp.vec3, d: wp.vec3, line: wp.vec3) -> wp.vec3:
    """Return the direction of `line`, from the second part to the first; m: weights of the nearest points.

    Inside both parts it is normal to them, and that is what it is computed from. Float32 loses the direction of a line
    of micrometres: its plane would then cut the parts themselves.
    """
    along, across = wp.where(is_corner, c - b, b), d - wp.where(is_corner, b, c)
    n = wp.cross(along, across)
    inside = wp.min(wp.min(wp.abs(m[0]), wp.abs(m[1])), wp.min(wp.abs(m[2]), wp.abs(m[3]))) > 0.0
    if inside and wp.length(n) > _PARALLEL * wp.length(along) * wp.length(across):
        return wp.where(wp.dot(n, line) < 0.0, -1.0, 1.0) * wp.normalize(n)
    return wp.normalize(line)


@wp.func
def _ask(surface: Surface, i: int, goes: float, room: float, pairs: Pairs, w: int, round: int):
    """Ask a particle of world w to go no further than `room` [m]."""
    d = load_row(surface.displacements, i)
    moves = goes > wp.max(room, 0.0) + wp.static(_ROUNDING) * wp.length(xyz(d)) and d[3] > 0.0
    if moves:
        wp.atomic_max(surface.ways_given_up, i, 1.0 - wp.max(room, 0.0) / goes)
        pairs.rounds[round] = 1
        ground = load_row(surface.grounds, i)
        if ground[3] > 0.0 and pairs.sums[w, 3] + pairs.sums[w, 8] == wp.int64(0):
            for k in range(3):
                wp.atomic_add(pairs.sums, w, 4 + k, wp.int64(ground[k] * _MOTION))
            wp.atomic_add(pairs.sums, w, 7, wp.int64(1))


@wp.func
def measure(members: Members, pairs: Pairs, p: int, w: int):
    """Measure how far panel p of world w goes in this substep, before the clamp."""
    panel, longest, carried = panel_of(members, p, w), float(0.0), _mean_way(members, pairs, w)
    for q in range(3):
        longest = wp.max(longest, wp.length(_way(members.surfaces[panel.surface], panel.corners[q], carried)))
    pairs.ranges[w * members.panels.shape[0] + p] = longest


@wp.func
def _find(members: Members, pairs: Pairs, w: int, t: int, width: int, round: int):
    """Find the share by which particles of world w shorten their displacements; thread t of `width`."""
    carried, of_world = _carried(members, pairs, w), w * members.panels.shape[0]
    more = 2.0 * wp.length(carried - _mean_way(members, pairs, w))  # of the ways that `measure` found
    for k in range(t, wp.min(pairs.counts[w, 1], pairs.parts.shape[1]), width):
        least, panels = pairs.starts[w, k], pairs.panels[w, k]
        left = wp.max(wp.static(_LEFT) * least, wp.static(_LEAST) * pairs.kept[w, k])
        longest = pairs.ranges[of_world + panels[0]] + pairs.ranges[of_world + panels[1]]
        if longest + more <= least - left:
            continue
        pair = pair_of(members, pairs, w, k)
        is_corner = pairs.parts[w, k][0] >= 0
        first = wp.where(is_corner, 1, 2)  # particles of the first part
        b, c, d = _from(members, pair, 1), _from(members, pair, 2), _from(members, pair, 3)
        m = nearest(is_corner, wp.vec3(0.0), b, c, d).weights
        line = m[1] * b + m[2] * c + m[3] * d
        apart, n = wp.length(line), _direction(is_corner, m, b, c, d, line)
        if apart < NOISE:
            continue
        left = wp.max(wp.static(_LEFT) * apart, wp.static(_LEAST) * pairs.kept[w, k])
        middle = -0.5 * apart
        if not is_corner:
            middle = wp.min(0.0, wp.dot(n, b)) - 0.5 * apart
        # Distances of particles from the plane, on their own sides, and how far they go towards it.
        offs, goes, ends = wp.vec4(0.0), wp.vec4(0.0), wp.vec2(1.0e30)
        for q in range(4):
            side = wp.where(q < first, 1.0, -1.0)
            offs[q] = side * (wp.dot(n, _from(members, pair, q)) - middle)
            goes[q] = -side * wp.dot(n, _way(members.surfaces[pair.surfaces[q]], pair.particles[q], carried))
            part = wp.where(q < first, 0, 1)
            ends[part] = wp.min(ends[part], offs[q] - goes[q])
        if ends[0] + ends[1] < left:
            for q in range(4):
                room = offs[q] - 0.5 * left
                _ask(members.surfaces[pair.surfaces[q]], pair.particles[q], goes[q], room, pairs, w, round)


@wp.func
def _shorten(surface: Surface, i: int, carried: wp.vec3):
    """Shorten the displacement of a particle by the share that was found."""
    share = surface.ways_given_up[i]
    if share == 0.0:
        return
    surface.ways_given_up[i] = 0.0
    less = -share * _way(surface, i, carried)
    d = load_row(surface.displacements, i) + wp.vec4(less[0], less[1], less[2], 0.0)
    store_row(surface.displacements, i, d)
    if surface.last_displacements.shape[0] > 0:
        # BDF2 carries the past displacement on. Setting it to the new one keeps the particle from bouncing.
        moved = d - load_row(surface.position_lo, i)
        surface.last_displacements[i] = xyz(moved)
        v = load_row(surface.velocities, i)
        moved = moved / dt_of(surface)
        store_row(surface.velocities, i, wp.vec4(moved[0], moved[1], moved[2], v[3]))


@wp.func
def _shorten_all(members: Members, pairs: Pairs, w: int, t: int, width: int, round: int):
    """Shorten displacements in world w, or let its planes move with the colliders that were found from now on."""
    found, since = pairs.sums[w, 7], pairs.sums[w, 8]
    anew = found > wp.int64(0) and (since == wp.int64(0) or since == wp.int64(round + 1))
    if anew and t == 0:
        pairs.sums[w, 8] = wp.int64(round + 1)
    carried = _carried(members, pairs, w)
    for b in range(members.batches):
        surface = surface_of(members, b, w)
        for i in range(t, surface.positions.shape[0], width):
            if anew:
                surface.ways_given_up[i] = 0.0
            else:
                _shorten(surface, i, carried)


@cooperative
def _bound(members: Members, pairs: Pairs, rounds: int, group: CooperativeGroup):
    """Shorten the displacements of all particles until no pair asks for more."""
    if pairs.folded[0] == 0:
        return
    number = number_of(wp.tid(), group)
    team = number / group.width
    t = number - team * group.width
    for w in range(team, members.worlds, group.teams):
        if t < 5:
            pairs.sums[w, 4 + t] = wp.int64(0)
    sync_all(group)
    for round in range(rounds):
        for w in range(team, members.worlds, group.teams):
            _find(members, pairs, w, t, group.width, round)
        sync_all(group)
        if pairs.rounds[round] == 0:
            return
        for w in range(team, members.worlds, group.teams):
            _shorten_all(members, pairs, w, t, group.width, round)
        sync_all(group)


def ccd_clamp(
    members: Members, pairs: Pairs, group: CooperativeGroup, device: wp.Device
) -> tuple[wp.Launch, wp.Launch]:
    """The launch that sums all velocities before a frame, and the one that shortens displacements after a substep."""
    inputs, total = [members, pairs], members.worlds * members.panels.shape[0]
    velocities = wp.launch(_sum, total, inputs, device=device, record_cmd=True)
    return velocities, recorded(_bound, *inputs, ROUNDS, group=group, device=device)
