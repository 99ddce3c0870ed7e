"""What keeps a crumpled cloth from staying crumpled: a tangle is eased until its springs are met again.

Sweeps that project stiff springs one after another have fixed points that are no equilibria: each spring undoes what
the one before it did, and a cloth that was thrown together stays so. Dashpots stiffer than sweeps can meet hold it as
well. A body is a tangle once in several frames on end a spring is off by more than a tenth of its length and has
another force than the sweeps found. In the next frame none of its springs is far stiffer than the inertia of a substep,
and its dashpots are light: sweeps then are small steps down the energy of its springs.
"""

import warp as wp

from cloth_sim_ros.sim.constraints.cell import STRAINED, is_off, spring_of
from cloth_sim_ros.sim.model import Body, Features, Model
from cloth_sim_ros.sim.physics.distance import SHORTEST
from cloth_sim_ros.sim.schedules.native import load4, load_record, sync_any, xyz
from cloth_sim_ros.sim.state import Arrays, Frame, Material, State
from cloth_sim_ros.sim.topology import KINDS

UNMET = wp.constant(0.02)  # of a rest length is the residual of a spring that the sweeps did not meet
PERSISTENT = wp.constant(5)  # frames in a row make a tangle; what is struck or let go is met again sooner
SLOWED = wp.constant(1.0)  # substeps at most is the time constant of a dashpot in a tangle; less lets it whip
COLLAPSED, TANGLED = wp.constant(1), wp.constant(2)  # what is found of a body
LONGEST = wp.constant(1.0 / 300.0)  # [s] of a substep; by the inertia in longer ones gusts would stretch the cloth
EASED = wp.constant(0.05)  # of its inertia in a substep is what a spring in a tangle is held by at most


def make_ease(features: Features):
    """A Warp function: what a body of the material `own` is made of that was tangled for so many frames on end."""

    @wp.func
    def ease(own: Material, tangled: int, body: Body, frame: Frame) -> Material:
        material = own
        if wp.static("cell" in features.constraints):
            if tangled >= PERSISTENT:
                material.damping = wp.min(own.damping, SLOWED * frame.dt)
                h = wp.min(frame.dt, LONGEST)
                material.compliance = wp.max(own.compliance, (EASED * h * h) * body.lightness)
        return material

    return ease


def make_material_of(features: Features):
    """A Warp function: what body b of a world is made of in this frame."""
    ease = make_ease(features)

    @wp.func
    def material_of(arrays: Arrays, b: int) -> Material:
        tangled = int(0)
        if wp.static("cell" in features.constraints):
            tangled = arrays.state.tangled[b]
        return ease(arrays.materials[b], tangled, arrays.model.bodies[b], arrays.frames[0])

    return material_of


@wp.func
def inverse_squares_of(body: Body) -> wp.vec3:
    """Of the rest lengths of a grid along x, along y and of diagonals [1/m^2]."""
    return wp.cw_div(wp.vec3(1.0), wp.cw_mul(body.cell, body.cell))


@wp.struct
class Places:
    """Where the velocities [m/s] of a body lie; the members of a patch, from `first` on, say which of them it has."""

    velocities: wp.uint64
    members: wp.array(dtype=int)
    first: int


def make_look_at_cell(particle_of=None):
    """A Warp function: COLLAPSED if a spring of cell k, which is_off, has no length, plus TANGLED if one is not met.

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
    ) -> int:
        found = int(0)
        q = int(0)
        while q < 6:  # not unrolled: next to no cell ever comes here
            spring = spring_of(q, record, body.cell)
            q += 1
            if spring.rest > 0.0:
                e = xyz(load4(x, spring.j)) - xyz(load4(x, spring.i))
                length = wp.length(e)
                if length < SHORTEST:
                    found |= COLLAPSED
                off = length - spring.rest
                if wp.abs(off) > STRAINED * spring.rest and spring.kind != wp.static(KINDS.index("bending")):
                    rate = wp.dot(velocity_at(spring.j, places) - velocity_at(spring.i, places), e)
                    multiplier = s.cell_multipliers[(q - 1) * m.cells.shape[0] + k]
                    held = material.compliance[spring.kind] * spring.scale * inverse_square * multiplier
                    residual = off + material.damping * rate / wp.max(length, SHORTEST) + held
                    if wp.abs(residual) > UNMET * spring.rest:
                        found |= TANGLED
        return found

    return look_at_cell


def make_look_over(particle_of=None):
    """A Warp function: the same of all cells of a body or patch, the first record at `records`, told to all its
    threads."""
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
    ) -> int:
        scales = inverse_squares_of(body)
        off = int(0)
        last = body.cells_end - body.cells - 1
        for k in range(t, last + 1, 2 * width):
            # Two at once: the way to memory and back is most of it.
            beside = load_record(records, wp.min(k + width, last))
            off += int(is_off(load_record(records, k), scales, x)) + int(is_off(beside, scales, x))
        if sync_any(off) == 0:
            return 0
        found = int(0)
        for k in range(t, last + 1, width):
            record = load_record(records, k)
            if is_off(record, scales, x):
                found |= look_at_cell(record, body.cells + k, places, m, s, body, material, inverse_square, x)
        return wp.where(sync_any(found & COLLAPSED) > 0, COLLAPSED, 0) + wp.where(
            sync_any(found & TANGLED) > 0, TANGLED, 0
        )

    return look_over


@wp.func
def count_tangle(found: int, before: int) -> int:
    """How many frames on end a body is a tangle that was one for so many `before` the one in which that was `found`."""
    return wp.where((found & TANGLED) > 0, before + 1, 0)


@wp.func
def note_found(found: int, b: int, s: State):
    """What was found of a body in one of many launches or blocks."""
    if (found & COLLAPSED) > 0:
        s.collapsed[b] = 1
    if (found & TANGLED) > 0:
        s.tangles[b] = 1


@wp.func
def count_found(b: int, s: State):
    """At the end of a frame that noted it; the next one starts without."""
    s.tangled[b] = count_tangle(wp.where(s.tangles[b] > 0, TANGLED, 0), s.tangled[b])
    s.tangles[b] = 0
    s.collapsed[b] = 0
