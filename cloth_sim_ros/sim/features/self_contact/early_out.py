# SPDX-License-Identifier: Apache-2.0
"""Find sheets so flat that no part of them can touch another; these need no search.

Let F be the deformation gradient of a triangle, and R a rotation of the whole rest shape. If

    (R s) . (F s) >= m |s|^2        for all directions s, in all triangles,

two points p and q of a convex rest shape are at least m |q - p| apart in space. This is the mean value theorem along
the straight line from p to q. So parts that share no particle are apart by at least m times their distance at rest.

Particles move straight in a substep, and the condition is linear in F. If it holds at both ends of a substep with the
same R, it holds all through it.
"""

import warp as wp

from cloth_sim_ros.sim.features.self_contact.pairs import AGE, HOLDS, OF_REST, Pairs
from cloth_sim_ros.sim.features.self_contact.surfaces import Members, Surface, panel_of, place
from cloth_sim_ros.sim.kernels.compiled import compiled
from cloth_sim_ros.sim.kernels.intrinsics import load_row, xyz

_MARGIN = wp.constant(0.05)  # margin of m by which a folded sheet must be flatter to count as flat again
_ROUNDING = wp.constant(1.001)  # factor on m that covers rounding


@wp.func
def _axes(along: wp.vec3, across: wp.vec3) -> wp.mat33:
    """Return orthonormal axes in columns, the first two equally near to the two directions."""
    a, b = wp.normalize(along), wp.normalize(across)
    first, second = wp.normalize(a + b), wp.normalize(a - b)
    return wp.matrix_from_cols(first, second, wp.cross(first, second))


@compiled
def _turn(members: Members, pairs: Pairs):
    """Find the rotation of each body's rest shape that fits its far ends; reset the folded flag."""
    count = members.bodies.shape[0]
    w = wp.tid() / count
    b = wp.tid() - w * count
    if wp.tid() == 0:
        pairs.folded[1] = pairs.folded[0]
        pairs.folded[0] = 0
    surface = members.surfaces[members.bodies[b][0] * members.worlds + w]
    ends = members.ends[b] + wp.vec4i(surface.bodies[members.bodies[b][1]].particles)
    rest = _axes(surface.rest[ends[1]] - surface.rest[ends[0]], surface.rest[ends[3]] - surface.rest[ends[2]])
    along = place(surface, ends[1]) - place(surface, ends[0])
    across = place(surface, ends[3]) - place(surface, ends[2])
    pairs.turns[wp.tid()] = _axes(along, across) * wp.transpose(rest)


@wp.func
def _where(surface: Surface, i: int, ends: bool) -> wp.vec3:
    """Return the position of a particle when the substep begins or ends [m]."""
    if ends:
        return place(surface, i) + xyz(load_row(surface.displacements, i))
    return place(surface, i)


@wp.func
def judge(members: Members, pairs: Pairs, p: int, w: int, ends: bool):
    """Set the folded flag if triangle p of world w is turned so far that parts may touch.

    The test is for the beginning of a substep, or its end if `ends`.
    """
    panel = panel_of(members, p, w)
    surface = members.surfaces[panel.surface]
    turn = pairs.turns[w * members.bodies.shape[0] + panel.body]
    first, corners = panel.corners[0], panel.corners
    s, t = surface.rest[corners[1]] - surface.rest[first], surface.rest[corners[2]] - surface.rest[first]
    start = _where(surface, first, ends)
    of_s, of_t = _where(surface, corners[1], ends) - start, _where(surface, corners[2], ends) - start
    turned_s, turned_t = turn * s, turn * t
    thickness = surface.materials[members.bodies[panel.body][1]].thickness
    least = _ROUNDING * wp.min(wp.static(OF_REST), 2.0 * thickness / members.gaps[panel.body])
    if not ends and pairs.folded[1] == 1:
        least += _MARGIN
    a, c = wp.dot(turned_s, of_s) - least * wp.dot(s, s), wp.dot(turned_t, of_t) - least * wp.dot(t, t)
    b = 0.5 * (wp.dot(turned_s, of_t) + wp.dot(turned_t, of_s)) - least * wp.dot(s, t)
    if not (a > 0.0 and a * c > b * b):
        pairs.folded[0] = 1


@compiled
def _judge(members: Members, pairs: Pairs):
    panels = members.panels.shape[0]
    w = wp.tid() / panels
    judge(members, pairs, wp.tid() - w * panels, w, False)


@compiled
def _empty(pairs: Pairs):
    """Clear the lists if nothing is folded; the search then runs as soon as a sheet folds."""
    if pairs.folded[0] == 0:
        pairs.counts[wp.tid(), 0] = 0
        pairs.counts[wp.tid(), 1] = 0
        if wp.tid() == 0:
            pairs.clock[AGE] = 0
            pairs.clock[HOLDS] = 0


def early_out(members: Members, pairs: Pairs, device: wp.Device) -> list[wp.Launch]:
    """The launches that find out before a frame if a sheet of any world is folded.

    If bodies touch one another, all count as folded, and there is none.
    """
    if not members.flattens:
        return []
    panels, worlds, bodies = members.panels.shape[0], members.worlds, members.bodies.shape[0]
    return [
        wp.launch(_turn, worlds * bodies, [members, pairs], device=device, record_cmd=True),
        wp.launch(_judge, worlds * panels, [members, pairs], device=device, record_cmd=True),
        wp.launch(_empty, worlds, [pairs], device=device, record_cmd=True),
    ]
