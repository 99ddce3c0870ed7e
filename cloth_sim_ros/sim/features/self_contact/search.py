# SPDX-License-Identifier: Apache-2.0
"""Find the parts of objects that may touch soon, and count the edges that pass through triangles.

Each panel has a box around its path, predicted from its velocity, with some slack. Panels that lie side by side share
one more box, so a test can skip them together. If the boxes of two panels overlap, their corners, triangles and edges
that may touch are listed.

A list holds for some time ahead. A panel with a particle farther off its path than the slack gets a new path, and its
pairs are listed anew. So no pair is missed, however particles are pushed. Panels at rest are rarely searched.
"""

from typing import Any

import warp as wp

from cloth_sim_ros.sim.features.self_contact.boxes import (
    CLUSTER,
    Boxes,
    boxes_of,
    clusters_near,
    clusters_of,
    overlap,
    surround,
)
from cloth_sim_ros.sim.features.self_contact.broad_phase import farthest, goes, has_failed, look
from cloth_sim_ros.sim.features.self_contact.ccd_clamp import ROUNDS
from cloth_sim_ros.sim.features.self_contact.nearest import crosses
from cloth_sim_ros.sim.features.self_contact.pairs import (
    AGE,
    DUE,
    EAGER,
    HOLDS,
    TESTS,
    WAS,
    WHOLE,
    Pairs,
    Way,
    empty,
    is_due,
    list_test,
    slack,
    tests_of,
    way_of,
)
from cloth_sim_ros.sim.features.self_contact.surfaces import Members, Panel, are_sewn, dt_of, may_touch, panel_of, place
from cloth_sim_ros.sim.kernels.compiled import compiled
from cloth_sim_ros.sim.kernels.cooperative import CooperativeGroup, recorded
from cloth_sim_ros.sim.kernels.device import allocated
from cloth_sim_ros.sim.kernels.intrinsics import lowest_bit, next_place, xyz

PAIRS_A_PANEL = 64  # capacity of the list of pairs, per panel
_COUPLES_A_PANEL = 48  # capacity of the list of couples (panels whose boxes overlap), per panel
_THREADS = 1 << 17  # threads of a launch over the couples of all worlds, on a GPU
_TEAM = 4  # threads that test one couple


@compiled
def _foresee(members: Members, pairs: Pairs, ends: bool):
    """Predict paths of particles that are off theirs, or of all particles.

    A particle that trembles gets its mean velocity since the last search. All paths start at the time when all panels
    were searched. A particle that left its path since then gets a start extrapolated back to that time.
    """
    if pairs.clock[WHOLE] == 2:
        return
    panels = members.panels.shape[0]
    w = wp.tid() / panels
    panel = panel_of(members, wp.tid() - w * panels, w)
    surface = members.surfaces[panel.surface]
    dt = dt_of(surface)
    time = float(wp.max(pairs.clock[WAS], 1)) * dt
    since = float(wp.where(pairs.clock[WHOLE] == 1, 0, pairs.clock[WAS])) * dt
    most = slack(members, surface, panel.body)
    pairs.failed[wp.tid()] = has_failed(panel)
    for q in range(3):
        i = panel.corners[q]
        if (panel.own >> q) & 1 == 1:
            x = place(surface, i)
            if pairs.clock[WHOLE] == 0 and surface.off_path[i] <= wp.static(EAGER) * most:
                continue
            mean, now = (x - surface.path_starts[i]) / time, goes(surface, i, ends)
            trembles = wp.length(mean) < 0.5 * wp.length(now)
            near = dt * wp.length(mean - now) < 0.5 * most
            surface.path_velocities[i] = wp.where(trembles and near, mean, now)
            surface.off_path[i] = dt * wp.length(now - surface.path_velocities[i])
            surface.path_starts[i] = x - since * surface.path_velocities[i]


