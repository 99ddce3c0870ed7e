"""The springs of a cell of a grid (sim/cells.py), two at a time in registers. The hottest loop of a cloth: count its
operations, and keep branches out of it, so that two roots and two divisions are under way at once."""

import warp as wp

from cloth_sim_ros.sim.cells import DIAGONALS, FLAGS, SIDES
from cloth_sim_ros.sim.model import Body, Model
from cloth_sim_ros.sim.physics.distance import SHORTEST, elongation, opened, pull_along
from cloth_sim_ros.sim.physics.integrate import Step
from cloth_sim_ros.sim.schedules.native import load4, load4i, root, store_xyz
from cloth_sim_ros.sim.state import Material, State, compliance_of
from cloth_sim_ros.sim.topology import KINDS

_SHEAR, _BENDING = KINDS.index("shear"), KINDS.index("bending")
_SOFT = wp.constant(1.0e-20)  # [1/kg] keeps the divisor of a rigid spring between pinned particles from 0



@wp.func
def record_of(m: Model, k: int) -> wp.vec4i:
    """The record of cell k, or of the last if there are not so many, to be fetched ahead of its use."""
    return load4i(m.cells, wp.min(k, m.cells.shape[0] - 1))


@wp.func
def has(flags: int, q: int) -> bool:
    return (flags >> (wp.static(FLAGS) + q)) & 1 == 1


@wp.struct
class Corner:
    """One particle of a cell: its index, position and displacement [m], and the inverse mass [1/kg]."""

    i: int
    x: wp.vec4
    d: wp.vec4


@wp.struct
class Corners:
    """The particles of a cell."""

    a: Corner
    b: Corner
    c: Corner
    e: Corner


@wp.func
def corner(i: int, x: wp.uint64, d: wp.uint64) -> Corner:
    found = Corner()
    found.i = i
    found.x = load4(x, i)
    found.d = load4(d, i)
    return found


@wp.func
def index_of(word: int) -> int:
    return word & wp.static((1 << FLAGS) - 1)


@wp.func
def corners_of(record: wp.vec4i, x: wp.uint64, d: wp.uint64) -> Corners:
    q = Corners()
    q.a = corner(index_of(record[0]), x, d)
    q.b = corner(index_of(record[1]), x, d)
    q.c = corner(index_of(record[2]), x, d)
    q.e = corner(index_of(record[3]), x, d)
    return q


@wp.func
def put_corners(q: Corners, d: wp.uint64):
    store_xyz(d, q.a.i, q.a.d)
    store_xyz(d, q.b.i, q.b.d)
    if q.c.i != q.a.i:  # a lone spring is a cell of two particles, each there twice
        store_xyz(d, q.c.i, q.c.d)
        store_xyz(d, q.e.i, q.e.d)


@wp.func
def moved(d: wp.vec4, share: float, e: wp.vec3) -> wp.vec4:
    """A displacement and its share of a correction along e; the inverse mass, its fourth number, stays."""
    return wp.vec4(d[0] + share * e[0], d[1] + share * e[1], d[2] + share * e[2], d[3])


@wp.struct
class Two:
    """Of two springs: the edges [m], their squares, and what both ask for along them, times the mass [kg]."""

    first: wp.vec3
    second: wp.vec3
    first_square: float
    second_square: float
    first_pull: float
    second_pull: float


@wp.func
def both_opened(e: wp.vec3, f: wp.vec3, slot: int, next: int) -> Two:
    """Two edges; one without a length opens (physics/distance.py)."""
    edges = Two()
    edges.first = e
    edges.second = f
    edges.first_square = wp.dot(e, e)
    edges.second_square = wp.dot(f, f)
    if wp.min(edges.first_square, edges.second_square) >= SHORTEST * SHORTEST:
        return edges
    edges.first = opened(e, slot)
    edges.second = opened(f, next)
    edges.first_square = wp.dot(edges.first, edges.first)
    edges.second_square = wp.dot(edges.second, edges.second)
    return edges


def make_slip(order: int):
    """By how much a spring became longer in this substep [m], as its dashpot sees it."""

    @wp.func
    def slip_of(e: wp.vec3, length: float, i: Corner, j: Corner, s: State, body: Body, step: Step) -> float:
        # A dashpot must not see the rounding that displacements carry: divided by a small step it is a speed.
        g = body.particles
        de = (j.d - i.d) - (s.low[g + j.i] - s.low[g + i.i])
        slip = elongation(e, wp.vec3(de[0], de[1], de[2]))
        if wp.static(order == 2):
            if step.second:
                slip -= wp.dot(e, s.last_displacements[g + j.i] - s.last_displacements[g + i.i]) / (step.parts * length)
        return slip

    return slip_of


