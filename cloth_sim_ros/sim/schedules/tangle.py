"""What keeps a crumpled cloth from staying crumpled: a tangle is eased until its springs are met again.

Sweeps that project stiff springs one after another have fixed points that are no equilibria: each spring undoes what
the one before it did, and a cloth that was thrown together stays so. Dashpots stiffer than sweeps can meet hold it as
well. A body is a tangle once in several frames on end a spring is off by more than a tenth of its length and has
another force than the sweeps found. In the next frame none of its springs is far stiffer than the inertia of a substep,
and its dashpots are light: sweeps then are small steps down the energy of its springs.
"""

import warp as wp

from cloth_sim_ros.sim.cells import PAIRS
from cloth_sim_ros.sim.constraints.cell import STRAINED, index_of, off_in, spring_of
from cloth_sim_ros.sim.model import Body, Features, Model
from cloth_sim_ros.sim.physics.distance import SHORTEST
from cloth_sim_ros.sim.schedules.native import load4, load_record, sync_any, xyz
from cloth_sim_ros.sim.state import Arrays, Frame, Material, State
from cloth_sim_ros.sim.topology import KINDS

UNMET = wp.constant(0.02)  # of a rest length is the residual of a spring that the sweeps did not meet
PERSISTENT = wp.constant(5)  # frames in a row make a tangle; what is struck or let go is met again sooner
SLOWED = wp.constant(1.0)  # substeps at most is the time constant of a dashpot in a tangle; less lets it whip
EASED = wp.constant(0.05)  # of its inertia in a substep is what a spring in a tangle is held by at most


def make_ease(features: Features):
    """A Warp function: what body b, of the material `own`, is made of in this frame."""

    @wp.func
    def ease(own: Material, b: int, s: State, body: Body, frame: Frame) -> Material:
        material = own
        if wp.static("cell" in features.constraints):
            if s.tangled[b] >= PERSISTENT:
                material.damping = wp.min(own.damping, SLOWED * frame.dt)
                material.compliance = wp.max(own.compliance, (EASED * frame.dt * frame.dt) * body.lightness)
        return material

    return ease


def make_material_of(features: Features):
    """The same from all arrays of a world."""
    ease = make_ease(features)

    @wp.func
    def material_of(arrays: Arrays, b: int) -> Material:
        return ease(arrays.materials[b], b, arrays.state, arrays.model.bodies[b], arrays.frames[0])

    return material_of


@wp.func
def inverse_squares_of(body: Body) -> wp.vec3:
    """Of the rest lengths of a grid along x, along y and of diagonals [1/m^2]."""
    return wp.cw_div(wp.vec3(1.0), wp.cw_mul(body.cell, body.cell))


Velocities = wp.types.matrix((4, 3), wp.float32)  # of the corners of a cell [m/s]


@wp.func
def is_unmet(
    record: wp.vec4i,
    k: int,
    velocities: Velocities,
    m: Model,
    s: State,
    body: Body,
    material: Material,
    inverse_square: float,
    x: wp.uint64,
) -> bool:
    """Whether a strained side or diagonal of cell k has another force than the last sweeps of the frame before found.

    inverse_square: 1/h_e^2 [1/s^2].
    """
    pair = wp.static(wp.types.matrix((6, 2), int)(*PAIRS.ravel().tolist()))
    q = int(0)
    while q < 6:
        spring = spring_of(q, record, body.cell)
        if spring.rest > 0.0 and spring.kind != wp.static(KINDS.index("bending")):
            e = xyz(load4(x, spring.j)) - xyz(load4(x, spring.i))
            length = wp.length(e)
            off = length - spring.rest
            if wp.abs(off) > STRAINED * spring.rest:
                rate = wp.dot(velocities[pair[q, 1]] - velocities[pair[q, 0]], e) / wp.max(length, SHORTEST)
                multiplier = s.cell_multipliers[q * m.cells.shape[0] + k]
                held = material.compliance[spring.kind] * spring.scale * inverse_square * multiplier
                if wp.abs(off + material.damping * rate + held) > UNMET * spring.rest:
                    return True
        q += 1
    return False


@wp.struct
class Places:
    """Where the velocities [m/s] of a body lie; the members of a patch, from `first` on, say which of them it has."""

    velocities: wp.uint64
    members: wp.array(dtype=int)
    first: int


def make_look_at_cell(particle_of=None):
    """A Warp function: whether a spring of cell k has no length; one that makes a tangle of its body is noted.

    particle_of: a Warp function of a member of a patch, if cells are those of patches.
    """

    @wp.func
    def velocity_at(i: int, places: Places) -> wp.vec3:
        if wp.static(particle_of is not None):
            return xyz(load4(places.velocities, particle_of(places.members[places.first + i])))
        return xyz(load4(places.velocities, i))

    @wp.func
    def look_at_cell(
        record: wp.vec4i,
        k: int,
        places: Places,
        m: Model,
        s: State,
        body: Body,
        material: Material,
        inverse_square: float,
        x: wp.uint64,
    ) -> bool:
        off = off_in(record, inverse_squares_of(body), x)
        if off.strained:
            velocities = wp.matrix_from_rows(
                velocity_at(index_of(record[0]), places),
                velocity_at(index_of(record[1]), places),
                velocity_at(record[2], places),
                velocity_at(record[3], places),
            )
            if is_unmet(record, k, velocities, m, s, body, material, inverse_square, x):
                wp.atomic_max(s.tangles, body.index, 1)
        return off.collapsed

    return look_at_cell


def make_look_over(particle_of=None):
    """A Warp function: the same of all cells of a body or patch, the first record at `records`, by all its threads."""
    look_at_cell = make_look_at_cell(particle_of)

    @wp.func
    def look_over(
        t: int,
        width: int,
        places: Places,
        m: Model,
        s: State,
        body: Body,
        material: Material,
        inverse_square: float,
        records: wp.uint64,
        x: wp.uint64,
    ) -> bool:
        found = int(0)
        last = body.cells_end - body.cells - 1
        for k in range(t, last + 1, 2 * width):
            # Two at once: the way to memory and back is most of it.
            other = wp.min(k + width, last)
            one = load_record(records, k)
            two = load_record(records, other)
            found += int(look_at_cell(one, body.cells + k, places, m, s, body, material, inverse_square, x))
            found += int(look_at_cell(two, body.cells + other, places, m, s, body, material, inverse_square, x))
        return sync_any(found) > 0

    return look_over


@wp.func
def tell_tangle(b: int, s: State):
    """The next frame of body b knows what this one found."""
    s.tangled[b] = wp.where(wp.atomic_exch(s.tangles, b, 0) > 0, s.tangled[b] + 1, 0)
