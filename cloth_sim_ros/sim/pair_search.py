# SPDX-License-Identifier: Apache-2.0
"""Which parts of one object may meet soon, and which have come through one another.

Each panel has a box around its way to come at the speed that it has, with a margin as that speed may change.
Warp's tree of boxes finds those that overlap, and of these the corners, triangles and edges that may meet are listed.
What is nearer at rest than it would be kept apart is left out.
"""

import math

import numpy as np
import warp as wp

from cloth_sim_ros.sim.intrinsics import load_row, xyz
from cloth_sim_ros.sim.model import Body
from cloth_sim_ros.sim.stages.self_contact import PAIRS_A_PANEL, meeting_of
from cloth_sim_ros.sim.state import Arrays

_TESTS = 15  # of two triangles: three corners of each against the other, and nine pairs of sides
_EVERY = 64  # frames after which the tree is built anew; until then its boxes are fitted


@wp.func
def _corners(panels: wp.array(dtype=wp.vec3i), k: int, first: int) -> wp.vec3i:
    """The particles of panel k of a body whose first is `first`; a segment has its second one twice."""
    corners = panels[k]
    return wp.vec3i(first + corners[0], first + corners[1], first + wp.where(corners[2] < 0, corners[1], corners[2]))


@wp.func
def _crosses(p: wp.vec3, q: wp.vec3, a: wp.vec3, b: wp.vec3, c: wp.vec3) -> bool:
    """Whether the segment p q goes through the triangle a b c."""
    n = wp.cross(b - a, c - a)
    from_p, from_q = wp.dot(n, p - a), wp.dot(n, q - a)
    if from_p * from_q >= 0.0:
        return False
    x = p + (from_p / (from_p - from_q)) * (q - p)
    u = wp.dot(n, wp.cross(b - a, x - a))
    v = wp.dot(n, wp.cross(c - b, x - b))
    w = wp.dot(n, wp.cross(a - c, x - c))
    return (u > 0.0 and v > 0.0 and w > 0.0) or (u < 0.0 and v < 0.0 and w < 0.0)


@wp.func
def _margin(speed: float, time: float, gravity: wp.vec3) -> float:
    """How far a panel of this speed may get from where it would be without forces [m]: it may be stopped."""
    return time * (speed + 0.5 * time * wp.length(gravity))


@wp.func
def _speed(velocities: wp.array(dtype=wp.vec4), corners: wp.vec3i) -> float:
    """The largest speed of a panel's corners [m/s]."""
    speed = float(0.0)
    for q in range(3):
        speed = wp.max(speed, wp.length(xyz(load_row(velocities, corners[q]))))
    return speed


@wp.kernel(enable_backward=False)
def _enclose(
    worlds: wp.array(dtype=Arrays),
    panels: int,
    ahead: int,
    lowers: wp.array(dtype=wp.vec3),
    uppers: wp.array(dtype=wp.vec3),
):
    """The boxes of all panels over `ahead` substeps to come."""
    w = wp.tid() / panels
    k = wp.tid() - w * panels
    arrays = worlds[w]
    time = float(ahead) * arrays.frames[0].dt
    b = arrays.model.panel_parts[k][0]
    corners = _corners(arrays.model.panels, k, arrays.model.bodies[b].particles)
    low, high = wp.vec3(1.0e30), wp.vec3(-1.0e30)
    for q in range(3):
        x = xyz(load_row(arrays.state.positions, corners[q]))
        v = xyz(load_row(arrays.state.velocities, corners[q]))
        low = wp.min(low, wp.min(x, x + time * v))
        high = wp.max(high, wp.max(x, x + time * v))
    margin = _margin(_speed(arrays.state.velocities, corners), time, arrays.frames[0].gravity)
    if ahead > 0:
        margin += arrays.materials[b].thickness
    lowers[wp.tid()] = low - wp.vec3(margin)
    uppers[wp.tid()] = high + wp.vec3(margin)


@wp.func
def _in_body(parts: wp.vec4i, body: Body) -> wp.vec4i:
    """The same with particles counted from the first of the body."""
    first = body.particles
    return wp.vec4i(
        parts[0] + wp.where(parts[0] < 0, first, -first), parts[1] - first, parts[2] - first, parts[3] - first
    )


@wp.func
def _parts(test: int, a: wp.vec3i, b: wp.vec3i, own: wp.vec2i) -> wp.vec4i:
    """The particles of a test of two panels: a corner and a triangle, or, with -1 - the first of them, two edges. The
    last is -1 where another pair of panels has this test, there is no such triangle, or the parts share a particle."""
    place = test % 3
    if test < 6:
        mine, corner, face = own[0], a[place], b
        if test >= 3:
            mine, corner, face = own[1], b[place], a
        has = (mine >> place) & 1 == 1 and face[1] != face[2]
        has = has and corner != face[0] and corner != face[1] and corner != face[2]
        return wp.vec4i(corner, face[0], face[1], wp.where(has, face[2], -1))
    side = (test - 6) / 3
    p, q, r, s = a[side], a[(side + 1) % 3], b[place], b[(place + 1) % 3]
    has = (own[0] >> (3 + side)) & 1 == 1 and (own[1] >> (3 + place)) & 1 == 1
    has = has and p != r and p != s and q != r and q != s
    return wp.vec4i(-1 - p, q, r, wp.where(has, s, -1))