def make_pulls(order: int, damped: bool, remembers: bool):
    """What springs i-j and k-l ask for, which are the q-th and the next of their cell.

    Without `remembers` multipliers start from 0 and nobody reads them afterwards.
    """
    slip_of = make_slip(order)

    @wp.func
    def before(slot: int, s: State, step: Step) -> float:
        """The spring's multiplier so far in this substep."""
        if step.first:
            return 0.0
        return s.cell_multipliers[slot]

    @wp.func
    def pulls_of(
        q: int,
        record: wp.vec4i,
        cell: int,
        i: Corner,
        j: Corner,
        k: Corner,
        l: Corner,
        rest: float,
        alpha: float,
        m: Model,
        s: State,
        body: Body,
        material: Material,
        step: Step,
    ) -> Two:
        slot = q * m.cells.shape[0] + cell
        next = slot + m.cells.shape[0]
        e_alpha = wp.where(has(record[1], q), 2.0 * alpha, alpha)
        f_alpha = wp.where(has(record[1], q + 1), 2.0 * alpha, alpha)
        e = (j.x - i.x) + (j.d - i.d)
        f = (l.x - k.x) + (l.d - k.d)
        both = both_opened(wp.vec3(e[0], e[1], e[2]), wp.vec3(f[0], f[1], f[2]), slot, next)
        e_length = root(both.first_square)
        f_length = root(both.second_square)
        e_held = float(0.0)
        f_held = float(0.0)
        e_w = i.d[3] + j.d[3]
        f_w = k.d[3] + l.d[3]
        if wp.static(remembers):
            e_before = before(slot, s, step)
            f_before = before(next, s, step)
            e_held = e_alpha * e_before
            f_held = f_alpha * f_before
        if wp.static(damped):
            gamma = material.damping * step.inverse
            e_held += gamma * slip_of(both.first, e_length, i, j, s, body, step)
            f_held += gamma * slip_of(both.second, f_length, k, l, s, body, step)
            e_w *= 1.0 + gamma
            f_w *= 1.0 + gamma
        e_pull = pull_along(e_length, rest, e_held, e_w + e_alpha)
        f_pull = pull_along(f_length, rest, f_held, f_w + f_alpha)
        both.first_pull = wp.where(has(record[0], q), e_pull, 0.0)
        both.second_pull = wp.where(has(record[0], q + 1), f_pull, 0.0)
        if wp.static(remembers):
            if step.store:
                s.cell_multipliers[slot] = e_before - both.first_pull * e_length
                s.cell_multipliers[next] = f_before - both.second_pull * f_length
        return both

    return pulls_of


def make_project_corners(order: int, damped: bool, remembers: bool):
    """The projection of the springs that cells of pass `group` hold; gives the moved corners."""
    pulls_of = make_pulls(order, damped, remembers)

    @wp.func
    def project_sides(
        q: Corners,
        record: wp.vec4i,
        k: int,
        group: wp.vec4i,
        m: Model,
        s: State,
        body: Body,
        material: Material,
        step: Step,
    ) -> Corners:
        if (group[0] & wp.static(SIDES)) == 0:
            return q
        alpha = compliance_of(material, group[1]) * step.inverse_square + _SOFT
        stride = wp.where(group[1] == wp.static(_BENDING), 2.0, 1.0)
        turned = has(record[0], 6)
        rest = stride * wp.where(turned, body.cell[1], body.cell[0])
        p = pulls_of(0, record, k, q.a, q.b, q.c, q.e, rest, alpha, m, s, body, material, step)
        q.a.d = moved(q.a.d, q.a.d[3] * p.first_pull, p.first)
        q.b.d = moved(q.b.d, -q.b.d[3] * p.first_pull, p.first)
        q.c.d = moved(q.c.d, q.c.d[3] * p.second_pull, p.second)
        q.e.d = moved(q.e.d, -q.e.d[3] * p.second_pull, p.second)
        rest = stride * body.cell[1]
        p = pulls_of(2, record, k, q.a, q.c, q.b, q.e, rest, alpha, m, s, body, material, step)
        q.a.d = moved(q.a.d, q.a.d[3] * p.first_pull, p.first)
        q.c.d = moved(q.c.d, -q.c.d[3] * p.first_pull, p.first)
        q.b.d = moved(q.b.d, q.b.d[3] * p.second_pull, p.second)
        q.e.d = moved(q.e.d, -q.e.d[3] * p.second_pull, p.second)
        return q

    @wp.func
    def project_diagonals(
        q: Corners,
        record: wp.vec4i,
        k: int,
        group: wp.vec4i,
        m: Model,
        s: State,
        body: Body,
        material: Material,
        step: Step,
    ) -> Corners:
        if (group[0] & wp.static(DIAGONALS)) == 0:
            return q
        alpha = compliance_of(material, wp.static(_SHEAR)) * step.inverse_square + _SOFT
        p = pulls_of(4, record, k, q.a, q.e, q.b, q.c, body.cell[2], alpha, m, s, body, material, step)
        q.a.d = moved(q.a.d, q.a.d[3] * p.first_pull, p.first)
        q.e.d = moved(q.e.d, -q.e.d[3] * p.first_pull, p.first)
        q.b.d = moved(q.b.d, q.b.d[3] * p.second_pull, p.second)
        q.c.d = moved(q.c.d, -q.c.d[3] * p.second_pull, p.second)
        return q

    @wp.func
    def project_corners(
        q: Corners,
        record: wp.vec4i,
        k: int,
        group: wp.vec4i,
        m: Model,
        s: State,
        body: Body,
        material: Material,
        step: Step,
    ) -> Corners:
        q = project_sides(q, record, k, group, m, s, body, material, step)
        return project_diagonals(q, record, k, group, m, s, body, material, step)

    return project_corners


def make_project(order: int):
    """The projection of cell k, whose record the schedule has fetched, of pass `group`."""
    plain = make_project_corners(order, False, True)
    damped = make_project_corners(order, True, True)

    @wp.func
    def project_cell(
        record: wp.vec4i,
        k: int,
        group: wp.vec4i,
        m: Model,
        s: State,
        body: Body,
        material: Material,
        step: Step,
        x: wp.uint64,
        d: wp.uint64,
    ):
        q = corners_of(record, x, d)
        if material.damping > 0.0:
            put_corners(damped(q, record, k, group, m, s, body, material, step), d)
        else:
            put_corners(plain(q, record, k, group, m, s, body, material, step), d)

    return project_cell
