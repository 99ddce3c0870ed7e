"""The springs of a cell of a grid (sim/cells.py), in registers. The hottest loop of a cloth: count its operations, and
keep branches out of it, so that the roots and divisions of two springs are under way at once."""

import warp as wp

from cloth_sim_ros.sim.cells import ALONE, DOUBLED, EMPTY, FAR, HAS_DIAGONALS, HAS_SIDES, INDEX, PAIRS, TURNED
from cloth_sim_ros.sim.model import Body, Model
from cloth_sim_ros.sim.physics.distance import SHORTEST, elongation, opened, pull_along
from cloth_sim_ros.sim.physics.integrate import Step
from cloth_sim_ros.sim.schedules.native import load4, store_xyz
from cloth_sim_ros.sim.state import Material, State, compliance_of
from cloth_sim_ros.sim.topology import KINDS

_SOFT = wp.constant(1.0e-20)  # [1/kg] keeps the divisor of a rigid spring between pinned particles from 0


@wp.func
def has(number: int, flag: int) -> bool:
    """Whether a number of a record has a flag."""
    return (number >> flag) & 1 == 1


@wp.func
def is_empty(record: wp.vec4i) -> bool:
    return record[3] == wp.static(EMPTY)


@wp.func
def index_of(number: int) -> int:
    return number & wp.static((1 << INDEX) - 1)


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


@wp.struct
class Springs:
    """What the springs of all cells of a body share: compliances / h^2 [1/kg] of near and far sides and of diagonals,
    and the spacing of the grid, across it and along diagonals [m]."""

    near: float
    far: float
    diagonal: float
    cell: wp.vec3


@wp.func
def springs_of(body: Body, material: Material, step: Step) -> Springs:
    springs = Springs()
    springs.near = compliance_of(material, wp.static(KINDS.index("structural"))) * step.inverse_square + _SOFT
    springs.far = compliance_of(material, wp.static(KINDS.index("bending"))) * step.inverse_square + _SOFT
    springs.diagonal = compliance_of(material, wp.static(KINDS.index("shear"))) * step.inverse_square + _SOFT
    springs.cell = body.cell
    return springs


@wp.func
def corner(i: int, x: wp.uint64, d: wp.uint64) -> Corner:
    found = Corner()
    found.i = i
    found.x = load4(x, i)
    found.d = load4(d, i)
    return found


@wp.func
def corners_of(record: wp.vec4i, x: wp.uint64, d: wp.uint64) -> Corners:
    q = Corners()
    q.a = corner(index_of(record[0]), x, d)
    q.b = corner(index_of(record[1]), x, d)
    q.c = corner(record[2], x, d)
    q.e = corner(record[3], x, d)
    return q


@wp.func
def put_corners(q: Corners, d: wp.uint64):
    store_xyz(d, q.a.i, q.a.d)
    store_xyz(d, q.b.i, q.b.d)
    if q.c.i != q.a.i:  # a lone spring is a cell of two particles, each there twice
        store_xyz(d, q.c.i, q.c.d)
        store_xyz(d, q.e.i, q.e.d)


@wp.func
def edge_between(i: Corner, j: Corner) -> wp.vec3:
    e = (j.x - i.x) + (j.d - i.d)
    return wp.vec3(e[0], e[1], e[2])


Six = wp.types.vector(6, wp.float32)


@wp.func
def multipliers_of(k: int, m: Model, s: State, step: Step) -> Six:
    """Those of the springs of cell k so far in this substep, all under way at once."""
    found = Six()
    if not step.first:
        for q in range(6):
            found[q] = s.cell_multipliers[q * m.cells.shape[0] + k]
    return found


@wp.struct
class Pull:
    """What a spring asks for: along e [m], its particles move by their inverse masses times `share` [kg]."""

    e: wp.vec3
    share: float


@wp.struct
class CellSpring:
    """One spring of a cell: its particles, kind in KINDS, rest length [m], 0 where the cell lacks it, and scale."""

    i: int
    j: int
    kind: int
    rest: float
    scale: float


