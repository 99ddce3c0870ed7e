"""What keeps a crumpled cloth from staying crumpled: a tangle of stiff springs is eased until they have their lengths.

Sweeps that project stiff springs one after another have fixed points that are no equilibria: each spring undoes what
the one before it did, and a cloth that was thrown together stays so. Dashpots stiffer than sweeps can meet hold it as
well. A body is a tangle where a spring was off by more than a tenth of its length for several frames on end and is
stiffer than the inertia of a substep, so that hardly any load explains it, until all of them nearly have their lengths.
Then no spring is far stiffer than that, and dashpots are light: sweeps are small steps down the energy of the springs.
What is softer anyway is left as it is; of what was put together strained by more than half, dashpots that are stiffer
than the inertia are light as well.

What was a tangle once, since it was put somewhere, is one again as soon as springs are off by a little.

Few sweeps a frame carry no shape across a cloth, and in long substeps it leaves its shape again as soon as it has it.
So what was put together strained by more than half and became a tangle is computed in small substeps from then on, that
share the iterations (resident schedule). Where substeps are as small anyway, as they are by default, that changes
nothing. What few sweeps let sag is left as it is: taken back at once, that would be energy from nowhere.
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
SMALL = 1.0 / 1200.0  # [s] of a substep of what was a tangle, at most: where frames are usual, that of the defaults
STRAINED = wp.constant(0.1)  # of its length a spring is off by that is told
SETTLED = wp.constant(0.03)  # and in a tangle; left at a tenth, it would be one again a moment later
OFF, COLLAPSED = wp.constant(1), wp.constant(2)  # what is found of a body


@wp.func
def frames_off(tangled: int) -> int:
    """For how many frames on end a body is off."""
    return wp.where(tangled < 0, -1 - tangled, tangled)


@wp.func
def is_or_was_tangle(tangled: int) -> bool:
    """Whether a body is a tangle, or was one since it was put where it began."""
    return tangled < 0 or tangled >= PERSISTENT


@wp.func
def least_compliance(body: Body, dt: float) -> wp.vec3:
    """Of the springs of each kind in a tangle, where substeps are set to dt [s]."""
    h = wp.min(dt, LONGEST)
    return (EASED * h * h) * body.lightness


@wp.func
def in_small_steps(thrown: int, own: Material, body: Body, frame: Frame) -> Frame:
    """A frame of a body that is or was a tangle: the same unless it was thrown together, and a spring is so stiff that
    tangles have softer ones."""
    small = frame
    count = int(wp.ceil(float(frame.substeps) * frame.dt / frame.small - 0.01))
    stiff = wp.max(least_compliance(body, LONGEST) - own.compliance) > 0.0
    if thrown > 0 and stiff and count > frame.substeps:
        small.dt = frame.dt * float(frame.substeps) / float(count)
        small.substeps = count
        small.iterations = wp.max(1, frame.iterations * frame.substeps / count)
    return small


@wp.func
def last_frame(arrays: Arrays, b: int) -> Frame:
    """As the body b, of cells, took it."""
    frame = arrays.frames[0]
    if arrays.state.tangled[b] < 0:
        frame = in_small_steps(arrays.state.thrown[b], arrays.materials[b], arrays.model.bodies[b], frame)
    return frame


def make_ease(features: Features):
    """A Warp function: what a body of the material `own` is made of, substeps set to dt [s], taken as in `frame`."""

    @wp.func
    def ease(own: Material, tangled: int, thrown: int, body: Body, dt: float, frame: Frame) -> Material:
        material = own
        if wp.static("cell" in features.constraints):
            if frames_off(tangled) >= PERSISTENT:
                inertia = (dt * dt) * body.lightness
                # A dashpot holds like a spring so much stiffer. What hangs stretched by a load needs its own.
                held = own.compliance / (1.0 + own.damping / dt)
                stiff = wp.max(inertia - own.compliance) > 0.0
                if stiff or (thrown > 0 and wp.max(inertia - held) > 0.0):
                    material.damping = wp.min(own.damping, SLOWED * frame.dt)
                if stiff:
                    material.compliance = wp.max(own.compliance, least_compliance(body, dt))
        return material

    return ease


def make_material_of(features: Features):
    """A Warp function: what body b of a world is made of in this frame."""
    ease = make_ease(features)

    @wp.func
    def material_of(arrays: Arrays, b: int) -> Material:
        tangled = int(0)
        thrown = int(0)
        if wp.static("cell" in features.constraints):
            tangled = arrays.state.tangled[b]
            thrown = arrays.state.thrown[b]
        frame = arrays.frames[0]
        return ease(arrays.materials[b], tangled, thrown, arrays.model.bodies[b], frame.dt, frame)

    return material_of


@wp.func
def inverse_squares_of(body: Body) -> wp.vec3:
    """Of the rest lengths of a grid along x, along y and of diagonals [1/m^2]."""
    return wp.cw_div(wp.vec3(1.0), wp.cw_mul(body.cell, body.cell))


@wp.func
def most_off(tangled: int) -> float:
    """Of its length a spring may be off by, before it is told."""
    return wp.where(is_or_was_tangle(tangled), SETTLED, STRAINED)


@wp.func
def look_over(t: int, width: int, body: Body, records: wp.uint64, tangled: int, x: wp.uint64) -> int:
    """OFF if a spring of a cell of the body or patch, whose first record lies at `records`, is off, plus COLLAPSED if
    one has no length; told to all threads."""
    scales, most = inverse_squares_of(body), most_off(tangled)
    off = int(0)
    last = body.cells_end - body.cells - 1
    for k in range(t, last + 1, 2 * width):
        # Two at once: the way to memory and back is most of it.
        beside = load_record(records, wp.min(k + width, last))
        off += int(is_off(load_record(records, k), scales, most, x)) + int(is_off(beside, scales, most, x))
    if sync_any(off) == 0:
        return 0
    collapsed = int(0)
    for k in range(t, last + 1, width):
        collapsed += int(is_collapsed(load_record(records, k), x))
    return OFF + wp.where(sync_any(collapsed) != 0, COLLAPSED, 0)


@wp.func
def count_off(found: int, tangled: int) -> int:
    """What a body is that was `tangled`, after the frame in which that was `found`."""
    frames = wp.where((found & OFF) > 0, frames_off(tangled) + 1, 0)
    return wp.where(is_or_was_tangle(tangled), -1 - frames, frames)


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