@wp.func
def _wrap(t: int, way: Way, margin: float, pairs: Pairs):
    """Compute the ball around panel t on its path, with a margin [m]; t counts through all worlds."""
    third = wp.vec3(1.0 / 3.0)
    middle, drift = third * way.x, third * way.moves
    radius = float(0.0)
    for q in range(3):
        radius = wp.max(radius, wp.length(way.x[q] - middle) + wp.length(way.moves[q] - drift))
    pairs.balls[t] = wp.vec4(middle[0], middle[1], middle[2], radius + margin)
    pairs.drifts[t] = drift


@compiled
def _enclose_ways(members: Members, pairs: Pairs, boxes: Boxes):
    """Compute the paths, balls and boxes of the panels that the search covers."""
    if not is_due(pairs, wp.tid()):
        return
    panels = members.panels.shape[0]
    w = wp.tid() / panels
    panel = panel_of(members, wp.tid() - w * panels, w)
    surface = members.surfaces[panel.surface]
    time = float(pairs.clock[HOLDS]) * dt_of(surface)  # for which paths are straight [s]
    way = way_of(members, surface, panel, wp.tid() - w * panels, time)
    margin = way.thickness + way.slack
    _wrap(wp.tid(), way, margin, pairs)
    pairs.ways[wp.tid()] = way
    pairs.off[wp.tid()] = farthest(surface, panel)
    low, high = wp.vec3(1.0e30), wp.vec3(-1.0e30)
    for q in range(3):
        low = wp.min(low, wp.min(way.x[q], way.x[q] + way.moves[q]))
        high = wp.max(high, wp.max(way.x[q], way.x[q] + way.moves[q]))
    boxes.lows[wp.tid()] = low - wp.vec3(margin)
    boxes.highs[wp.tid()] = high + wp.vec3(margin)


@compiled
def _enclose(members: Members, boxes: Boxes):
    """Compute the boxes of all panels at their current places."""
    panels = members.panels.shape[0]
    w = wp.tid() / panels
    panel = panel_of(members, wp.tid() - w * panels, w)
    surface = members.surfaces[panel.surface]
    a, b = place(surface, panel.corners[0]), place(surface, panel.corners[1])
    c = place(surface, panel.corners[2])
    boxes.lows[wp.tid()] = wp.min(a, wp.min(b, c))
    boxes.highs[wp.tid()] = wp.max(a, wp.max(b, c))


@wp.func
def _may_meet(members: Members, pairs: Pairs, boxes: Boxes, p: int, q: int, first: int) -> bool:
    """Return True if the boxes and balls of panels p and q overlap; panels of their world begin with `first`."""
    a, b = first + p, first + q
    if not overlap(boxes, a, b) or not may_touch(members, members.owners[p], members.owners[q]):
        return False
    near = pairs.balls[a][3] + pairs.balls[b][3] + wp.length(pairs.drifts[a] - pairs.drifts[b])
    return wp.length(xyz(pairs.balls[a] - pairs.balls[b])) < near


@compiled
def _couple(members: Members, pairs: Pairs, boxes: Boxes, team: int):
    """List each couple of a searched panel and one that it may touch, once; `team` threads a panel."""
    t, lane = wp.tid() / team, wp.tid() % team
    if not is_due(pairs, t):
        return
    panels = members.panels.shape[0]
    w = t / panels
    first, p = w * panels, t - w * panels
    start = wp.where(pairs.clock[WHOLE] > 0, p / wp.static(CLUSTER), 0)  # if all are searched, later ones are enough
    for c in range(start, clusters_of(panels), team):
        near = clusters_near(boxes, panels, w, t, c, lane)
        while near != wp.uint64(0):
            begin = wp.static(CLUSTER) * (c + lowest_bit(near))
            near &= near - wp.uint64(1)
            for q in range(begin + lane, wp.min(begin + wp.static(CLUSTER), panels), team):
                if q > p or (q < p and not is_due(pairs, first + q)):
                    if _may_meet(members, pairs, boxes, p, q, first):
                        n = next_place(pairs.counts[w], 0)
                        if n < pairs.couples.shape[1]:
                            pairs.couples[w, n] = wp.vec2i(wp.min(p, q), wp.max(p, q))