@wp.struct
class Moving:
    """The rows of particles of a world: handed on alone, since all arrays of a world are thousands of bytes."""

    positions: wp.array(dtype=wp.vec4)
    velocities: wp.array(dtype=wp.vec4)


@wp.func
def _may_meet(moving: Moving, parts: wp.vec4i, reach: float, time: float) -> bool:
    """Whether two parts come nearer than `reach` [m] within a time [s] at the speeds that they have."""
    is_corner = parts[0] >= 0
    first = wp.where(is_corner, parts[0], -1 - parts[0])
    a, b = xyz(load_row(moving.positions, first)), xyz(load_row(moving.positions, parts[1]))
    c, d = xyz(load_row(moving.positions, parts[2])), xyz(load_row(moving.positions, parts[3]))
    w = meeting_of(is_corner, a, b, c, d).weights
    v = xyz(load_row(moving.velocities, first))
    apart = float(0.0)
    for k in range(1, 4):
        apart = wp.max(apart, wp.length(xyz(load_row(moving.velocities, parts[k])) - v))
    if not is_corner:  # the second end of the first edge is on its side
        apart *= 2.0
    return wp.length(w[0] * a + w[1] * b + w[2] * c + w[3] * d) < reach + time * apart


@wp.func
def _balls_meet(moving: Moving, a: wp.vec3i, b: wp.vec3i, reach: float, time: float) -> bool:
    """The same of the balls around two panels."""
    middle_a, middle_b, speed_a, speed_b = wp.vec3(0.0), wp.vec3(0.0), wp.vec3(0.0), wp.vec3(0.0)
    for k in range(3):
        middle_a += xyz(load_row(moving.positions, a[k])) / 3.0
        middle_b += xyz(load_row(moving.positions, b[k])) / 3.0
        speed_a += xyz(load_row(moving.velocities, a[k])) / 3.0
        speed_b += xyz(load_row(moving.velocities, b[k])) / 3.0
    radius_a, radius_b = float(0.0), float(0.0)
    for k in range(3):
        off = wp.length(xyz(load_row(moving.positions, a[k])) - middle_a)
        radius_a = wp.max(radius_a, off + time * wp.length(xyz(load_row(moving.velocities, a[k])) - speed_a))
        off = wp.length(xyz(load_row(moving.positions, b[k])) - middle_b)
        radius_b = wp.max(radius_b, off + time * wp.length(xyz(load_row(moving.velocities, b[k])) - speed_b))
    return wp.length(middle_a - middle_b) < radius_a + radius_b + reach + time * wp.length(speed_a - speed_b)


@wp.func
def _are_neighbours(rest: wp.array(dtype=wp.vec3), parts: wp.vec4i, near: float) -> bool:
    """Whether two parts are nearer than `near` [m] in the rest shape."""
    first = wp.where(parts[0] >= 0, parts[0], -1 - parts[0])
    a, b = rest[first], rest[parts[1]]
    c, d = rest[parts[2]], rest[parts[3]]
    w = meeting_of(parts[0] >= 0, a, b, c, d).weights
    return wp.length(w[0] * a + w[1] * b + w[2] * c + w[3] * d) < near


@wp.kernel(enable_backward=False)
def _pair(
    worlds: wp.array(dtype=Arrays),
    panels: int,
    ahead: int,
    tree: wp.uint64,
    lowers: wp.array(dtype=wp.vec3),
    uppers: wp.array(dtype=wp.vec3),
):
    """List the pairs of parts of panels whose boxes overlap, each once."""
    tid = wp.tid()
    w = tid / panels
    k = tid - w * panels
    arrays = worlds[w]
    b = arrays.model.panel_parts[k][0]
    body = arrays.model.bodies[b]
    room = wp.static(PAIRS_A_PANEL) * (body.panels_end - body.panels)
    corners = _corners(arrays.model.panels, k, body.particles)
    time, thickness = float(ahead) * arrays.frames[0].dt, 2.0 * arrays.materials[b].thickness
    moving = Moving()
    moving.positions = arrays.state.positions
    moving.velocities = arrays.state.velocities
    rest, gravity = arrays.model.rest, arrays.frames[0].gravity
    panel_parts, listed, counts = arrays.model.panel_parts, arrays.state.pairs, arrays.state.pair_counts
    faces = arrays.model.panels
    margin = _margin(_speed(moving.velocities, corners), time, gravity)
    near = 1.01 * thickness + 1.0e-3 * body.spacing
    query = wp.bvh_query_aabb(
        tree, lowers[tid], uppers[tid], wp.bvh_get_group_root(tree, w * arrays.model.bodies.shape[0] + b)
    )
    found = int(0)
    while wp.bvh_query_next(query, found):
        if found > tid:
            others = _corners(faces, found - w * panels, body.particles)
            reach = thickness + margin + _margin(_speed(moving.velocities, others), time, gravity)
            own = wp.vec2i(panel_parts[k][1], panel_parts[found - w * panels][1])
            q = int(0)
            if not _balls_meet(moving, corners, others, reach, time):
                q = wp.static(_TESTS)
            while q < wp.static(_TESTS):
                parts = _parts(q, corners, others, own)
                if parts[3] >= 0 and _may_meet(moving, parts, reach, time) and not _are_neighbours(rest, parts, near):
                    n = wp.atomic_add(counts, b, 1)
                    if n < room:
                        listed[wp.static(PAIRS_A_PANEL) * body.panels + n] = _in_body(parts, body)
                q += 1


