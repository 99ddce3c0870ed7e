# SPDX-License-Identifier: Apache-2.0
"""Stitches between a rope and a sheet, which the solve of the rope takes as it takes contact.

A rope that is solved without the load of its stitches gives way by h_e^2 F / m at each. It would then be longer in
longer substeps, and a load on it would be flung where their number changes. So the other side of a stitch is eliminated
before: there its particles yield by Y to a force, with all that they drag along. The rope then feels

    F = -K (gap + c F_before),    K = (c + Y)^-1,

where the gap moves with the rope and c is the compliance. After the solve the other side moves by Y F.
"""

import warp as wp

from cloth_sim_ros.sim.features.seams.arrays import CLOSED
from cloth_sim_ros.sim.features.seams.bodies import Seams, SewnArrays, Stitch
from cloth_sim_ros.sim.features.seams.stitch import (
    COMPLIANCE,
    Tie,
    all_yield,
    gap_of,
    number_of_particle,
    place_along,
    segment_at,
    square_step,
    tie_of,
    yields,
)
from cloth_sim_ros.sim.kernels.intrinsics import add_exactly, load_row, xyz
from cloth_sim_ros.sim.ropes.arrays import Sewn

# A rigid stitch to what yields nothing yields by this share of what a particle of the rope alone would: float32
# displacements leave the force four digits.
_LEAST = wp.constant(1.0e-3)


@wp.func
def _stiffness(seams: Seams, stitch: Stitch, tie: Tie, compliance: float, w: int, substep: int) -> wp.mat33:
    """Return K [N/m]."""
    inverse = all_yield(seams, stitch, tie, w, substep, stitch.held, _LEAST)
    unit = wp.identity(n=3, dtype=float)
    slides = wp.outer(tie.along, tie.along)
    inverse = (unit - slides) * inverse * (unit - slides)
    size = wp.trace(inverse) + compliance
    if size == 0.0:
        return wp.mat33(0.0)
    return (unit - slides) * wp.inverse((inverse + compliance * unit) / size + slides) / size


@wp.func
def hold(seams: Seams, k: int, w: int, substep: int):
    """Tell the solve of a rope what the stitches at its touched particle k do to it."""
    of = seams.touched[k]
    rope, now = seams.arrays[of[0] * seams.worlds + w], Sewn()
    square = square_step(rope, of[2], of[3], substep)
    now.start = xyz(load_row(rope.displacements, of[1]))
    for q in range(seams.hold_starts[k], seams.hold_starts[k + 1]):
        stitch = seams.stitches[seams.holds[q]]
        first = seams.arrays[stitch.batches[0] * seams.worlds + w]
        state = first.seams.stitches[stitch.number]
        if stitch.rope[0] >= 0:  # most of those that slide are elsewhere
            behind = of[1] - stitch.rope[0] - segment_at(stitch, place_along(stitch, state[0]))
            if behind < 0 or behind > 1:
                continue
        tie = tie_of(seams, stitch, state, w, False)
        own, beyond = float(0.0), float(0.0)
        for e in range(2):
            a, b = 2 * stitch.held + e, 2 * stitch.held + 1 - e
            if tie.particles[a] == of[1]:
                own += tie.weights[a]
                if tie.particles[b] == of[1] + 1:
                    beyond = tie.weights[b]
        if state[1] == CLOSED and own != 0.0:
            compliance = first.numbers[stitch.row].values[COMPLIANCE]
            stiffness = square * _stiffness(seams, stitch, tie, compliance, w, substep)
            left = gap_of(seams, tie, True) + compliance * first.seams.stitch_forces[stitch.number]
            now.pull -= own * (stiffness * left)
            now.hold += own * own * stiffness
            now.beyond += own * beyond * stiffness
    rope.rope_sewn[of[1]] = now


@wp.func
def take(seams: Seams, s: int, w: int, substep: int):
    """Let the other side of stitch s follow the rope, and note the force."""
    stitch = seams.stitches[s]
    if stitch.held < 0:
        return
    first = seams.arrays[stitch.batches[0] * seams.worlds + w]
    state = first.seams.stitches[stitch.number]
    if state[1] != CLOSED:
        return
    tie = tie_of(seams, stitch, state, w, False)
    compliance, force = first.numbers[stitch.row].values[COMPLIANCE], first.seams.stitch_forces[stitch.number]
    more = -_stiffness(seams, stitch, tie, compliance, w, substep) * (gap_of(seams, tie, True) + compliance * force)
    first.seams.stitch_forces[stitch.number] = force + more
    for k in range(4):
        if tie.weights[k] != 0.0 and k / 2 != stitch.held:
            move = yields(seams, stitch, tie, k, w, substep) * more
            add_exactly(seams.moves, 3 * number_of_particle(seams, stitch, tie, k, w), move)


@wp.func
def _move_of(rope: SewnArrays, i: int) -> wp.vec3:
    """Return the move of a sewn particle since `hold` [m]."""
    return xyz(load_row(rope.displacements, i)) - rope.rope_sewn[i].start


@wp.func
def keep(seams: Seams, k: int, w: int):
    """Let the next solve of this substep know what the stitches at touched particle k of a rope did in this one."""
    of = seams.touched[k]
    rope = seams.arrays[of[0] * seams.worlds + w]
    if seams.hold_starts[k + 1] > seams.hold_starts[k] and rope.frames[0].iterations > 1:
        now = rope.rope_sewn[of[1]]
        pulled = now.pull - now.hold * _move_of(rope, of[1])
        if wp.trace(now.beyond) != 0.0:
            pulled -= now.beyond * _move_of(rope, of[1] + 1)
        before = rope.rope_sewn[wp.max(of[1] - 1, 0)].beyond
        if of[1] > 0 and wp.trace(before) != 0.0:
            pulled -= before * _move_of(rope, of[1] - 1)
        inverse = load_row(rope.displacements, of[1])[3]
        rope.rope_targets[of[1]] = rope.rope_targets[of[1]] + inverse * pulled
