# SPDX-License-Identifier: Apache-2.0
"""Which parts of objects may meet soon, and which have come through one another.

Each panel has a box around its way to come at the speed that it has, with some slack. Warp's tree of boxes finds panels
whose boxes overlap, and of these the corners, triangles and edges that may meet are listed.

A list holds for a time ahead, and while no particle is off its way by more than the slack. So no pair is missed,
however particles are pushed, and what rests is hardly ever looked at.
"""

from typing import Any

import numpy as np
import warp as wp

from cloth_sim_ros.sim.compiled import compiled
from cloth_sim_ros.sim.intrinsics import load_row, store_row, xyz
from cloth_sim_ros.sim.meeting.bound import ROUNDS
from cloth_sim_ros.sim.meeting.cooperative import Crew, recorded
from cloth_sim_ros.sim.meeting.nearest import crosses
from cloth_sim_ros.sim.meeting.pairs import TESTS, Pairs, Way, list_test, slack, tests_of, time_ahead, way_of
from cloth_sim_ros.sim.meeting.surfaces import Members, Panel, Surface, may_touch, panel_of, place
from cloth_sim_ros.sim.meeting.watch import FAR, MOST, goes, has_failed, look

PAIRS_A_PANEL = 64  # room in the list of pairs
_COUPLES_A_PANEL = 48  # and in the list of panels whose boxes overlap
_EVERY = 64  # frames after which the tree is built anew; until then its boxes are fitted
_THREADS = 131072  # of a launch over the couples of all worlds, on a GPU
_TEAM = 4  # of them that look at a couple


@compiled
def _foresee(members: Members, pairs: Pairs, ends: bool):
    """Where particles are, and where they go: what trembles goes at its mean velocity since the last search.

    Who was far off its way may be so again, and the longer it is not, the less.
    """
    panels = members.panels.shape[0]
    w = wp.tid() / panels
    panel = panel_of(members, wp.tid() - w * panels, w)
    surface = members.surfaces[panel.surface]
    dt = surface.frames[0].dt
    time = float(wp.max(pairs.clock[3], 1)) * dt
    pairs.failed[wp.tid()] = has_failed(panel)
    for q in range(3):
        if (panel.own >> q) & 1 == 1:
            i = panel.corners[q]
            x, seen = place(surface, i), load_row(surface.seen, i)
            mean, now = (x - xyz(seen)) / time, goes(surface, i, ends)
            off = wp.length(x - xyz(seen) - time * surface.going[i]) + dt * wp.length(now - surface.going[i])
            strays = wp.max(2.0 * off, 0.7 * seen[3])
            trembles = wp.length(mean) < 0.5 * wp.length(now)
            near = dt * wp.length(mean - now) < 0.5 * slack(members, pairs, surface, panel.body, i)
            surface.going[i] = wp.where(trembles and near, mean, now)
            store_row(surface.seen, i, wp.vec4(x[0], x[1], x[2], strays))


@wp.func
def _wrap(t: int, panel: Panel, surface: Surface, time: float, margin: float, pairs: Pairs):
    """The ball around panel t of all worlds, for a time [s] and with a margin [m]."""
    middle, drift = wp.vec3(0.0), wp.vec3(0.0)
    for q in range(3):
        middle += place(surface, panel.corners[q]) / 3.0
        drift += surface.going[panel.corners[q]] / 3.0
    radius = float(0.0)
    for q in range(3):
        off = wp.length(place(surface, panel.corners[q]) - middle)
        radius = wp.max(radius, off + time * wp.length(surface.going[panel.corners[q]] - drift))
    pairs.balls[t] = wp.vec4(middle[0], middle[1], middle[2], radius + margin)
    pairs.drifts[t] = drift


@compiled
def _enclose(
    members: Members, pairs: Pairs, ahead: bool, lowers: wp.array(dtype=wp.vec3), uppers: wp.array(dtype=wp.vec3)
):
    """The boxes of all panels as they are or, ahead, for as long as the next list holds."""
    panels = members.panels.shape[0]
    w = wp.tid() / panels
    panel = panel_of(members, wp.tid() - w * panels, w)
    surface = members.surfaces[panel.surface]
    time, margin = float(0.0), float(0.0)
    if ahead:
        time = time_ahead(pairs, surface)
        way = way_of(members, pairs, surface, panel, time)
        margin = way.thickness + way.slack
        _wrap(wp.tid(), panel, surface, time, margin, pairs)
        pairs.ways[wp.tid()] = way
    low, high = wp.vec3(1.0e30), wp.vec3(-1.0e30)
    for q in range(3):
        x = place(surface, panel.corners[q])
        v = surface.going[panel.corners[q]]
        low = wp.min(low, wp.min(x, x + time * v))
        high = wp.max(high, wp.max(x, x + time * v))
    lowers[wp.tid()] = low - wp.vec3(margin)
    uppers[wp.tid()] = high + wp.vec3(margin)


