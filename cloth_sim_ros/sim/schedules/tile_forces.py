"""The forces on a member of a tile, gathered from what lies around it in the tile's shared memory (see tiled.py)."""

import warp as wp

from cloth_sim_ros.sim.model import Features, Model
from cloth_sim_ros.sim.schedules.air import Corners, make_air
from cloth_sim_ros.sim.schedules.native import array_address, load4, xyz
from cloth_sim_ros.sim.schedules.stages import pack, spoke_constant, spoke_force
from cloth_sim_ros.sim.schedules.tiles import PLACES, Tiles
from cloth_sim_ros.sim.state import Frame, Material


@wp.struct
class Carried:
    """What a particle carries from substep to substep: position [m] and inverse mass [1/kg], what float32 lost of the
    position [m], velocity [m/s]."""

    x: wp.vec4
    low: wp.vec3
    v: wp.vec3


def make_springs(width: int, capacity: int):
    """A struct and two Warp functions: what fetches the `width` springs of a member of a tile, and what computes their
    force [N].

    The springs of one member do not wait for one another: no branch lies between them.
    """
    places = wp.types.vector(length=width, dtype=wp.int32)
    numbers = wp.types.vector(length=width, dtype=wp.float32)

    @wp.struct
    class Springs:
        others: places
        rests: numbers
        constants: numbers
        lost: numbers

    @wp.func
    def gather(n: int, i: int, m: Model, tiles: Tiles, constants: wp.vec3) -> Springs:
        springs = Springs()
        for q in range(width):
            packed = tiles.spokes[(n * width + q) * capacity + i]
            kind = load4(array_address(m.spoke_types, 0), packed / wp.static(PLACES))
            springs.others[q] = packed & wp.static(PLACES - 1)
            springs.rests[q] = kind[0]
            springs.constants[q] = spoke_constant(kind, constants)
            springs.lost[q] = kind[3]
        return springs

    @wp.func
    def edge(here: int, now: Carried, other: int, shared: wp.uint64) -> wp.vec3:
        j = here + other
        return xyz((load4(shared, j) - now.x) + (load4(shared, capacity + j) - pack(now.low, 0.0)))

    @wp.func
    def elastic_force(here: int, now: Carried, springs: Springs, shared: wp.uint64) -> wp.vec3:
        total = wp.vec3(0.0)
        for q in range(width):
            e = edge(here, now, springs.others[q], shared)
            total += spoke_force(e, springs.rests[q], springs.constants[q], springs.lost[q], 0.0, wp.vec3(0.0))
        return total

    @wp.func
    def damped_force(here: int, now: Carried, springs: Springs, damping: float, shared: wp.uint64) -> wp.vec3:
        total = wp.vec3(0.0)
        for q in range(width):
            apart = xyz(load4(shared, 2 * capacity + here + springs.others[q])) - now.v
            e = edge(here, now, springs.others[q], shared)
            total += spoke_force(e, springs.rests[q], springs.constants[q], springs.lost[q], damping, apart)
        return total

    @wp.func
    def force(here: int, now: Carried, springs: Springs, damping: float, shared: wp.uint64) -> wp.vec3:
        if damping > 0.0:
            return damped_force(here, now, springs, damping, shared)
        return elastic_force(here, now, springs, shared)

    return Springs, gather, force


def make_drag(features: Features, panels: int, capacity: int):
    """A Warp function: the force of the air [N] on a member of a tile by the `panels` around it, and its drag rate."""
    air = make_air(features)

    @wp.func
    def drag(
        n: int,
        i: int,
        here: int,
        now: Carried,
        tiles: Tiles,
        frame: Frame,
        material: Material,
        shared: wp.uint64,
    ) -> wp.vec4:
        total = wp.vec4(0.0)
        for q in range(panels):
            packed = tiles.panels[(n * panels + q) * capacity + i]
            corner = packed / wp.static(PLACES * PLACES)
            if corner < 3:
                j = here + (packed & wp.static(PLACES - 1))
                k = here + ((packed / wp.static(PLACES)) & wp.static(PLACES - 1))
                p = xyz(load4(shared, j))
                vp = xyz(load4(shared, 2 * capacity + j))
                r = xyz(load4(shared, k))
                vr = xyz(load4(shared, 2 * capacity + k))
                corners = Corners()
                corners.a = p
                corners.va = vp
                corners.b = p
                corners.vb = vp
                corners.c = r
                corners.vc = vr
                if corner == 0:
                    corners.a = xyz(now.x)
                    corners.va = now.v
                elif corner == 1:
                    corners.b = xyz(now.x)
                    corners.vb = now.v
                else:
                    corners.b = r
                    corners.vb = vr
                    corners.c = xyz(now.x)
                    corners.vc = now.v
                total += air(corners, frame, material)
        return total

    return drag
