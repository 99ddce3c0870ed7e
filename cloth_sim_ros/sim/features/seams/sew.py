# SPDX-License-Identifier: Apache-2.0
"""Solve of seams by XPBD (Macklin, Mueller, Chentanez 2016): each stitch pulls its two points together.

A stitch is a spring of rest length 0 in three dimensions, so its force is a vector. Stitches at one particle share its
mass (mass splitting, Tonge et al. 2012), and some passes find what that left over. Sums are of integers, so the order
of stitches does not change a bit of the result. Forces of a stitch on its two points are opposite, so that momentum is
kept. That also takes bodies that are all of first or all of second order in a substep, to which `agree` sees.

Stitches come after lines and ropes, which do not know of the load, and so give way to it. A stitch is therefore solved
with the lines of structural springs that its particles hold, as if these went on through the seam (ways.py). Each line
is eliminated from its far end on, so that a particle yields with all that it drags along. A rope takes its stitches to
sheets into its own solve (held.py). Other springs, and ropes on a winch, still give way by about h^2 F / m for a load
F, and the measured error sees it.

A stitch that begins open closes at no more than a set speed. It does not break before it is closed.

Colliders come next, and friction or facets may pull two points apart again. So stitches that are closed pull once more
at the end of a substep. Those that still close do not, or they would pull points into a collider.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import warp as wp

from cloth_sim_ros.sim.arrays.state import Arrays, was_smooth
from cloth_sim_ros.sim.features.seams.arrays import BROKEN, CLOSED, CLOSES
from cloth_sim_ros.sim.features.seams.bodies import Seams, seams_of
from cloth_sim_ros.sim.features.seams.held import hold, keep, take
from cloth_sim_ros.sim.features.seams.stitch import (
    COMPLIANCE,
    SPEED,
    STRENGTH,
    Tie,
    across,
    all_yield,
    gap_of,
    length_of,
    number_of_particle,
    place_of,
    slide,
    solved,
    tie_of,
    yields,
)
from cloth_sim_ros.sim.features.seams.ways import follow, release
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
from cloth_sim_ros.sim.topology import Topology

_ROPES = wp.constant(-1)  # number of the pass in which sheets follow the ropes that took their stitches
_PASSES = 8  # passes over stitches that share particles; each halves about what the one before left


@wp.func
def _begin(seams: Seams, s: int, w: int, first: bool, last: bool):
    """Slide stitch s, forget its force of the last substep, and count it at its particles."""
    stitch = seams.stitches[s]
    state = seams.arrays[stitch.batches[0] * seams.worlds + w].seams
    now = state.stitches[stitch.number]
    if first:
        state.stitch_forces[stitch.number] = wp.vec3(0.0)
    if stitch.rope[0] >= 0 and (first or last):
        now = slide(seams, stitch, now, w, last)
        state.stitches[stitch.number] = now
    tie = tie_of(seams, stitch, now, w, last)
    for k in range(4):
        if tie.weights[k] != 0.0:
            if wp.atomic_add(seams.counts, number_of_particle(seams, stitch, tie, k, w), 1) > 0:
                seams.sharing[w] = 1
    if now[1] == CLOSES and not last and _moves(seams, tie):
        for k in range(2):
            seams.closing[w * seams.bodies.shape[0] + stitch.sewn[k]] = 1


@wp.func
def _moves(seams: Seams, tie: Tie) -> bool:
    """True if a stitch can move any of its particles."""
    moves = bool(False)
    for k in range(4):
        if tie.weights[k] != 0.0 and load_row(seams.arrays[tie.arrays[k / 2]].displacements, tie.particles[k])[3] > 0.0:
            moves = True
    return moves


@wp.func
def _leaves(seams: Seams, k: int, w: int, last: bool) -> bool:
    """True if touched particle k moves alone: at the end, and while stitches close, as colliders hinder it less."""
    return last or seams.closing[w * seams.bodies.shape[0] + seams.owners[k]] != 0


@wp.func
def _leave(seams: Seams, k: int, w: int):
    """Let a touched particle yield alone."""
    of = seams.touched[k]
    inverse = load_row(seams.arrays[of[0] * seams.worlds + w].displacements, of[1])[3]
    seams.inverses[place_of(seams, k, w)] = inverse * wp.identity(n=3, dtype=float)


@wp.func
def _free(seams: Seams, w: int, t: int, width: int, substep: int, last: bool):
    """Let particles with stitches move as they would without, and find how they yield."""
    for k in range(t, seams.touched.shape[0], width):
        if seams.counts[place_of(seams, k, w)] == 0:
            continue
        if _leaves(seams, k, w, last):
            _leave(seams, k, w)
        else:
            release(seams, k, w, substep)


@wp.func
def _pull(seams: Seams, s: int, w: int, substep: int, last: bool):
    """Find how stitch s moves its particles; one that is not closed yet does not in the last pull of a substep."""
    stitch = seams.stitches[s]
    of = seams.arrays[stitch.batches[0] * seams.worlds + w]
    now = of.seams.stitches[stitch.number]
    if now[1] == BROKEN or (last and now[1] == CLOSES):
        return
    numbers = of.numbers[stitch.row].values
    tie = tie_of(seams, stitch, now, w, last)
    inverse = all_yield(seams, stitch, tie, w, substep, -1, 0.0)
    size = wp.trace(inverse)
    if size == 0.0:
        return
    gap = across(gap_of(seams, tie, True), tie)
    force, compliance = of.seams.stitch_forces[stitch.number], numbers[COMPLIANCE]
    unit = wp.identity(n=3, dtype=float)
    slides = wp.outer(tie.along, tie.along)
    inverse = (unit - slides) * inverse * (unit - slides)
    more = -solved(inverse + compliance * unit + size * slides, gap + compliance * force)
    most = numbers[SPEED] * length_of(of, stitch.bodies[0])
    if now[1] == CLOSES:
        least = wp.length(across(gap_of(seams, tie, False), tie)) - most
        if least <= compliance * wp.length(force):
            of.seams.stitches[stitch.number] = wp.vec3(now[0], CLOSED, now[2])
        elif wp.length(gap + inverse * more) < least:
            left = gap * wp.min(1.0, least / wp.max(wp.length(gap), SHORTEST))
            more = solved(inverse + size * slides, left - gap)
    of.seams.stitch_forces[stitch.number] = force + more
    for k in range(4):
        if tie.weights[k] != 0.0:
            move = yields(seams, stitch, tie, k, w, substep) * more
            add_exactly(seams.moves, 3 * number_of_particle(seams, stitch, tie, k, w), move)


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
def _end(seams: Seams, w: int, t: int, width: int, substep: int, last: bool):
    """Let ways follow, forget the counts, and break the stitches that bear too much in the end."""
    for k in range(t, seams.touched.shape[0], width):
        if seams.counts[place_of(seams, k, w)] > 0 and not _leaves(seams, k, w, last):
            follow(seams, k, w, substep)
        seams.counts[place_of(seams, k, w)] = 0
    if t == 0:
        seams.sharing[w] = 0
    if not last:
        return
    for k in range(t, seams.bodies.shape[0], width):
        seams.closing[w * seams.bodies.shape[0] + k] = 0
    for s in range(t, seams.stitches.shape[0], width):
        stitch = seams.stitches[s]
        of = seams.arrays[stitch.batches[0] * seams.worlds + w]
        numbers, now = of.numbers[stitch.row].values, of.seams.stitches[stitch.number]
        if numbers[STRENGTH] > 0.0 and now[1] == CLOSED:
            if wp.length(of.seams.stitch_forces[stitch.number]) > numbers[STRENGTH]:
                of.seams.stitches[stitch.number] = wp.vec3(now[0], BROKEN, now[2])


@wp.func
def _hold_ropes(seams: Seams, w: int, t: int, width: int, substep: int):
    """Tell the solves of ropes what their stitches do."""
    for k in range(t, seams.touched.shape[0], width):
        if seams.hold_starts[k + 1] > seams.hold_starts[k]:
            hold(seams, k, w, substep)


@wp.func
def _take(seams: Seams, w: int, t: int, width: int, substep: int):
    """Find how particles of sheets move as the ropes at their stitches did."""
    for k in range(t, seams.touched.shape[0], width):
        number = place_of(seams, k, w)
        if seams.counts[number] > 0 and not _leaves(seams, k, w, False):
            of = seams.touched[k]
            d = load_row(seams.arrays[of[0] * seams.worlds + w].displacements, of[1])
            seams.starts[number] += xyz(d) - seams.released[number]  # contact with other objects
        keep(seams, k, w)
    for s in range(t, seams.stitches.shape[0], width):
        take(seams, s, w, substep)


@wp.func
def _begin_all(seams: Seams, w: int, t: int, width: int, first: bool, last: bool):
    """Begin all stitches of a world."""
    for s in range(t, seams.stitches.shape[0], width):
        _begin(seams, s, w, first, last)


@wp.func
def _pull_all(seams: Seams, w: int, t: int, width: int, substep: int, last: bool, q: int):
    """Find how all particles of a world move in pass q."""
    if q == _ROPES:
        _take(seams, w, t, width, substep)
    else:
        for s in range(t, seams.stitches.shape[0], width):
            _pull(seams, s, w, substep, last)


@wp.func
def _needs(seams: Seams, w: int, q: int) -> bool:
    """True if stitches of a world need pass q."""
    return q <= 0 or seams.sharing[w] != 0


@cooperative
def _open(seams: Seams, substep: int, first: bool, group: CooperativeGroup):
    """Begin a substep of all worlds before the solve of ropes that take stitches. first: its first iteration."""
    number = number_of(wp.tid(), group)
    team = number / group.width
    t = number - team * group.width
    for w in range(team, seams.worlds, group.teams):
        _begin_all(seams, w, t, group.width, first, False)
    sync_all(group)
    for w in range(team, seams.worlds, group.teams):
        _free(seams, w, t, group.width, substep, False)
    sync_all(group)
    for w in range(team, seams.worlds, group.teams):
        _hold_ropes(seams, w, t, group.width, substep)


@cooperative
def _sew(seams: Seams, substep: int, first: bool, last: bool, opened: bool, passes: int, group: CooperativeGroup):
    """Pull the stitches of all worlds together, starting from the displacements found so far.

    first, last: of the substep. opened: True if `_open` began it.
    """
    number = number_of(wp.tid(), group)
    team = number / group.width
    t = number - team * group.width
    if not opened:
        for w in range(team, seams.worlds, group.teams):
            _begin_all(seams, w, t, group.width, first, last)
        sync_all(group)
        for w in range(team, seams.worlds, group.teams):
            _free(seams, w, t, group.width, substep, last)
        sync_all(group)
    for q in range(wp.where(opened, _ROPES, 0), passes):
        for w in range(team, seams.worlds, group.teams):
            if _needs(seams, w, q):
                _pull_all(seams, w, t, group.width, substep, last, q)
        sync_all(group)
        for w in range(team, seams.worlds, group.teams):
            if _needs(seams, w, q):
                _move(seams, w, t, group.width)
        sync_all(group)
    for w in range(team, seams.worlds, group.teams):
        _end(seams, w, t, group.width, substep, last)


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

    @property
    def is_held(self) -> bool:
        """True if the solve of a rope takes stitches."""
        return self.seams.holds.shape[0] > 0

    def open(self, substep: int, first: bool) -> wp.Launch:
        """Return a launch that tells ropes what their stitches do, before they are solved."""
        return recorded(_open, self.seams, substep, first, group=self._group, device=self._device)

    def sew(self, substep: int, first: bool, last: bool) -> wp.Launch:
        """Return a launch that pulls stitches together, and if it is the first or last of a substep."""
        inputs = [self.seams, substep, first, last, self.is_held and not last, self._passes]
        return recorded(_sew, *inputs, group=self._group, device=self._device)

    def agree(self, substep: int) -> wp.Launch:
        """Return the launch that finds the order of a substep, or of the next frame's first."""
        inputs = [self.seams, substep]
        return wp.launch(_agree, self.seams.worlds, inputs, device=self._device, record_cmd=True)
