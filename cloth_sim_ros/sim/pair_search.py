# SPDX-License-Identifier: Apache-2.0
"""Which parts of one object may meet in a frame, and which have come through one another.

Each panel has a box around its way in the frame at the speed that it has, with a margin as that speed may change.
Warp's tree of boxes finds those that overlap, and of these the corners, triangles and edges that may meet are listed.
What is nearer at rest than it would be kept apart is left out.
"""

import numpy as np
import warp as wp

from cloth_sim_ros.sim.intrinsics import load_row, xyz
from cloth_sim_ros.sim.model import Body
from cloth_sim_ros.sim.stages.self_contact import PAIRS_A_PANEL, meeting_of
from cloth_sim_ros.sim.state import Arrays

_CHANGE = wp.constant(0.25)  # of its speed that a panel may lose or gain in a frame before a pair is missed
_TESTS = 15  # of two triangles: three corners of each against the other, and nine pairs of sides
_EVERY = 64  # frames after which the tree is built anew; until then its boxes are fitted


@wp.func
def _corners(arrays: Arrays, k: int) -> wp.vec3i:
    """The particles of panel k in the batch; a segment has its second one twice."""
    corners = arrays.model.panels[k]
    first = arrays.model.bodies[arrays.model.panel_parts[k][0]].particles
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
def _position(arrays: Arrays, i: int) -> wp.vec3:
    return xyz(load_row(arrays.state.positions, i))


@wp.func
def _margin(arrays: Arrays, b: int, speed: float, ahead: float) -> float:
    """How far a panel of this speed may get from where it would be without forces, over a share of the frame [m]."""
    frame = arrays.frames[0]
    time = ahead * frame.dt * float(frame.substeps)
    return time * (_CHANGE * speed + 0.5 * time * wp.length(frame.gravity))


@wp.func
def _speed(arrays: Arrays, corners: wp.vec3i) -> float:
    """The largest speed of a panel's corners [m/s]."""
    speed = float(0.0)
    for q in range(3):
        speed = wp.max(speed, wp.length(xyz(load_row(arrays.state.velocities, corners[q]))))
    return speed


@wp.kernel(enable_backward=False)
def _enclose(
    worlds: wp.array(dtype=Arrays),
    panels: int,
    ahead: float,
    lowers: wp.array(dtype=wp.vec3),
    uppers: wp.array(dtype=wp.vec3),
):
    """The boxes of all panels over a share `ahead` of the frame to come."""
    w = wp.tid() / panels
    k = wp.tid() - w * panels
    arrays = worlds[w]
    time = ahead * arrays.frames[0].dt * float(arrays.frames[0].substeps)
    corners, b = _corners(arrays, k), arrays.model.panel_parts[k][0]
    low, high = wp.vec3(1.0e30), wp.vec3(-1.0e30)
    for q in range(3):
        x = _position(arrays, corners[q])
        v = xyz(load_row(arrays.state.velocities, corners[q]))
        low = wp.min(low, wp.min(x, x + time * v))
        high = wp.max(high, wp.max(x, x + time * v))
    margin = _margin(arrays, b, _speed(arrays, corners), ahead)
    if ahead > 0.0:
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
def _parts(q: int, a: wp.vec3i, b: wp.vec3i, own: wp.vec2i) -> wp.vec4i:
    """The particles of test q of two panels: a corner and a triangle, or, with -1 - the first of them, two edges. The
    last is -1 where another pair of panels has this test, or there is no such triangle."""
    place = q % 3
    if q < 6:
        mine, corner, face = own[0], a[place], b
        if q >= 3:
            mine, corner, face = own[1], b[place], a
        has = (mine >> place) & 1 == 1 and face[1] != face[2]
        return wp.vec4i(corner, face[0], face[1], wp.where(has, face[2], -1))
    side = (q - 6) / 3
    has = (own[0] >> (3 + side)) & 1 == 1 and (own[1] >> (3 + place)) & 1 == 1
    return wp.vec4i(-1 - a[side], a[(side + 1) % 3], b[place], wp.where(has, b[(place + 1) % 3], -1))


@wp.func
def _may_meet(arrays: Arrays, parts: wp.vec4i, reach: float) -> bool:
    """Whether two parts come nearer than `reach` [m] at the speeds that they have."""
    is_corner = parts[0] >= 0
    first = wp.where(is_corner, parts[0], -1 - parts[0])
    a, b = _position(arrays, first), _position(arrays, parts[1])
    c, d = _position(arrays, parts[2]), _position(arrays, parts[3])
    w = meeting_of(is_corner, a, b, c, d).weights
    v = xyz(load_row(arrays.state.velocities, first))
    apart = float(0.0)
    for k in range(1, 4):
        apart = wp.max(apart, wp.length(xyz(load_row(arrays.state.velocities, parts[k])) - v))
    if not is_corner:  # the second end of the first edge is on its side
        apart *= 2.0
    time = arrays.frames[0].dt * float(arrays.frames[0].substeps)
    return wp.length(w[0] * a + w[1] * b + w[2] * c + w[3] * d) < reach + time * apart


