# SPDX-License-Identifier: Apache-2.0
"""Find the panels that need a new search: those with a particle farther from its path than the slack."""

import warp as wp

from cloth_sim_ros.sim.features.self_contact.ccd_clamp import measure
from cloth_sim_ros.sim.features.self_contact.early_out import judge
from cloth_sim_ros.sim.features.self_contact.pairs import (
    AGAIN,
    AGE,
    DUE,
    EAGER,
    HOLDS,
    WAS,
    WHOLE,
    Pairs,
    empty,
    forget,
    slack,
)
from cloth_sim_ros.sim.features.self_contact.surfaces import Members, Panel, Surface, dt_of, panel_of, place, velocity
from cloth_sim_ros.sim.kernels.cooperative import CooperativeGroup, cooperative, number_of, sync_all
from cloth_sim_ros.sim.kernels.intrinsics import load_row, xyz

_LONGEST = 400  # largest number of substeps for which a path is straight
_MANY = 0.5  # share of all panels; if more need a search, all panels are searched


@wp.func
def has_failed(panel: Panel) -> bool:
    """Return True if the panel is a triangle that tore."""
    return panel.corners[0] == panel.corners[1]


@wp.func
def goes(surface: Surface, i: int, ends: bool) -> wp.vec3:
    """Return the velocity of a particle [m/s], in the substep that ends or until the next one begins."""
    if ends:
        return xyz(load_row(surface.displacements, i) - load_row(surface.position_lo, i)) / dt_of(surface)
    return velocity(surface, i)


@wp.func
def farthest(surface: Surface, panel: Panel) -> float:
    """Return the largest distance of a panel's corners from their paths [m]."""
    a, b = surface.off_path[panel.corners[0]], surface.off_path[panel.corners[1]]
    c = surface.off_path[panel.corners[2]]
    return wp.max(a, wp.max(b, c))


@wp.func
def _watch(members: Members, pairs: Pairs, p: int, w: int, ends: bool):
    """Measure how far particles are from their paths, also at the end of this substep if `ends`."""
    panel = panel_of(members, p, w)
    surface = members.surfaces[panel.surface]
    dt = dt_of(surface)
    time = float(pairs.clock[AGE]) * dt
    if dt != pairs.step[0] or has_failed(panel) != pairs.failed[w * members.panels.shape[0] + p]:
        pairs.clock[HOLDS] = 0
        pairs.clock[DUE] = 1
    for q in range(3):
        if (panel.own >> q) & 1 == 1:
            i = panel.corners[q]
            off = place(surface, i) - surface.path_starts[i] - time * surface.path_velocities[i]
            most = wp.length(off)
            if ends:
                most = wp.max(most, wp.length(off + dt * (goes(surface, i, ends) - surface.path_velocities[i])))
            surface.off_path[i] = most
            if not most <= slack(members, surface, panel.body):
                pairs.clock[DUE] = 1


@wp.func
def _mark(members: Members, pairs: Pairs, p: int, w: int):
    """Measure how far panel p is off its path, and mark it for the search if one is due."""
    panel, t = panel_of(members, p, w), w * members.panels.shape[0] + p
    surface = members.surfaces[panel.surface]
    pairs.off[t] = farthest(surface, panel)
    pairs.astray[t] = not pairs.off[t] <= wp.static(EAGER) * slack(members, surface, panel.body)
    if pairs.astray[t] and pairs.clock[DUE] == 1:
        wp.atomic_add(pairs.clock, wp.static(AGAIN), 1)


@wp.func
def _decide(members: Members, pairs: Pairs, age: int, ends: bool):
    """Decide if all panels are searched, and for how many substeps paths are straight then.

    That number doubles each time the last one held.
    """
    panels, worlds = members.panels.shape[0], pairs.counts.shape[0]
    many = float(pairs.clock[AGAIN]) > wp.static(_MANY) * float(panels * worlds)
    pairs.clock[DUE] = 1
    pairs.clock[WHOLE] = wp.where(many or age >= pairs.clock[HOLDS], 1, 0)
    pairs.clock[WAS] = age
    if pairs.clock[WHOLE] == 1:
        pairs.clock[HOLDS] = wp.clamp(wp.where(many, age, 2 * age), 4, wp.static(_LONGEST))
        pairs.clock[AGAIN] = 0
    empty(pairs)
    pairs.clock[AGE] = wp.where(pairs.clock[WHOLE] == 1, 0, age) + wp.where(ends, 1, 0)


@wp.func
def _look(members: Members, pairs: Pairs, ends: bool, number: int, group: CooperativeGroup):
    """Find the panels to search again, and forget their pairs; called by all threads."""
    team = number / group.width
    t = number - team * group.width
    age = pairs.clock[AGE]
    for w in range(team, members.worlds, group.teams):
        for p in range(t, members.panels.shape[0], group.width):
            _watch(members, pairs, p, w, ends)
    sync_all(group)
    if number == 0:
        pairs.step[0] = dt_of(members.surfaces[0])
    for w in range(team, members.worlds, group.teams):
        for p in range(t, members.panels.shape[0], group.width):
            _mark(members, pairs, p, w)
            if ends:
                measure(members, pairs, p, w)
    if pairs.clock[DUE] == 0 and age < pairs.clock[HOLDS]:
        if number == 0 and ends:
            pairs.clock[AGE] = age + 1
        return
    sync_all(group)
    if number == 0:
        _decide(members, pairs, age, ends)
    sync_all(group)
    if pairs.clock[WHOLE] == 0:
        for w in range(team, members.worlds, group.teams):
            forget(pairs, w, t, group.width)


@cooperative
def look(members: Members, pairs: Pairs, ends: bool, group: CooperativeGroup):
    """Find out if anything is folded, and if so, the panels to search again."""
    number = number_of(wp.tid(), group)
    team = number / group.width
    t = number - team * group.width
    if ends and members.flattens:
        for w in range(team, members.worlds, group.teams):
            for p in range(t, members.panels.shape[0], group.width):
                judge(members, pairs, p, w, True)
        sync_all(group)
    if pairs.folded[0] == 0:
        return
    for round in range(number, pairs.rounds.shape[0], group.width * group.teams):
        pairs.rounds[round] = 0
    _look(members, pairs, ends, number, group)