@compiled
def _pair(members: Members, pairs: Pairs, width: int, team: int):
    """List the parts of couples that may touch: `width` threads a world, `team` of them a couple."""
    w, panels = wp.tid() / width, members.panels.shape[0]
    t = wp.tid() - w * width
    for item in range(t / team, wp.min(pairs.counts[w, 0], pairs.couples.shape[1]), width / team):
        couple = pairs.couples[w, item]
        first, second = pairs.ways[w * panels + couple[0]], pairs.ways[w * panels + couple[1]]
        tests = tests_of(first.panel, second.panel)
        for test in range(t % team, wp.static(TESTS), team):
            if (tests >> test) & 1 == 1:
                if test < 3:
                    list_test(members, pairs, w, first, test, second, -1)
                elif test < 6:
                    list_test(members, pairs, w, second, test - 3, first, -1)
                else:
                    list_test(members, pairs, w, first, test / 3 - 2, second, test % 3)


@compiled
def _accept(pairs: Pairs, ends: bool):
    """If a list overflowed, ask for another search: first of all panels, then for a shorter time."""
    full = bool(False)
    for w in range(pairs.counts.shape[0]):
        full = full or pairs.counts[w, 0] > pairs.couples.shape[1] or pairs.counts[w, 1] > pairs.parts.shape[1]
    pairs.clock[DUE] = wp.where(full and (pairs.clock[WHOLE] == 0 or pairs.clock[HOLDS] > 1), 1, 0)
    if pairs.clock[DUE] == 1:
        if pairs.clock[WHOLE] > 0:
            pairs.clock[HOLDS] = wp.max(pairs.clock[HOLDS] / 4, 1)
        pairs.clock[WHOLE] = wp.min(pairs.clock[WHOLE] + 1, 2)
        pairs.clock[AGE] = wp.where(ends, 1, 0)
        empty(pairs)


@wp.func
def _crossed(members: Members, panel: Panel, other: Panel, w: int) -> int:
    """Return the number of own edges of a panel that pass through another panel, but for what is sewn to it."""
    own, of_other = members.surfaces[panel.surface], members.surfaces[other.surface]
    a, b = place(of_other, other.corners[0]), place(of_other, other.corners[1])
    c = place(of_other, other.corners[2])
    found = int(0)
    for side in range(3):
        p, q = panel.corners[side], panel.corners[(side + 1) % 3]
        shared = bool(False)
        for k in range(3):
            same = other.body == panel.body and (p == other.corners[k] or q == other.corners[k])
            shared = shared or same or are_sewn(members, w, panel, p, other, other.corners[k])
            shared = shared or are_sewn(members, w, panel, q, other, other.corners[k])
        if not shared and (panel.own >> (3 + side)) & 1 == 1 and crosses(place(own, p), place(own, q), a, b, c):
            found += 1
    return found


@compiled
def _cross(members: Members, w: int, boxes: Boxes, counts: wp.array(dtype=int), team: int):
    """Count the edges of each body that pass through a triangle it is kept apart from; `team` threads a panel."""
    panels = members.panels.shape[0]
    p, lane, first = wp.tid() / team, wp.tid() % team, w * panels
    panel = panel_of(members, p, w)
    for c in range(0, clusters_of(panels), team):
        near = clusters_near(boxes, panels, w, first + p, c, lane)
        while near != wp.uint64(0):
            begin = wp.static(CLUSTER) * (c + lowest_bit(near))
            near &= near - wp.uint64(1)
            for q in range(begin + lane, wp.min(begin + wp.static(CLUSTER), panels), team):
                if overlap(boxes, first + p, first + q) and may_touch(members, panel.body, members.owners[q]):
                    wp.atomic_add(counts, panel.body, _crossed(members, panel, panel_of(members, q, w), w))