@wp.func
def _are_neighbours(arrays: Arrays, parts: wp.vec4i, near: float) -> bool:
    """Whether two parts are nearer than `near` [m] in the rest shape."""
    first = wp.where(parts[0] >= 0, parts[0], -1 - parts[0])
    a, b = arrays.model.rest[first], arrays.model.rest[parts[1]]
    c, d = arrays.model.rest[parts[2]], arrays.model.rest[parts[3]]
    w = meeting_of(parts[0] >= 0, a, b, c, d).weights
    return wp.length(w[0] * a + w[1] * b + w[2] * c + w[3] * d) < near


@wp.kernel(enable_backward=False)
def _pair(
    worlds: wp.array(dtype=Arrays),
    panels: int,
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
    corners = _corners(arrays, k)
    margin, thickness = _margin(arrays, b, _speed(arrays, corners), 1.0), 2.0 * arrays.materials[b].thickness
    near = 1.01 * thickness + 1.0e-3 * body.spacing
    query = wp.bvh_query_aabb(
        tree, lowers[tid], uppers[tid], wp.bvh_get_group_root(tree, w * arrays.model.bodies.shape[0] + b)
    )
    found = int(0)
    while wp.bvh_query_next(query, found):
        if found > tid:
            others = _corners(arrays, found - w * panels)
            reach = thickness + margin + _margin(arrays, b, _speed(arrays, others), 1.0)
            own = wp.vec2i(arrays.model.panel_parts[k][1], arrays.model.panel_parts[found - w * panels][1])
            q = int(0)
            while q < wp.static(_TESTS):
                parts = _parts(q, corners, others, own)
                if parts[3] >= 0 and _may_meet(arrays, parts, reach) and not _are_neighbours(arrays, parts, near):
                    n = wp.atomic_add(arrays.state.pair_counts, b, 1)
                    if n < room:
                        arrays.state.pairs[wp.static(PAIRS_A_PANEL) * body.panels + n] = _in_body(parts, body)
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
    corners = _corners(arrays, k)
    root = wp.bvh_get_group_root(tree, w * arrays.model.bodies.shape[0] + parts[0])
    query = wp.bvh_query_aabb(tree, lowers[w * panels + k], uppers[w * panels + k], root)
    found = int(0)
    while wp.bvh_query_next(query, found):
        other = _corners(arrays, found - w * panels)
        a = xyz(arrays.state.positions[other[0]])
        b = xyz(arrays.state.positions[other[1]])
        c = xyz(arrays.state.positions[other[2]])
        for side in range(3):
            p, q = corners[side], corners[(side + 1) % 3]
            apart = p != other[0] and p != other[1] and p != other[2]
            apart = apart and q != other[0] and q != other[1] and q != other[2]
            if apart and (parts[1] >> (3 + side)) & 1 == 1:
                if _crosses(xyz(arrays.state.positions[p]), xyz(arrays.state.positions[q]), a, b, c):
                    wp.atomic_add(count, 0, 1)


class PairSearch:
    """Looks for pairs in all bodies and worlds of a batch, before each frame.

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
        self._tree: wp.Bvh | None = None
        self._age = 0

    def find(self) -> None:
        """List the pairs of the frame to come."""
        self._enclose_all(1.0)
        self._states["pair_counts"].zero_()
        inputs = [self._worlds, self._panels, self._tree.id, *self._boxes]
        wp.launch(_pair, dim=self._boxes[0].shape[0], inputs=inputs, device=self._device)

    def crossings(self, world: int, panels: slice) -> int:
        """How many edges of a body of these panels go through a triangle of it now, in one world."""
        self._enclose_all(0.0)
        self._count.zero_()
        inputs = [self._worlds, self._panels, world, panels.start, self._tree.id, *self._boxes, self._count]
        wp.launch(_cross, dim=panels.stop - panels.start, inputs=inputs, device=self._device)
        return int(self._count.numpy()[0])

    def _enclose_all(self, ahead: float) -> None:
        inputs = [self._worlds, self._panels, ahead, *self._boxes]
        wp.launch(_enclose, dim=self._boxes[0].shape[0], inputs=inputs, device=self._device)
        if self._tree is None:
            self._tree = wp.Bvh(*self._boxes, groups=self._groups)
        elif self._age % _EVERY == 0:
            self._tree.rebuild()
        else:
            self._tree.refit()
        self._age += 1