@wp.func
def spring_of(q: int, record: wp.vec4i, cell: wp.vec3) -> CellSpring:
    """Spring q of PAIRS of a cell of a grid with these spacings [m]."""
    spring = CellSpring()
    pair = wp.static(wp.types.matrix((6, 2), int)(*PAIRS.ravel().tolist()))
    corners = wp.vec4i(index_of(record[0]), index_of(record[1]), record[2], record[3])
    spring.i = corners[pair[q, 0]]
    spring.j = corners[pair[q, 1]]
    spring.kind = wp.static(KINDS.index("shear"))
    spring.scale = 1.0
    if q < 4:
        far = has(record[1], wp.static(FAR))
        spring.kind = wp.where(far, wp.static(KINDS.index("bending")), wp.static(KINDS.index("structural")))
        spring.scale = wp.where(has(record[0], wp.static(DOUBLED) + q), 2.0, 1.0)
    there = has(record[1], wp.where(q < 4, wp.static(HAS_SIDES), wp.static(HAS_DIAGONALS)))
    again = q == 1 and record[2] == corners[0]
    if there and not again and not (q > 1 and has(record[0], wp.static(ALONE))) and not is_empty(record):
        spring.rest = wp.where(q < 2 and has(record[0], wp.static(TURNED)), cell[1], cell[q // 2])
        if spring.kind == wp.static(KINDS.index("bending")):
            spring.rest *= 2.0
    return spring


def make_pull(order: int, path: str):
    """What spring i-j, the q-th of its cell, asks for.

    Paths without a branch are "quick", where multipliers start from 0 and nobody reads them afterwards, "damped", the
    same with a dashpot, and "repeated", where they are carried on. "careful" is both, and
    takes springs without a length.
    """

    @wp.func
    def slip_of(e: wp.vec3, i: Corner, j: Corner, s: State, body: Body, step: Step, low: wp.uint64) -> float:
        """By how much the spring became longer in this substep [m], as its dashpot sees it."""
        # A dashpot must not see the rounding that displacements carry: divided by a small step it is a speed.
        g = body.particles
        de = (j.d - i.d) - (load4(low, j.i) - load4(low, i.i))
        slip = elongation(e, wp.vec3(de[0], de[1], de[2]))
        if wp.static(order == 2):
            if step.second:
                carried = s.last_displacements[g + j.i] - s.last_displacements[g + i.i]
                slip -= wp.dot(e, carried) / (3.0 * wp.length(e))
        return slip

    @wp.func
    def pull_of(
        q: int,
        cell: int,
        before: Six,
        i: Corner,
        j: Corner,
        rest: float,
        alpha: float,
        m: Model,
        s: State,
        body: Body,
        material: Material,
        step: Step,
        low: wp.uint64,
    ) -> Pull:
        pull = Pull()
        pull.e = edge_between(i, j)
        w = i.d[3] + j.d[3]
        slot = q * m.cells.shape[0] + cell
        if wp.static(path == "careful"):
            pull.e = opened(pull.e, slot)
        e = pull.e
        # Begun with what keeps it from 0, it is three operations one after another instead of four.
        square = e[0] * e[0] + (e[1] * e[1] + (e[2] * e[2] + SHORTEST * SHORTEST))
        multiplier = float(0.0)
        held = float(-0.0)  # adding it is nothing to compute, as adding 0.0 would be
        if wp.static(path in ("repeated", "careful")):
            multiplier = before[q]
            held = alpha * multiplier
        if wp.static(path in ("damped", "careful")):
            gamma = material.damping * step.inverse
            held += gamma * slip_of(pull.e, i, j, s, body, step, low)
            w *= 1.0 + gamma
        found = pull_along(square, rest, held, w + alpha)
        pull.share = found[0]
        if wp.static(path in ("repeated", "careful")):
            s.cell_multipliers[slot] = multiplier - found[0] * found[1]
        return pull

    return pull_of


@wp.func
def pulled(i: Corner, p: Pull) -> wp.vec4:
    """The displacement of a spring's first particle after its pull; the inverse mass, its fourth number, stays."""
    share = i.d[3] * p.share
    return wp.vec4(i.d[0] + share * p.e[0], i.d[1] + share * p.e[1], i.d[2] + share * p.e[2], i.d[3])


@wp.func
def pushed(i: Corner, p: Pull) -> wp.vec4:
    """The same of its second particle."""
    share = i.d[3] * p.share
    return wp.vec4(i.d[0] - share * p.e[0], i.d[1] - share * p.e[1], i.d[2] - share * p.e[2], i.d[3])


@wp.func
def side_compliance(alpha: float, q: int, record: wp.vec4i) -> float:
    """Of side q: springs on the border of a grid are twice as compliant."""
    return wp.where(has(record[0], wp.static(DOUBLED) + q), 2.0 * alpha, alpha)


def make_project_corners(order: int, path: str):
    """The projection of the springs that cells of pass `group` hold (see make_pull); gives the moved corners."""
    pull_of = make_pull(order, path)

    @wp.func
    def project_across(
        q: Corners,
        record: wp.vec4i,
        k: int,
        before: Six,
        alpha: float,
        rest: float,
        m: Model,
        s: State,
        body: Body,
        material: Material,
        step: Step,
        low: wp.uint64,
    ) -> Corners:
        """The sides along y."""
        if has(record[0], wp.static(ALONE)):
            return q
        ac = pull_of(2, k, before, q.a, q.c, rest, side_compliance(alpha, 2, record), m, s, body, material, step, low)
        be = pull_of(3, k, before, q.b, q.e, rest, side_compliance(alpha, 3, record), m, s, body, material, step, low)
        q.a.d = pulled(q.a, ac)
        q.c.d = pushed(q.c, ac)
        q.b.d = pulled(q.b, be)
        q.e.d = pushed(q.e, be)
        return q

    @wp.func
    def project_sides(
        q: Corners,
        record: wp.vec4i,
        k: int,
        before: Six,
        springs: Springs,
        m: Model,
        s: State,
        body: Body,
        material: Material,
        step: Step,
        low: wp.uint64,
    ) -> Corners:
        if not has(record[1], wp.static(HAS_SIDES)):
            return q
        far = has(record[1], wp.static(FAR))
        alpha = wp.where(far, springs.far, springs.near)
        stride = wp.where(far, 2.0, 1.0)
        across = stride * springs.cell[1]
        rest = wp.where(has(record[0], wp.static(TURNED)), across, stride * springs.cell[0])
        ab = pull_of(0, k, before, q.a, q.b, rest, side_compliance(alpha, 0, record), m, s, body, material, step, low)
        ce = pull_of(1, k, before, q.c, q.e, rest, side_compliance(alpha, 1, record), m, s, body, material, step, low)
        q.a.d = pulled(q.a, ab)
        q.b.d = pushed(q.b, ab)
        q.c.d = pulled(q.c, ce)
        q.e.d = pushed(q.e, ce)
        return project_across(q, record, k, before, alpha, across, m, s, body, material, step, low)

    @wp.func
    def project_diagonals(
        q: Corners,
        record: wp.vec4i,
        k: int,
        before: Six,
        springs: Springs,
        m: Model,
        s: State,
        body: Body,
        material: Material,
        step: Step,
        low: wp.uint64,
    ) -> Corners:
        if not has(record[1], wp.static(HAS_DIAGONALS)) or has(record[0], wp.static(ALONE)):
            return q
        rest, alpha = springs.cell[2], springs.diagonal
        ae = pull_of(4, k, before, q.a, q.e, rest, alpha, m, s, body, material, step, low)
        bc = pull_of(5, k, before, q.b, q.c, rest, alpha, m, s, body, material, step, low)
        q.a.d = pulled(q.a, ae)
        q.e.d = pushed(q.e, ae)
        q.b.d = pulled(q.b, bc)
        q.c.d = pushed(q.c, bc)
        return q

    @wp.func
    def project_corners(
        q: Corners,
        record: wp.vec4i,
        k: int,
        springs: Springs,
        m: Model,
        s: State,
        body: Body,
        material: Material,
        step: Step,
        low: wp.uint64,
    ) -> Corners:
        before = Six()
        if wp.static(path in ("repeated", "careful")):
            before = multipliers_of(k, m, s, step)
        q = project_sides(q, record, k, before, springs, m, s, body, material, step, low)
        return project_diagonals(q, record, k, before, springs, m, s, body, material, step, low)

    return project_corners


@wp.func
def is_plain(material: Material, step: Step) -> bool:
    """Whether nobody reads multipliers, and no dashpots have to be taken care of."""
    return not (step.store or material.damping > 0.0)


def make_project_plainly(order: int):
    """The projection of cell k, whose record the schedule has fetched, where all that is_plain."""
    project_corners = make_project_corners(order, "quick")

    @wp.func
    def project_plainly(
        record: wp.vec4i,
        k: int,
        springs: Springs,
        m: Model,
        s: State,
        body: Body,
        material: Material,
        step: Step,
        x: wp.uint64,
        low: wp.uint64,
        d: wp.uint64,
    ):
        if is_empty(record):
            return
        q = corners_of(record, x, d)
        put_corners(project_corners(q, record, k, springs, m, s, body, material, step, low), d)

    return project_plainly


def make_project(order: int, stores: bool = True):
    """The projection of cell k, whose record the schedule has fetched, in every case.

    Unless it `stores`, for a sweep that is the only one of its substep, without multipliers.
    """
    plainly, repeatedly = make_project_corners(order, "quick"), make_project_corners(order, "repeated")
    damped, carefully = make_project_corners(order, "damped"), make_project_corners(order, "careful")

    @wp.func
    def project_cell(
        record: wp.vec4i,
        k: int,
        springs: Springs,
        m: Model,
        s: State,
        body: Body,
        material: Material,
        step: Step,
        x: wp.uint64,
        low: wp.uint64,
        d: wp.uint64,
    ):
        if is_empty(record):
            return
        q = corners_of(record, x, d)
        if wp.static(stores):
            if material.damping > 0.0 and step.store:
                put_corners(carefully(q, record, k, springs, m, s, body, material, step, low), d)
                return
            if step.store:
                put_corners(repeatedly(q, record, k, springs, m, s, body, material, step, low), d)
                return
        if material.damping > 0.0:
            put_corners(damped(q, record, k, springs, m, s, body, material, step, low), d)
        else:
            put_corners(plainly(q, record, k, springs, m, s, body, material, step, low), d)

    return project_cell
