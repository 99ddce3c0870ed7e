# SPDX-License-Identifier: Apache-2.0
"""A stitch as it is now: which particles it ties, how far apart its points are, and how these yield to its force."""

import warp as wp

from cloth_sim_ros.parameters import SEAM
from cloth_sim_ros.sim.arrays.state import substep_length, was_smooth
from cloth_sim_ros.sim.features.seams.bodies import Seams, SewnArrays, Stitch
from cloth_sim_ros.sim.input.numbers import places
from cloth_sim_ros.sim.kernels.intrinsics import load_row, xyz
from cloth_sim_ros.sim.physics.distance import SHORTEST
from cloth_sim_ros.sim.physics.integrate import effective_step

COMPLIANCE, STRENGTH, SPEED = (places(SEAM)[name] for name in ("compliance", "strength", "closing_speed"))
_STEPS = 4  # segments of a rope that a stitch slides over in a substep at most
_ROUNDING = wp.constant(1.0e-5)  # share of a segment that float32 does not lose
_LITTLE = wp.constant(1.0e-3)  # share of a segment by which a stitch enters the next one


@wp.struct
class Tie:
    """A stitch as it is now. particles: four. weights: of each in the vector from the second point to the first.

    arrays: index in Seams.arrays of the two batches. along: unit vector along which it slides, or 0.
    """

    particles: wp.vec4i
    weights: wp.vec4
    arrays: wp.vec2i
    along: wp.vec3


@wp.func
def _move_of(arrays: SewnArrays, i: int, moved: bool) -> wp.vec4:
    """Return what is added to the position of particle i [m]: its displacement if it has `moved`."""
    if moved:
        return load_row(arrays.displacements, i)
    return load_row(arrays.position_lo, i)


@wp.func
def _way(rope: SewnArrays, i: int, moved: bool) -> wp.vec3:
    """Return the vector from particle i of a rope to the next one [m]."""
    way = load_row(rope.positions, i + 1) - load_row(rope.positions, i)
    return xyz(way + (_move_of(rope, i + 1, moved) - _move_of(rope, i, moved)))


@wp.func
def place_along(stitch: Stitch, slid: float) -> float:
    """Return the number of segments from the first end of its rope to a stitch that slid so far."""
    segments = float(stitch.rope[1] - stitch.rope[0])
    return wp.clamp(float(stitch.particles[2] - stitch.rope[0]) + stitch.shares[1] + slid, 0.0, segments)


@wp.func
def segment_at(stitch: Stitch, at: float) -> int:
    """Return the segment of its rope that such a place is on."""
    return wp.min(int(at), stitch.rope[1] - stitch.rope[0] - 1)


@wp.func
def tie_of(seams: Seams, stitch: Stitch, state: wp.vec3, w: int, moved: bool) -> Tie:
    """Return a stitch in a state of SeamState.stitches, in world w, before or after its rope has `moved`."""
    tie = Tie()
    tie.arrays = stitch.batches * seams.worlds + wp.vec2i(w, w)
    tie.particles = stitch.particles
    share = stitch.shares[1]
    if stitch.rope[0] >= 0:
        at = place_along(stitch, state[0])
        segment = segment_at(stitch, at)
        share = at - float(segment)
        tie.particles[2] = stitch.rope[0] + segment
        tie.particles[3] = tie.particles[2] + 1
        if at > 0.0 and at < float(stitch.rope[1] - stitch.rope[0]):
            rope = seams.arrays[tie.arrays[1]]
            tie.along = wp.normalize(_way(rope, tie.particles[2], moved))
            if state[2] > 0.0:
                tie.along = wp.normalize(tie.along + wp.normalize(_way(rope, tie.particles[2] - 1, moved)))
    tie.weights = wp.vec4(1.0 - stitch.shares[0], stitch.shares[0], share - 1.0, -share)
    return tie


@wp.func
def gap_of(seams: Seams, tie: Tie, moved: bool) -> wp.vec3:
    """Return the vector from the second point to the first [m], at the start of the substep or where it has `moved`."""
    first, gap = load_row(seams.arrays[tie.arrays[0]].positions, tie.particles[0]), wp.vec4(0.0)
    for k in range(4):
        of = seams.arrays[tie.arrays[k / 2]]
        i = tie.particles[k]
        gap += tie.weights[k] * ((load_row(of.positions, i) - first) + _move_of(of, i, moved))
    return xyz(gap)