@compiled
def _couple(
    members: Members,
    pairs: Pairs,
    tree: wp.uint64,
    lowers: wp.array(dtype=wp.vec3),
    uppers: wp.array(dtype=wp.vec3),
):
    """List the panels that may meet, each couple once."""
    tid = wp.tid()
    panels = members.panels.shape[0]
    w = tid / panels
    owner, drift = members.owners[tid - w * panels], pairs.drifts[tid]
    time = time_ahead(pairs, members.surfaces[w])
    query = wp.bvh_query_aabb(tree, lowers[tid], uppers[tid], wp.bvh_get_group_root(tree, w))
    found = int(0)
    while wp.bvh_query_next(query, found):
        if found > tid:
            apart = pairs.balls[tid] - pairs.balls[found]
            near = pairs.balls[tid][3] + pairs.balls[found][3] + time * wp.length(drift - pairs.drifts[found])
            other = members.owners[found - w * panels]
            if wp.length(xyz(apart)) < near and may_touch(members, owner, other):
                n = wp.atomic_add(pairs.counts, w, 0, 1)
                if n < pairs.couples.shape[1]:
                    pairs.couples[w, n] = wp.vec2i(tid - w * panels, found - w * panels)


@compiled
def _pair(members: Members, pairs: Pairs, width: int, team: int):
    """List the parts of couples that may meet: `width` threads a world, `team` of them a couple."""
    w, panels = wp.tid() / width, members.panels.shape[0]
    t = wp.tid() - w * width
    for item in range(t / team, wp.min(pairs.counts[w, 0], pairs.couples.shape[1]), width / team):
        couple = pairs.couples[w, item]
        first, second = pairs.ways[w * panels + couple[0]], pairs.ways[w * panels + couple[1]]
        tests = tests_of(first.panel, second.panel)
        for test in range(t % team, wp.static(TESTS), team):
            if (tests >> test) & 1 == 1:
                if test < 3:
                    list_test(pairs, w, first, test, second, -1)
                elif test < 6:
                    list_test(pairs, w, second, test - 3, first, -1)
                else:
                    list_test(pairs, w, first, test / 3 - 2, second, test % 3)


@compiled
def _accept(pairs: Pairs):
    """A list that is too long is made again for a shorter time."""
    full = bool(False)
    for w in range(pairs.counts.shape[0]):
        full = full or pairs.counts[w, 0] > pairs.couples.shape[1] or pairs.counts[w, 1] > pairs.parts.shape[1]
    pairs.clock[2] = wp.where(full and pairs.clock[1] > 1, 1, 0)
    if full:
        pairs.clock[1] = wp.max(pairs.clock[1] / 4, 1)
        pairs.strays[1] = wp.max(0.25 * pairs.strays[1], pairs.strays[0])


@compiled
def _cross(
    members: Members,
    w: int,
    tree: wp.uint64,
    lowers: wp.array(dtype=wp.vec3),
    uppers: wp.array(dtype=wp.vec3),
    counts: wp.array(dtype=int),
):
    """Count the edges of each body that go through a triangle that it is kept apart from."""
    panels = members.panels.shape[0]
    tid = w * panels + wp.tid()
    panel = panel_of(members, wp.tid(), w)
    own = members.surfaces[panel.surface]
    query = wp.bvh_query_aabb(tree, lowers[tid], uppers[tid], wp.bvh_get_group_root(tree, w))
    found = int(0)
    while wp.bvh_query_next(query, found):
        other = panel_of(members, found - w * panels, w)
        if may_touch(members, panel.body, other.body):
            of_other = members.surfaces[other.surface]
            a, b = place(of_other, other.corners[0]), place(of_other, other.corners[1])
            c = place(of_other, other.corners[2])
            for side in range(3):
                p, q = panel.corners[side], panel.corners[(side + 1) % 3]
                shared = bool(False)
                for k in range(3):
                    shared = shared or p == other.corners[k] or q == other.corners[k]
                apart = other.body != panel.body or not shared
                if apart and (panel.own >> (3 + side)) & 1 == 1 and crosses(place(own, p), place(own, q), a, b, c):
                    wp.atomic_add(counts, panel.body, 1)


