"""What keeps a crumpled cloth from staying crumpled: a tangle of stiff springs is eased until they have their lengths.

Sweeps that project stiff springs one after another have fixed points that are no equilibria: each spring undoes what
the one before it did, and a cloth that was thrown together stays so. Dashpots stiffer than sweeps can meet hold it as
well. A body is a tangle where a spring was off by more than a tenth of its length for several frames on end and is
stiffer than the inertia of a substep, so that hardly any load explains it. Then no spring is far stiffer than that, and
dashpots are light: sweeps are small steps down the energy of the springs. What is softer anyway is left as it is.
"""

import warp as wp

from cloth_sim_ros.sim.constraints.cell import is_collapsed, is_off
from cloth_sim_ros.sim.model import Body, Features
from cloth_sim_ros.sim.schedules.native import load_record, sync_any
from cloth_sim_ros.sim.state import Arrays, Frame, Material, State

PERSISTENT = wp.constant(5)  # frames in a row make a tangle; what is struck or let go is met again sooner
SLOWED = wp.constant(1.0)  # substeps at most is the time constant of a dashpot in a tangle; less lets it whip
LONGEST = wp.constant(1.0 / 300.0)  # [s] of a substep; by the inertia in longer ones gusts would stretch the cloth
EASED = wp.constant(0.05)  # of its inertia in a substep is what a spring in a tangle is held by at most
OFF, COLLAPSED = wp.constant(1), wp.constant(2)  # what is found of a body


def make_ease(features: Features):
    """A Warp function: what a body of the material `own` is made of that was off for so many frames on end."""

    @wp.func
    def ease(own: Material, frames: int, body: Body, frame: Frame) -> Material:
        material = own
        if wp.static("cell" in features.constraints):
            if frames >= PERSISTENT:
                if wp.max((frame.dt * frame.dt) * body.lightness - own.compliance) > 0.0:
                    h = wp.min(frame.dt, LONGEST)
                    material.damping = wp.min(own.damping, SLOWED * frame.dt)
                    material.compliance = wp.max(own.compliance, (EASED * h * h) * body.lightness)
        return material

    return ease


def make_material_of(features: Features):
    """A Warp function: what body b of a world is made of in this frame."""
    ease = make_ease(features)

    @wp.func
    def material_of(arrays: Arrays, b: int) -> Material:
        frames = int(0)
        if wp.static("cell" in features.constraints):
            frames = arrays.state.tangled[b]
        return ease(arrays.materials[b], frames, arrays.model.bodies[b], arrays.frames[0])

    return material_of


@wp.func
def inverse_squares_of(body: Body) -> wp.vec3:
    """Of the rest lengths of a grid along x, along y and of diagonals [1/m^2]."""
    return wp.cw_div(wp.vec3(1.0), wp.cw_mul(body.cell, body.cell))


@wp.func
def look_over(t: int, width: int, body: Body, records: wp.uint64, x: wp.uint64) -> int:
    """OFF if a spring of a cell of the body or patch, whose first record lies at `records`, is off, plus COLLAPSED if
    one has no length; told to all threads."""
    scales = inverse_squares_of(body)
    off = int(0)
    last = body.cells_end - body.cells - 1
    for k in range(t, last + 1, 2 * width):
        # Two at once: the way to memory and back is most of it.
        beside = load_record(records, wp.min(k + width, last))
        off += int(is_off(load_record(records, k), scales, x)) + int(is_off(beside, scales, x))
    if sync_any(off) == 0:
        return 0
    collapsed = int(0)
    for k in range(t, last + 1, width):
        collapsed += int(is_collapsed(load_record(records, k), x))
    return OFF + wp.where(sync_any(collapsed) != 0, COLLAPSED, 0)


@wp.func
def count_off(found: int, before: int) -> int:
    """How many frames on end a body is off that was so for `before`, after the one in which that was `found`."""
    return wp.where((found & OFF) > 0, before + 1, 0)


@wp.func
def note_found(found: int, b: int, s: State):
    """What was found of a body in one of many launches or blocks."""
    if (found & COLLAPSED) > 0:
        s.collapsed[b] = 1
    if (found & OFF) > 0:
        s.off[b] = 1


@wp.func
def count_found(b: int, s: State):
    """At the end of a frame that noted it; the next one starts without."""
    s.tangled[b] = count_off(s.off[b], s.tangled[b])
    s.off[b] = 0
    s.collapsed[b] = 0