class Search:
    """Search for pairs in all worlds; `pairs` holds the result of the last search."""

    def __init__(self, members: Members, group: CooperativeGroup, device: wp.Device) -> None:
        self._members, self._device = members, device
        self._panels, worlds = members.panels.shape[0], members.worlds
        total = worlds * self._panels
        self._lanes = 1 if device.is_cpu else CLUSTER  # threads that search for one panel
        self._width = 1 if device.is_cpu else max(32 * _TEAM, _THREADS // worlds)
        self._clusters = self._lanes * worlds * clusters_of(self._panels)
        # Boxes around paths, and boxes around current places.
        self._boxes, self._places = (boxes_of(worlds, self._panels, device) for _ in range(2))
        self._crossings = wp.zeros(len(members.bodies), dtype=int, device=device)
        room, couples = (worlds, PAIRS_A_PANEL * self._panels), (worlds, _COUPLES_A_PANEL * self._panels)
        shapes = {
            "couples": couples,
            "counts": (worlds, 2),
            "clock": 6,
            "step": 1,
            "sums": (worlds, 9),
            "rounds": ROUNDS,
        }
        shapes |= {"folded": 2, "turns": worlds * len(members.bodies)}
        shapes |= dict.fromkeys(("parts", "kept", "rooms", "starts", "panels"), room)
        shapes |= dict.fromkeys(("ways", "ranges", "off", "astray", "failed", "balls", "drifts"), total)
        self.pairs = allocated(Pairs, device, **shapes)
        self.pairs.folded.fill_(1)
        self._due = self.pairs.clock[DUE : DUE + 1]
        self._looks = [recorded(look, members, self.pairs, ends, group=group, device=device) for ends in (False, True)]

    def look(self, ends: bool) -> None:
        """List the pairs that may touch, if the list does not hold for a substep that ends, or that begins now.

        The list then holds for the displacement of this substep too, whatever pushes a particle.
        """
        self._looks[ends].launch()
        wp.capture_while(self._due, self._list, ends=ends)

    def _list(self, ends: bool) -> None:
        total = self.pairs.ways.shape[0]
        self._launch(_foresee, total, self._members, self.pairs, ends)
        self._launch(_enclose_ways, total, self._members, self.pairs, self._boxes)
        self._launch(surround, self._clusters, self._boxes, self._panels, self._lanes)
        self._launch(_couple, total * self._lanes, self._members, self.pairs, self._boxes, self._lanes)
        team = 1 if self._device.is_cpu else _TEAM
        self._launch(_pair, self._members.worlds * self._width, self._members, self.pairs, self._width, team)
        self._launch(_accept, 1, self.pairs, ends)

    def _launch(self, kernel: wp.Kernel, dim: int, *inputs: Any) -> None:
        wp.launch(kernel, dim=dim, inputs=list(inputs), device=self._device)

    def found(self, world: int) -> tuple[int, int]:
        """Return the number of pairs listed in a world, and the number of couples and pairs that found no room."""
        couples, pairs = self.pairs.counts.numpy()[world].tolist()
        room = self.pairs.parts.shape[1]
        return min(pairs, room), max(0, pairs - room) + max(0, couples - self.pairs.couples.shape[1])

    def crossings(self, world: int) -> list[int]:
        """Return for each body the number of its edges that pass through a triangle it is kept apart from now."""
        self._launch(_enclose, self.pairs.ways.shape[0], self._members, self._places)
        self._launch(surround, self._clusters, self._places, self._panels, self._lanes)
        self._crossings.zero_()
        self._launch(
            _cross, self._panels * self._lanes, self._members, world, self._places, self._crossings, self._lanes
        )
        return self._crossings.numpy().tolist()