class Search:
    """Looks for pairs in all worlds; `pairs` are what was found last."""

    def __init__(self, members: Members, crew: Crew, device: wp.Device) -> None:
        self._members, self._device = members, device
        self._panels, worlds = members.panels.shape[0], members.worlds
        total = worlds * self._panels
        self._width = 1 if device.is_cpu else max(32 * _TEAM, _THREADS // worlds)
        self._boxes = [wp.zeros(total, dtype=wp.vec3, device=device) for _ in range(2)]
        groups = np.repeat(np.arange(worlds, dtype=np.int32), self._panels)
        self._groups = wp.array(groups, dtype=int, device=device)
        self._crossings = wp.zeros(len(members.bodies), dtype=int, device=device)
        self._tree = wp.Bvh(*self._boxes, groups=self._groups)
        self._age = 0
        self.pairs = Pairs()
        self.pairs.couples = wp.zeros((worlds, _COUPLES_A_PANEL * self._panels), dtype=wp.vec2i, device=device)
        room = (worlds, PAIRS_A_PANEL * self._panels)
        self.pairs.parts = wp.zeros(room, dtype=wp.vec4i, device=device)
        self.pairs.kept = wp.zeros(room, dtype=float, device=device)
        self.pairs.starts = wp.zeros(room, dtype=float, device=device)
        self.pairs.sums = wp.zeros((worlds, 4), dtype=wp.int64, device=device)
        self.pairs.rounds = wp.zeros(ROUNDS, dtype=int, device=device)
        self.pairs.sides = wp.zeros(room, dtype=wp.vec2i, device=device)
        self.pairs.counts = wp.zeros((worlds, 2), dtype=int, device=device)
        self.pairs.clock = wp.zeros(4, dtype=int, device=device)
        self._due = self.pairs.clock[2:3]
        self.pairs.folded = wp.ones(2, dtype=int, device=device)
        self.pairs.turns = wp.zeros(worlds * len(members.bodies), dtype=wp.mat33, device=device)
        self.pairs.strays = wp.array([FAR, MOST], dtype=float, device=device)
        self.pairs.ways = wp.zeros(total, dtype=Way, device=device)
        self.pairs.failed = wp.zeros(total, dtype=bool, device=device)
        self.pairs.balls = wp.zeros(total, dtype=wp.vec4, device=device)
        self.pairs.drifts = wp.zeros(total, dtype=wp.vec3, device=device)
        self._looks = [recorded(look, members, self.pairs, ends, crew=crew, device=device) for ends in (False, True)]

    def begin(self) -> None:
        """Before a frame: now and then the tree is built anew, as its boxes have moved."""
        if self._age % _EVERY == 0:
            self._enclose_all(False)
            self._tree.rebuild()
        self._age += 1

    def look(self, ends: bool) -> None:
        """List the pairs that may meet, where the last list does not hold for a substep that ends, or that begins now.

        The list then holds for the way of this substep too, whatever pushes a particle.
        """
        self._looks[ends].launch()
        wp.capture_if(self._due, self._find, ends=ends)

    def _find(self, ends: bool) -> None:
        self._launch(_foresee, len(self._groups), self._members, self.pairs, ends)
        wp.capture_while(self._due, self._list)

    def _list(self) -> None:
        self._enclose_all(True)
        self._tree.refit()
        self.pairs.counts.zero_()
        self._launch(_couple, len(self._groups), self._members, self.pairs, self._tree.id, *self._boxes)
        team = 1 if self._device.is_cpu else _TEAM
        self._launch(_pair, self._members.worlds * self._width, self._members, self.pairs, self._width, team)
        self._launch(_accept, 1, self.pairs)

    def _launch(self, kernel: wp.Kernel, dim: int, *inputs: Any) -> None:
        wp.launch(kernel, dim=dim, inputs=list(inputs), device=self._device)

    def found(self, world: int) -> tuple[int, int]:
        """How many pairs are listed in a world, and how many couples and pairs found no room."""
        couples, pairs = self.pairs.counts.numpy()[world].tolist()
        room = self.pairs.parts.shape[1]
        return min(pairs, room), max(0, pairs - room) + max(0, couples - self.pairs.couples.shape[1])

    def crossings(self, world: int) -> list[int]:
        """How many edges of each body go through a triangle that it is kept apart from now, in one world."""
        self._enclose_all(False)
        self._tree.refit()
        self._crossings.zero_()
        self._launch(_cross, self._panels, self._members, world, self._tree.id, *self._boxes, self._crossings)
        return self._crossings.numpy().tolist()

    def _enclose_all(self, ahead: bool) -> None:
        self._launch(_enclose, len(self._groups), self._members, self.pairs, ahead, *self._boxes)
