# SPDX-License-Identifier: Apache-2.0
"""Ways: the lines of springs at sewn particles, which stitches are solved with (see bodies.py).

The segments of a rope are such springs, too. A rope is solved as a whole, so that nothing is left of their equations.
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
    if is_rope(side):
        return pack(edge / length, 0.0)
    left = length - side.line_rests[slot] + compliance * side.line_multipliers[slot]
    if gamma > 0.0:
        apart = xyz((then - load_row(side.bases, j)) - (moved - load_row(side.bases, i)))
        was = edge - apart
        left += gamma * wp.dot(edge + was, apart) / (length + wp.length(was) + SHORTEST)
    return pack(edge / length, left)


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
    for q in range(seams.way_starts[k], seams.way_starts[k + 1]):
        mass, rest, along = float(0.0), float(0.0), wp.vec3(0.0)
        way = seams.ways[q]
        for b in range(way[1] - 1, way[0] - 1, -1):
            i = int(of[1])
            if b > way[0]:
                i = seams.beads[b - 1][0]
            j, slot = seams.beads[b][0], seams.beads[b][1]
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
def follow(seams: Seams, k: int, w: int, substep: int):
    """Let the ways of a touched particle follow its move since `release`."""
    of = seams.touched[k]
    side = seams.arrays[of[0] * seams.worlds + w]
    unit = float(1.0)
    if is_rope(side):  # it has tensions instead of multipliers
        unit = -1.0 / square_step(side, of[2], of[3], substep)
    number = place_of(seams, k, w)
    moved = xyz(load_row(side.displacements, of[1])) - seams.starts[number]
    for q in range(seams.way_starts[k], seams.way_starts[k + 1]):
        way, at = seams.ways[q], w * seams.beads.shape[0]
        pull = load_row(seams.pulls, at + way[0])
        gained = seams.rests[at + way[0]] + pull[3] * wp.dot(xyz(pull), moved)
        for b in range(way[0], way[1]):
            j, slot = seams.beads[b][0], seams.beads[b][1]
            d, impulse = load_row(side.displacements, j), gained * xyz(pull)
            side.line_multipliers[slot] = side.line_multipliers[slot] + unit * gained
            if b + 1 < way[1]:
                beyond = load_row(seams.pulls, at + b + 1)
                turn, pull = wp.dot(xyz(pull), xyz(beyond)), beyond
                rest = seams.rests[at + b + 1]
                gained = rest + pull[3] * d[3] * (gained * turn - rest) / (1.0 + d[3] * pull[3])
                impulse -= gained * xyz(pull)
            store_row(side.displacements, j, d + pack(d[3] * impulse, 0.0))
