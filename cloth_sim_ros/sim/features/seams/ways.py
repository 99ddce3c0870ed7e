# SPDX-License-Identifier: Apache-2.0
"""Ways: the lines of springs at sewn particles, which stitches are solved with (see bodies.py).

The segments of a rope are such springs, too. A rope is solved as a whole, so that nothing is left of their equations.
They also resist moves across them, by their tension over their length.
"""

import warp as wp

from cloth_sim_ros.sim.arrays.state import compliance_of
from cloth_sim_ros.sim.features.seams.bodies import Seams, SewnArrays, is_rope
from cloth_sim_ros.sim.features.seams.stitch import place_of, square_step
from cloth_sim_ros.sim.kernels.intrinsics import load_row, pack, store_row, xyz
from cloth_sim_ros.sim.physics.distance import SHORTEST


@wp.func
def _residual(side: SewnArrays, i: int, j: int, slot: int, compliance: float, gamma: float) -> wp.vec4:
    """Return the unit vector of a spring from particle i to j, and what is left of its equation [m]."""
    moved, then = load_row(side.displacements, i), load_row(side.displacements, j)
    edge = xyz((load_row(side.positions, j) - load_row(side.positions, i)) + (then - moved))
    length = wp.max(wp.length(edge), SHORTEST)
    left = length - side.line_rests[slot] + compliance * side.line_multipliers[slot]
    if gamma > 0.0:
        apart = xyz((then - load_row(side.bases, j)) - (moved - load_row(side.bases, i)))
        was = edge - apart
        left += gamma * wp.dot(edge + was, apart) / (length + wp.length(was) + SHORTEST)
    return pack(edge / length, left)


@wp.func
def _near(seams: Seams, k: int, way: wp.vec2i, b: int) -> int:
    """Return the particle before bead b of a way from touched particle k."""
    if b > way[0]:
        return seams.beads[b - 1][0]
    return seams.touched[k][1]


@wp.func
def _beyond(seams: Seams, far: wp.float64, b: int, end: int, at: int) -> wp.mat33d:
    """Return how the far end of bead b, of inverse mass `far`, yields with all beads of a rope behind it [1/kg]."""
    unit = wp.identity(n=3, dtype=wp.float64)
    if b + 1 == end:
        return far * unit
    return far * wp.inverse(unit + far * seams.stiffs[at + b + 1])


@wp.func
def _double(v: wp.vec3) -> wp.vec3d:
    return wp.vec3d(wp.float64(v[0]), wp.float64(v[1]), wp.float64(v[2]))


@wp.func
def _single(v: wp.vec3d) -> wp.vec3:
    return wp.vec3(float(v[0]), float(v[1]), float(v[2]))


@wp.func
def _release_rope(seams: Seams, k: int, w: int, inverse: float, square: float, gamma: float, soft: float) -> wp.mat33:
    """Return how a touched particle of a rope yields with its segments [1/kg]; alone it does by `inverse`.

    Across, a slack segment yields 1e8 times as easily as along it, so that this takes double precision.
    """
    of, unit = seams.touched[k], wp.identity(n=3, dtype=wp.float64)
    side, at, added = seams.arrays[of[0] * seams.worlds + w], w * seams.beads.shape[0], wp.mat33d(wp.float64(0.0))
    for q in range(seams.way_starts[k], seams.way_starts[k + 1]):
        way = seams.ways[q]
        for b in range(way[1] - 1, way[0] - 1, -1):
            i, j, slot = _near(seams, k, way, b), seams.beads[b][0], seams.beads[b][1]
            near, far = load_row(side.displacements, i), load_row(side.displacements, j)
            edge = _double(xyz((load_row(side.positions, j) - load_row(side.positions, i)) + (far - near)))
            length, lightest = wp.max(wp.length(edge), wp.float64(SHORTEST)), wp.float64(near[3] + far[3] + 1.0e-30)
            along = edge / length
            tension = wp.float64(square * side.line_multipliers[slot])
            across = length / wp.max(tension, wp.float64(1.0e-4) * length / lightest)
            stretch = wp.float64(soft * side.line_scales[slot] / (1.0 + gamma))
            yields = (stretch - across) * wp.outer(along, along) + (across + wp.float64(1.0e-5) * lightest) * unit
            seams.stiffs[at + b] = wp.inverse(yields + _beyond(seams, wp.float64(far[3]), b, way[1], at))
            seams.pulls[at + b] = pack(_single(along), 0.0)
        added += seams.stiffs[at + way[0]]
    eases = wp.float64(inverse) * wp.inverse(unit + wp.float64(inverse) * added)
    return wp.matrix_from_rows(_single(eases[0]), _single(eases[1]), _single(eases[2]))