@wp.kernel(enable_backward=False)
def _cross(
    worlds: wp.array(dtype=Arrays),
    panels: int,
    w: int,
    first: int,
    tree: wp.uint64,
    lowers: wp.array(dtype=wp.vec3),
    uppers: wp.array(dtype=wp.vec3),
    count: wp.array(dtype=int),
):
    """Count the sides of panels from `first` on that go through a triangle of the same body."""
    k = first + wp.tid()
    arrays = worlds[w]
    parts = arrays.model.panel_parts[k]
    positions, faces, own = arrays.state.positions, arrays.model.panels, arrays.model.bodies[parts[0]].particles
    corners = _corners(faces, k, own)
    root = wp.bvh_get_group_root(tree, w * arrays.model.bodies.shape[0] + parts[0])
    query = wp.bvh_query_aabb(tree, lowers[w * panels + k], uppers[w * panels + k], root)
    found = int(0)
    while wp.bvh_query_next(query, found):
        other = _corners(faces, found - w * panels, own)
        a = xyz(load_row(positions, other[0]))
        b = xyz(load_row(positions, other[1]))
        c = xyz(load_row(positions, other[2]))
        for side in range(3):
            p, q = corners[side], corners[(side + 1) % 3]
            apart = p != other[0] and p != other[1] and p != other[2]
            apart = apart and q != other[0] and q != other[1] and q != other[2]
            if apart and (parts[1] >> (3 + side)) & 1 == 1:
                if _crosses(xyz(load_row(positions, p)), xyz(load_row(positions, q)), a, b, c):
                    wp.atomic_add(count, 0, 1)


def searches_of(spacing: float) -> int:
    """How often a frame pairs are looked for, where a launch is less than that.

    At 60 frames a second what comes at 8 m/s moves by a spacing [m] in between, so that few pairs are listed in vain.
    """
    return max(4, math.ceil(8.0 / 60.0 / spacing))


class PairSearch:
    """Looks for pairs in all bodies and worlds of a batch.

    states: the arrays of the batch.
    """

    def __init__(self, worlds: list[Arrays], states: dict[str, wp.array], device: wp.Device) -> None:
        model = worlds[0].model
        self._worlds = wp.array(worlds, dtype=Arrays, device=device)
        self._states, self._device = states, device
        self._panels, bodies = model.panels.shape[0], model.bodies.shape[0]
        total = len(worlds) * self._panels
        self._boxes = [wp.zeros(total, dtype=wp.vec3, device=device) for _ in range(2)]
        groups = np.add.outer(bodies * np.arange(len(worlds)), model.panel_parts.numpy()[:, 0])
        self._groups = wp.array(groups.ravel(), dtype=int, device=device)
        self._count = wp.zeros(1, dtype=int, device=device)
        self._tree = wp.Bvh(*self._boxes, groups=self._groups)
        self._age = 0

    def begin(self) -> None:
        """Before a frame: now and then the tree is built anew, as its boxes have moved."""
        if self._age % _EVERY == 0:
            self._enclose_all(0)
            self._tree.rebuild()
        self._age += 1

    def find(self, ahead: int) -> None:
        """List the pairs of `ahead` substeps to come."""
        self._enclose_all(ahead)
        self._tree.refit()
        self._states["pair_counts"].zero_()
        inputs = [self._worlds, self._panels, ahead, self._tree.id, *self._boxes]
        wp.launch(_pair, dim=self._boxes[0].shape[0], inputs=inputs, device=self._device)

    def crossings(self, world: int, panels: slice) -> int:
        """How many edges of a body of these panels go through a triangle of it now, in one world."""
        self._enclose_all(0)
        self._tree.refit()
        self._count.zero_()
        inputs = [self._worlds, self._panels, world, panels.start, self._tree.id, *self._boxes, self._count]
        wp.launch(_cross, dim=panels.stop - panels.start, inputs=inputs, device=self._device)
        return int(self._count.numpy()[0])

    def _enclose_all(self, ahead: int) -> None:
        inputs = [self._worlds, self._panels, ahead, *self._boxes]
        wp.launch(_enclose, dim=self._boxes[0].shape[0], inputs=inputs, device=self._device)
