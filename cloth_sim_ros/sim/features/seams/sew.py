# SPDX-License-Identifier: Apache-2.0
"""Solve of seams by XPBD (Macklin, Mueller, Chentanez 2016): each stitch pulls its two points together.

A stitch is a spring of rest length 0 in three dimensions, so its force is a vector. Stitches at one particle share its
mass (mass splitting, Tonge et al. 2012), and some passes find what that left over. Sums are of integers, so the order
of stitches does not change a bit of the result. Forces of a stitch on its two points are opposite, so that momentum is
kept. That also takes bodies that are all of first or all of second order in a substep, to which `agree` sees.

Stitches come after lines and ropes, which do not know of the load, and so give way to it. A stitch is therefore solved
with the lines of structural springs that its particles hold, as if these went on through the seam (ways.py). Each line
is eliminated from its far end on, so that a particle yields with all that it drags along. Other springs, and ropes that
are solved as a whole, still give way by about h^2 F / m for a load F, and the measured error sees it.

A stitch that begins open closes at no more than a set speed. It does not break before it is closed.

Colliders come next, and friction or facets may pull two points apart again. So stitches that are closed pull once more
at the end of a substep. Those that still close do not, or they would pull points into a collider.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import warp as wp

from cloth_sim_ros.parameters import SEAM
from cloth_sim_ros.sim.arrays.state import Arrays, compliance_of, substep_length, was_smooth
from cloth_sim_ros.sim.features.seams.arrays import BROKEN
from cloth_sim_ros.sim.features.seams.bodies import Seams, SewnArrays, Stitch, seams_of
from cloth_sim_ros.sim.input.numbers import places
from cloth_sim_ros.sim.kernels.compiled import compiled
from cloth_sim_ros.sim.kernels.cooperative import (
    CooperativeGroup,
    cooperative,
    cooperative_group_of,
    number_of,
    recorded,
    sync_all,
)
from cloth_sim_ros.sim.kernels.intrinsics import add_exactly, exact_sum, load_row, pack, store_row, xyz
from cloth_sim_ros.sim.physics.distance import SHORTEST
from cloth_sim_ros.sim.physics.integrate import effective_step
from cloth_sim_ros.sim.topology import Topology

_COMPLIANCE, _STRENGTH, _SPEED = (places(SEAM)[name] for name in ("compliance", "strength", "closing_speed"))
_CLOSES, _CLOSED = wp.constant(0.0), wp.constant(-1.0)  # SeamState.stitches has these or BROKEN
_PASSES = 8  # passes over stitches that share particles; each halves about what the one before left
_STEPS = 4  # segments of a rope that a stitch slides over in a substep at most
_ROUNDING = wp.constant(1.0e-5)  # share of a segment that float32 does not lose
_LITTLE = wp.constant(1.0e-3)  # share of a segment by which a stitch enters the next one


@wp.struct
class Tie:
    """A stitch as it is now. particles: four. weights: of each in the vector from the second point to the first.

    arrays: index in Seams.arrays of the two batches. along: unit vector along which it slides, or 0.
    """

    particles: wp.vec4i
    weights: wp.vec4
    arrays: wp.vec2i
    along: wp.vec3


@wp.func
def _move_of(arrays: SewnArrays, i: int, moved: bool) -> wp.vec4:
    """Return what is added to the position of particle i [m]: its displacement if it has `moved`."""
    if moved:
        return load_row(arrays.displacements, i)
    return load_row(arrays.position_lo, i)


@wp.func
def _way(rope: SewnArrays, i: int, moved: bool) -> wp.vec3:
    """Return the vector from particle i of a rope to the next one [m]."""
    way = load_row(rope.positions, i + 1) - load_row(rope.positions, i)
    return xyz(way + (_move_of(rope, i + 1, moved) - _move_of(rope, i, moved)))


@wp.func
def _at(seams: Seams, stitch: Stitch, state: wp.vec3, w: int, moved: bool) -> Tie:
    """Return a stitch in a state of SeamState.stitches, in world w, before or after its rope has `moved`."""
    tie = Tie()
    tie.arrays = stitch.batches * seams.worlds + wp.vec2i(w, w)
    tie.particles = stitch.particles
    share = stitch.shares[1]
    if stitch.rope[0] >= 0:
        segments = stitch.rope[1] - stitch.rope[0]
        at = wp.clamp(float(stitch.particles[2] - stitch.rope[0]) + share + state[0], 0.0, float(segments))
        segment = wp.min(int(at), segments - 1)
        share = at - float(segment)
        tie.particles[2] = stitch.rope[0] + segment
        tie.particles[3] = tie.particles[2] + 1
        if at > 0.0 and at < float(segments):
            rope = seams.arrays[tie.arrays[1]]
            tie.along = wp.normalize(_way(rope, tie.particles[2], moved))
            if state[2] > 0.0:
                tie.along = wp.normalize(tie.along + wp.normalize(_way(rope, tie.particles[2] - 1, moved)))
    tie.weights = wp.vec4(1.0 - stitch.shares[0], stitch.shares[0], share - 1.0, -share)
    return tie


@wp.func
def _gap(seams: Seams, tie: Tie, moved: bool) -> wp.vec3:
    """Return the vector from the second point to the first [m], at the start of the substep or where it has `moved`."""
    first, gap = load_row(seams.arrays[tie.arrays[0]].positions, tie.particles[0]), wp.vec4(0.0)
    for k in range(4):
        of = seams.arrays[tie.arrays[k / 2]]
        i = tie.particles[k]
        gap += tie.weights[k] * ((load_row(of.positions, i) - first) + _move_of(of, i, moved))
    return xyz(gap)


@wp.func
def _across(gap: wp.vec3, tie: Tie) -> wp.vec3:
    """Return the part of a gap [m] that a stitch closes, across the way it slides."""
    return gap - wp.dot(gap, tie.along) * tie.along


@wp.func
def _slide(seams: Seams, stitch: Stitch, state: wp.vec3, w: int, moved: bool) -> wp.vec3:
    """Return the state of a stitch at the point of its rope nearest to its first point, from a state near by.

    Where the rope bends that point may be a particle, from which it slides along the mean of both segments.
    """
    slid, came = state[0], int(0)
    for _step in range(_STEPS):
        tie = _at(seams, stitch, wp.vec3(slid, 0.0, 0.0), w, moved)
        way = _way(seams.arrays[tie.arrays[1]], tie.particles[2], moved)
        square = wp.max(wp.dot(way, way), SHORTEST * SHORTEST)
        share = -tie.weights[3] + wp.dot(_gap(seams, tie, moved), way) / square
        begin = float(tie.particles[2] - stitch.particles[2]) - stitch.shares[1]
        goes = wp.where(share < 0.0, -1, wp.where(share > 1.0, 1, 0))
        if goes == 0:
            return wp.vec3(begin + share, state[1], 0.0)
        corner = begin + wp.where(goes > 0, 1.0, 0.0)
        if goes * came < 0:
            return wp.vec3(corner + _ROUNDING, state[1], 1.0)
        slid, came = corner + _LITTLE * float(goes), goes
    return wp.vec3(slid, state[1], 0.0)


@wp.func
def _length(arrays: SewnArrays, body: int) -> float:
    """Return the length of a substep [s]."""
    return substep_length(arrays.frames[0], arrays.control, arrays.limits[body], body)


@wp.func
def _square_step(arrays: SewnArrays, body: int, second: int, substep: int) -> float:
    """Return the square of the effective length of a substep of a body [s^2]."""
    smooth = bool(False)
    if second == 1:
        smooth = was_smooth(arrays.events, arrays.history, body, substep)
    h = effective_step(_length(arrays, body), smooth)
    return h * h


@wp.func
def _begin(seams: Seams, s: int, w: int, first: bool, last: bool):
    """Slide stitch s, forget its force of the last substep, and count it at its particles."""
    stitch = seams.stitches[s]
    state = seams.arrays[stitch.batches[0] * seams.worlds + w].seams
    now = state.stitches[stitch.number]
    if first:
        state.stitch_forces[stitch.number] = wp.vec3(0.0)
    if stitch.rope[0] >= 0 and (first or last):
        now = _slide(seams, stitch, now, w, last)
        state.stitches[stitch.number] = now
    tie = _at(seams, stitch, now, w, last)
    for k in range(4):
        if tie.weights[k] != 0.0:
            if wp.atomic_add(seams.counts, _number(seams, stitch, tie, k, w), 1) > 0:
                seams.sharing[w] = 1
    if now[1] == _CLOSES and not last:
        seams.closing[w] = 1


@wp.func
def _place(seams: Seams, k: int, w: int) -> int:
    """Return the place of a touched particle among those of all worlds."""
    of = seams.touched[k]
    return w * seams.particles + seams.firsts[of[0]] + of[1]


@wp.func
def _residual(side: SewnArrays, i: int, j: int, slot: int, compliance: float, gamma: float) -> wp.vec4:
    """Return the unit vector of a spring from particle i to j, and what is left of its equation [m]."""
    moved, then = load_row(side.displacements, i), load_row(side.displacements, j)
    edge = xyz((load_row(side.positions, j) - load_row(side.positions, i)) + (then - moved))
    length = wp.max(wp.length(edge), SHORTEST)
    left = length - side.line_rests[slot] + compliance * side.line_multipliers[slot]
    if gamma > 0.0:
        apart = xyz((then - load_row(side.bases, j)) - (moved - load_row(side.bases, i)))
        was = edge - apart
        left += gamma * wp.dot(edge + was, apart) / (length + wp.length(was) + SHORTEST)
    return pack(edge / length, left)


@wp.func
def _release(seams: Seams, k: int, w: int, substep: int):
    """Move a touched particle as the springs of its ways ask, all solved at once, and find how it yields with them.

    Each way is eliminated from its far end on: its first spring then gains the multiplier `rest + mass u . z` as the
    particle moves by z.
    """
    of = seams.touched[k]
    side = seams.arrays[of[0] * seams.worlds + w]
    square = _square_step(side, of[2], of[3], substep)
    gamma = side.materials[of[2]].damping * side.bodies[of[2]].line_damping / wp.sqrt(square)
    soft = compliance_of(side.materials[of[2]], 0) / square
    d = load_row(side.displacements, of[1])
    holds, asks = wp.identity(n=3, dtype=float), wp.vec3(0.0)
    for q in range(seams.way_starts[k], seams.way_starts[k + 1]):
        mass, rest, along = float(0.0), float(0.0), wp.vec3(0.0)
        way = seams.ways[q]
        for b in range(way[1] - 1, way[0] - 1, -1):
            i = int(of[1])
            if b > way[0]:
                i = seams.beads[b - 1][0]
            j, slot = seams.beads[b][0], seams.beads[b][1]
            near, far = load_row(side.displacements, i)[3], load_row(side.displacements, j)[3]
            compliance = soft * side.line_scales[slot]
            spring = _residual(side, i, j, slot, compliance, gamma)
            turn, eased = wp.dot(along, xyz(spring)), 1.0 / (1.0 + far * mass)
            left = spring[3] - (1.0 + gamma) * far * turn * rest * eased
            diagonal = compliance + (1.0 + gamma) * far * (1.0 - turn * turn * far * mass * eased)
            diagonal += 1.0e-5 * (near + far) + 1.0e-30
            along = xyz(spring)
            mass, rest = (1.0 + gamma) / diagonal, -left / diagonal
            if side.line_rests[slot] < 0.0:  # it failed
                mass, rest = 0.0, 0.0
            seams.pulls[w * seams.beads.shape[0] + b] = pack(along, mass)
            seams.rests[w * seams.beads.shape[0] + b] = rest
        holds += d[3] * mass * wp.outer(along, along)
        asks -= d[3] * rest * along
    number, eases = _place(seams, k, w), wp.inverse(holds)
    seams.inverses[number] = d[3] * eases
    seams.starts[number] = xyz(d)
    store_row(side.displacements, of[1], d + pack(eases * asks, 0.0))


@wp.func
def _leaves(seams: Seams, w: int, last: bool) -> bool:
    """True if sewn particles move alone: at the end, and while a stitch closes, which colliders then hinder less."""
    return last or seams.closing[w] != 0


@wp.func
def _leave(seams: Seams, k: int, w: int):
    """Let a touched particle yield alone."""
    of = seams.touched[k]
    inverse = load_row(seams.arrays[of[0] * seams.worlds + w].displacements, of[1])[3]
    seams.inverses[_place(seams, k, w)] = inverse * wp.identity(n=3, dtype=float)


@wp.func
def _free(seams: Seams, w: int, t: int, width: int, substep: int, last: bool):
    """Let particles with stitches move as they would without, and find how they yield."""
    for k in range(t, seams.touched.shape[0], width):
        if seams.counts[_place(seams, k, w)] == 0:
            continue
        if _leaves(seams, w, last):
            _leave(seams, k, w)
        else:
            _release(seams, k, w, substep)


@wp.func
def _follow(seams: Seams, k: int, w: int):
    """Let the ways of a touched particle follow its move since `_release`."""
    of = seams.touched[k]
    side = seams.arrays[of[0] * seams.worlds + w]
    number = _place(seams, k, w)
    moved = xyz(load_row(side.displacements, of[1])) - seams.starts[number]
    for q in range(seams.way_starts[k], seams.way_starts[k + 1]):
        way, at = seams.ways[q], w * seams.beads.shape[0]
        pull = load_row(seams.pulls, at + way[0])
        gained = seams.rests[at + way[0]] + pull[3] * wp.dot(xyz(pull), moved)
        for b in range(way[0], way[1]):
            j, slot = seams.beads[b][0], seams.beads[b][1]
            d, impulse = load_row(side.displacements, j), gained * xyz(pull)
            side.line_multipliers[slot] = side.line_multipliers[slot] + gained
            if b + 1 < way[1]:
                beyond = load_row(seams.pulls, at + b + 1)
                turn, pull = wp.dot(xyz(pull), xyz(beyond)), beyond
                rest = seams.rests[at + b + 1]
                gained = rest + pull[3] * d[3] * (gained * turn - rest) / (1.0 + d[3] * pull[3])
                impulse -= gained * xyz(pull)
            store_row(side.displacements, j, d + pack(d[3] * impulse, 0.0))


@wp.func
def _yields(seams: Seams, stitch: Stitch, tie: Tie, k: int, w: int, substep: int) -> wp.mat33:
    """Return how far particle k of a stitch moves under its force [m/N]."""
    side = seams.arrays[tie.arrays[k / 2]]
    square = _square_step(side, stitch.bodies[k / 2], stitch.seconds[k / 2], substep)
    return tie.weights[k] * square * seams.inverses[_number(seams, stitch, tie, k, w)]


@wp.func
def _number(seams: Seams, stitch: Stitch, tie: Tie, k: int, w: int) -> int:
    """Return the place of particle k of a stitch among those of all worlds."""
    return w * seams.particles + seams.firsts[stitch.batches[k / 2]] + tie.particles[k]


@wp.func
def _solved(matrix: wp.mat33, right: wp.vec3) -> wp.vec3:
    """Return the solution of a symmetric system of equations, scaled to stay within float32."""
    size = wp.trace(matrix)
    return wp.inverse(matrix / size) * (right / size)


@wp.func
def _pull(seams: Seams, s: int, w: int, substep: int, last: bool):
    """Find how stitch s moves its particles; one that is not closed yet does not in the last pull of a substep."""
    stitch = seams.stitches[s]
    of = seams.arrays[stitch.batches[0] * seams.worlds + w]
    now = of.seams.stitches[stitch.number]
    if now[1] == BROKEN or (last and now[1] == _CLOSES):
        return
    numbers = of.numbers[stitch.row].values
    tie = _at(seams, stitch, now, w, last)
    inverse = wp.mat33(0.0)
    for k in range(4):
        if tie.weights[k] != 0.0:
            several = float(seams.counts[_number(seams, stitch, tie, k, w)])
            inverse += tie.weights[k] * several * _yields(seams, stitch, tie, k, w, substep)
    size = wp.trace(inverse)
    if size == 0.0:
        return
    gap = _across(_gap(seams, tie, True), tie)
    force, compliance = of.seams.stitch_forces[stitch.number], numbers[_COMPLIANCE]
    unit = wp.identity(n=3, dtype=float)
    slides = wp.outer(tie.along, tie.along)
    inverse = (unit - slides) * inverse * (unit - slides)
    more = -_solved(inverse + compliance * unit + size * slides, gap + compliance * force)
    most = numbers[_SPEED] * _length(of, stitch.bodies[0])
    if now[1] == _CLOSES:
        least = wp.length(_across(_gap(seams, tie, False), tie)) - most
        if least <= compliance * wp.length(force):
            of.seams.stitches[stitch.number] = wp.vec3(now[0], _CLOSED, now[2])
        elif wp.length(gap + inverse * more) < least:
            left = gap * wp.min(1.0, least / wp.max(wp.length(gap), SHORTEST))
            more = _solved(inverse + size * slides, left - gap)
    of.seams.stitch_forces[stitch.number] = force + more
    for k in range(4):
        if tie.weights[k] != 0.0:
            move = _yields(seams, stitch, tie, k, w, substep) * more
            add_exactly(seams.moves, 3 * _number(seams, stitch, tie, k, w), move)


@wp.func
def _move(seams: Seams, w: int, t: int, width: int):
    """Move the particles as their stitches ask."""
    for k in range(t, seams.touched.shape[0], width):
        of = seams.touched[k]
        number = w * seams.particles + seams.firsts[of[0]] + of[1]
        if seams.counts[number] > 0:
            arrays = seams.arrays[of[0] * seams.worlds + w]
            d = load_row(arrays.displacements, of[1])
            store_row(arrays.displacements, of[1], d + pack(exact_sum(seams.moves, 3 * number), 0.0))
            for q in range(3):
                seams.moves[3 * number + q] = wp.int64(0)


@wp.func
def _end(seams: Seams, w: int, t: int, width: int, last: bool):
    """Let ways follow, forget the counts, and break the stitches that bear too much in the end."""
    for k in range(t, seams.touched.shape[0], width):
        if seams.counts[_place(seams, k, w)] > 0 and not _leaves(seams, w, last):
            _follow(seams, k, w)
        seams.counts[_place(seams, k, w)] = 0
    if t == 0:
        seams.sharing[w] = 0
    if not last:
        return
    if t == 0:
        seams.closing[w] = 0
    for s in range(t, seams.stitches.shape[0], width):
        stitch = seams.stitches[s]
        of = seams.arrays[stitch.batches[0] * seams.worlds + w]
        numbers, now = of.numbers[stitch.row].values, of.seams.stitches[stitch.number]
        if numbers[_STRENGTH] > 0.0 and now[1] == _CLOSED:
            if wp.length(of.seams.stitch_forces[stitch.number]) > numbers[_STRENGTH]:
                of.seams.stitches[stitch.number] = wp.vec3(now[0], BROKEN, now[2])


@cooperative
def _sew(seams: Seams, substep: int, first: bool, last: bool, passes: int, group: CooperativeGroup):
    """Pull the stitches of all worlds together, starting from the displacements found so far.

    first, last: of the substep.
    """
    number = number_of(wp.tid(), group)
    team = number / group.width
    t = number - team * group.width
    for w in range(team, seams.worlds, group.teams):
        for s in range(t, seams.stitches.shape[0], group.width):
            _begin(seams, s, w, first, last)
    sync_all(group)
    for w in range(team, seams.worlds, group.teams):
        _free(seams, w, t, group.width, substep, last)
    sync_all(group)
    for q in range(passes):
        for w in range(team, seams.worlds, group.teams):
            if q == 0 or seams.sharing[w] != 0:
                for s in range(t, seams.stitches.shape[0], group.width):
                    _pull(seams, s, w, substep, last)
        sync_all(group)
        for w in range(team, seams.worlds, group.teams):
            if q == 0 or seams.sharing[w] != 0:
                _move(seams, w, t, group.width)
        sync_all(group)
    for w in range(team, seams.worlds, group.teams):
        _end(seams, w, t, group.width, last)


@compiled
def _agree(seams: Seams, substep: int):
    """Let all sewn bodies of a world be of first order in a substep if one of them is."""
    w, smooth = wp.tid(), bool(True)
    for k in range(seams.bodies.shape[0]):
        body = seams.bodies[k]
        of = seams.arrays[body[0] * seams.worlds + w]
        if body[2] == 0:
            smooth = False
        elif not was_smooth(of.events, of.history, body[1], substep):
            smooth = False
    if smooth:
        return
    for k in range(seams.bodies.shape[0]):
        body = seams.bodies[k]
        of = seams.arrays[body[0] * seams.worlds + w]
        if body[2] == 1:
            if substep == 0:
                of.history[body[1]] = 0
            else:
                of.events[2 * body[1] + (substep + 1) % 2] = substep


class Sewing:
    """The launches that sew bodies together. homes: name -> number of its batch, and of the body there."""

    def __init__(
        self,
        batches: Sequence[Sequence[Arrays]],
        orders: Sequence[int],
        homes: dict[str, tuple[int, int]],
        topologies: dict[str, Topology],
        device: wp.Device,
    ) -> None:
        self.seams = seams_of(batches, orders, homes, topologies, device)
        self._group, self._device = cooperative_group_of(self.seams.worlds, device), device
        self._passes = _PASSES if self._shares() else 1

    def _shares(self) -> bool:
        """True if a particle may have several stitches."""
        stitches = self.seams.stitches.numpy()
        weights = np.column_stack([1.0 - stitches["shares"], stitches["shares"]])[:, [0, 2, 1, 3]]
        ends = np.stack([np.repeat(stitches["batches"], 2, axis=1), stitches["particles"]], axis=-1)[weights != 0.0]
        return bool((stitches["rope"] >= 0).any()) or len(np.unique(ends, axis=0)) < len(ends)

    def sew(self, substep: int, first: bool, last: bool) -> wp.Launch:
        """Return a launch that pulls stitches together, and if it is the first or last of a substep."""
        inputs = [self.seams, substep, first, last, self._passes]
        return recorded(_sew, *inputs, group=self._group, device=self._device)

    def agree(self, substep: int) -> wp.Launch:
        """Return the launch that finds the order of a substep, or of the next frame's first."""
        inputs = [self.seams, substep]
        return wp.launch(_agree, self.seams.worlds, inputs, device=self._device, record_cmd=True)