@wp.func
def release(seams: Seams, k: int, w: int, substep: int):
    """Move a touched particle as the springs of its ways ask, all solved at once, and find how it yields with them.

    Each way is eliminated from its far end on: its first spring then gains the multiplier `rest + mass u . z` as the
    particle moves by z.
    """
    of = seams.touched[k]
    side = seams.arrays[of[0] * seams.worlds + w]
    square = square_step(side, of[2], of[3], substep)
    gamma = side.materials[of[2]].damping * side.bodies[of[2]].line_damping / wp.sqrt(square)
    soft = compliance_of(side.materials[of[2]], 0) / square
    d = load_row(side.displacements, of[1])
    holds, asks = wp.identity(n=3, dtype=float), wp.vec3(0.0)
    if is_rope(side):
        number = place_of(seams, k, w)
        seams.inverses[number] = _release_rope(seams, k, w, d[3], square, gamma, soft)
        seams.starts[number] = xyz(d)
        seams.released[number] = xyz(d)
        return
    for q in range(seams.way_starts[k], seams.way_starts[k + 1]):
        mass, rest, along = float(0.0), float(0.0), wp.vec3(0.0)
        way = seams.ways[q]
        for b in range(way[1] - 1, way[0] - 1, -1):
            i, j, slot = _near(seams, k, way, b), seams.beads[b][0], seams.beads[b][1]
            near, far = load_row(side.displacements, i)[3], load_row(side.displacements, j)[3]
            compliance = soft * side.line_scales[slot]
            spring = _residual(side, i, j, slot, compliance, gamma)
            turn, eased = wp.dot(along, xyz(spring)), 1.0 / (1.0 + far * mass)
            left = spring[3] - (1.0 + gamma) * far * turn * rest * eased
            diagonal = compliance + (1.0 + gamma) * far * (1.0 - turn * turn * far * mass * eased)
            diagonal += 1.0e-5 * (near + far) + 1.0e-30
            along = xyz(spring)
            mass, rest = (1.0 + gamma) / diagonal, -left / diagonal
            if side.line_rests[slot] < 0.0:  # it failed
                mass, rest = 0.0, 0.0
            seams.pulls[w * seams.beads.shape[0] + b] = pack(along, mass)
            seams.rests[w * seams.beads.shape[0] + b] = rest
        holds += d[3] * mass * wp.outer(along, along)
        asks -= d[3] * rest * along
    number, eases = place_of(seams, k, w), wp.inverse(holds)
    seams.inverses[number] = d[3] * eases
    seams.starts[number] = xyz(d)
    seams.released[number] = xyz(d) + eases * asks
    store_row(side.displacements, of[1], d + pack(eases * asks, 0.0))


@wp.func
def _follow_rope(seams: Seams, k: int, w: int, moved: wp.vec3, square: float):
    """Let the segments of a rope follow a move of its touched particle [m]."""
    of, at = seams.touched[k], w * seams.beads.shape[0]
    side = seams.arrays[of[0] * seams.worlds + w]
    for q in range(seams.way_starts[k], seams.way_starts[k + 1]):
        way, moves = seams.ways[q], _double(moved)
        for b in range(way[0], way[1]):
            j, slot = seams.beads[b][0], seams.beads[b][1]
            d, push = load_row(side.displacements, j), seams.stiffs[at + b] * moves
            less = wp.dot(_single(push), xyz(load_row(seams.pulls, at + b))) / square
            side.line_multipliers[slot] = side.line_multipliers[slot] - less
            moves = _beyond(seams, wp.float64(d[3]), b, way[1], at) * push
            store_row(side.displacements, j, d + pack(_single(moves), 0.0))


@wp.func
def follow(seams: Seams, k: int, w: int, substep: int):
    """Let the ways of a touched particle follow its move since `release`."""
    of = seams.touched[k]
    side = seams.arrays[of[0] * seams.worlds + w]
    number = place_of(seams, k, w)
    moved = xyz(load_row(side.displacements, of[1])) - seams.starts[number]
    if is_rope(side):
        _follow_rope(seams, k, w, moved, square_step(side, of[2], of[3], substep))
        return
    for q in range(seams.way_starts[k], seams.way_starts[k + 1]):
        way, at = seams.ways[q], w * seams.beads.shape[0]
        pull = load_row(seams.pulls, at + way[0])
        gained = seams.rests[at + way[0]] + pull[3] * wp.dot(xyz(pull), moved)
        for b in range(way[0], way[1]):
            j, slot = seams.beads[b][0], seams.beads[b][1]
            d, impulse = load_row(side.displacements, j), gained * xyz(pull)
            side.line_multipliers[slot] = side.line_multipliers[slot] + gained
            if b + 1 < way[1]:
                beyond = load_row(seams.pulls, at + b + 1)
                turn, pull = wp.dot(xyz(pull), xyz(beyond)), beyond
                rest = seams.rests[at + b + 1]
                gained = rest + pull[3] * d[3] * (gained * turn - rest) / (1.0 + d[3] * pull[3])
                impulse -= gained * xyz(pull)
            store_row(side.displacements, j, d + pack(d[3] * impulse, 0.0))
