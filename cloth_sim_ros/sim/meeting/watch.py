# SPDX-License-Identifier: Apache-2.0
"""Whether the list of pairs still holds: while no particle is off its way by more than the slack."""

import warp as wp

from cloth_sim_ros.sim.intrinsics import load_row, xyz
from cloth_sim_ros.sim.meeting.cooperative import Crew, cooperative, number_of, sync_all
from cloth_sim_ros.sim.meeting.flat import judge
from cloth_sim_ros.sim.meeting.pairs import Pairs, slack
from cloth_sim_ros.sim.meeting.surfaces import Members, Panel, Surface, panel_of, place, velocity

_LONGEST = 400  # substeps that a list holds at most
# Of the mean length of springs, that a particle may be off its way. At least: where much is near, and where hardly
# anything is, as a longer list costs nothing there. At most: a few particles tremble far more than all others, and
# shall not have everything looked for anew.
NEAR, FAR, MOST = 0.05, 0.15, 4.0


@wp.func
def has_failed(panel: Panel) -> bool:
    """Whether it is a triangle that tore."""
    return panel.corners[0] == panel.corners[1]


@wp.func
def goes(surface: Surface, i: int, ends: bool) -> wp.vec3:
    """At which velocity a particle goes: in the substep that ends, or until the next one begins [m/s]."""
    if ends:
        return xyz(load_row(surface.displacements, i) - load_row(surface.low, i)) / surface.frames[0].dt
    return velocity(surface, i)


@wp.func
def _watch(members: Members, pairs: Pairs, p: int, w: int, ends: bool):
    """A search is due where a particle is off its way, or ends this substep off it, or a triangle is torn."""
    panel = panel_of(members, p, w)
    surface = members.surfaces[panel.surface]
    dt = surface.frames[0].dt
    time = float(pairs.clock[0]) * dt
    if has_failed(panel) != pairs.failed[w * members.panels.shape[0] + p]:
        pairs.clock[2] = 1
    for q in range(3):
        if (panel.own >> q) & 1 == 1:
            i = panel.corners[q]
            off = place(surface, i) - xyz(load_row(surface.seen, i)) - time * surface.going[i]
            most = wp.length(off)
            if ends:
                most = wp.max(most, wp.length(off + dt * (goes(surface, i, ends) - surface.going[i])))
            if not most <= slack(members, pairs, surface, panel.body, i):
                pairs.clock[2] = 1


@wp.func
def _decide(pairs: Pairs, panels: int, ends: bool):
    """Whether to search now, and for how many substeps: twice as many as the last list held."""
    age = pairs.clock[0]
    if pairs.clock[2] == 1 or age >= pairs.clock[1]:
        pairs.clock[1] = wp.clamp(2 * age, 4, wp.static(_LONGEST))
        pairs.clock[2] = 1
        pairs.clock[3] = age
        age = 0
        most = int(0)
        for w in range(pairs.counts.shape[0]):
            most = wp.max(most, pairs.counts[w, 1])
        pairs.strays[0] = wp.where(8 * most < panels, wp.static(FAR), wp.static(NEAR))
        pairs.strays[1] = wp.min(2.0 * pairs.strays[1], wp.static(MOST))
    pairs.clock[0] = age + wp.where(ends, 1, 0)


@cooperative
def look(members: Members, pairs: Pairs, ends: bool, crew: Crew):
    """Find out whether anything is folded, and whether the list still holds then."""
    number = number_of(wp.tid(), crew)
    team = number / crew.width
    t = number - team * crew.width
    if ends and members.flattens:
        for w in range(team, members.worlds, crew.teams):
            for p in range(t, members.panels.shape[0], crew.width):
                judge(members, pairs, p, w, True)
        sync_all(crew)
    if pairs.folded[0] == 0:
        return
    for w in range(team, members.worlds, crew.teams):
        for p in range(t, members.panels.shape[0], crew.width):
            _watch(members, pairs, p, w, ends)
    for round in range(number, pairs.rounds.shape[0], crew.width * crew.teams):
        pairs.rounds[round] = 0
    sync_all(crew)
    if number == 0:
        _decide(pairs, members.panels.shape[0], ends)