@wp.func
def across(gap: wp.vec3, tie: Tie) -> wp.vec3:
    """Return the part of a gap [m] that a stitch closes, across the way it slides."""
    return gap - wp.dot(gap, tie.along) * tie.along


@wp.func
def slide(seams: Seams, stitch: Stitch, state: wp.vec3, w: int, moved: bool) -> wp.vec3:
    """Return the state of a stitch at the point of its rope nearest to its first point, from a state near by.

    Where the rope bends that point may be a particle, from which it slides along the mean of both segments.
    """
    slid, came = state[0], int(0)
    for _step in range(_STEPS):
        tie = tie_of(seams, stitch, wp.vec3(slid, 0.0, 0.0), w, moved)
        way = _way(seams.arrays[tie.arrays[1]], tie.particles[2], moved)
        square = wp.max(wp.dot(way, way), SHORTEST * SHORTEST)
        share = -tie.weights[3] + wp.dot(gap_of(seams, tie, moved), way) / square
        begin = float(tie.particles[2] - stitch.particles[2]) - stitch.shares[1]
        goes = wp.where(share < 0.0, -1, wp.where(share > 1.0, 1, 0))
        if goes == 0:
            return wp.vec3(begin + share, state[1], 0.0)
        corner = begin + wp.where(goes > 0, 1.0, 0.0)
        if goes * came < 0:
            return wp.vec3(corner + _ROUNDING, state[1], 1.0)
        slid, came = corner + _LITTLE * float(goes), goes
    return wp.vec3(slid, state[1], 0.0)


@wp.func
def length_of(arrays: SewnArrays, body: int) -> float:
    """Return the length of a substep [s]."""
    return substep_length(arrays.frames[0], arrays.control, arrays.limits[body], body)


@wp.func
def square_step(arrays: SewnArrays, body: int, second: int, substep: int) -> float:
    """Return the square of the effective length of a substep of a body [s^2]."""
    smooth = bool(False)
    if second == 1:
        smooth = was_smooth(arrays.events, arrays.history, body, substep)
    h = effective_step(length_of(arrays, body), smooth)
    return h * h


@wp.func
def place_of(seams: Seams, k: int, w: int) -> int:
    """Return the place of a touched particle among those of all worlds."""
    of = seams.touched[k]
    return w * seams.particles + seams.firsts[of[0]] + of[1]


@wp.func
def yields(seams: Seams, stitch: Stitch, tie: Tie, k: int, w: int, substep: int) -> wp.mat33:
    """Return how far particle k of a stitch moves under its force [m/N]."""
    side = seams.arrays[tie.arrays[k / 2]]
    square = square_step(side, stitch.bodies[k / 2], stitch.seconds[k / 2], substep)
    return tie.weights[k] * square * seams.inverses[number_of_particle(seams, stitch, tie, k, w)]


@wp.func
def all_yield(seams: Seams, stitch: Stitch, tie: Tie, w: int, substep: int, held: int, share: float) -> wp.mat33:
    """Return how far both points of a stitch move under its force [m/N], with others that pull their particles.

    The point `held` counts with `share` alone; -1: none does.
    """
    found = wp.mat33(0.0)
    for k in range(4):
        if tie.weights[k] != 0.0:
            several = float(seams.counts[number_of_particle(seams, stitch, tie, k, w)])
            if k / 2 == held:
                several = share
            found += tie.weights[k] * several * yields(seams, stitch, tie, k, w, substep)
    return found


@wp.func
def number_of_particle(seams: Seams, stitch: Stitch, tie: Tie, k: int, w: int) -> int:
    """Return the place of particle k of a stitch among those of all worlds."""
    return w * seams.particles + seams.firsts[stitch.batches[k / 2]] + tie.particles[k]


@wp.func
def solved(matrix: wp.mat33, right: wp.vec3) -> wp.vec3:
    """Return the solution of a symmetric system of equations, scaled to stay within float32."""
    size = wp.trace(matrix)
    return wp.inverse(matrix / size) * (right / size)
