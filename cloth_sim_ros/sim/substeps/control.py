# SPDX-License-Identifier: Apache-2.0
"""The error of a frame is measured on the device, and the substeps of the next frames follow from it.

Every tenth of a second a frame is computed three times from the same state: with n/4, n/2, n substeps. The difference
D of the results of n and n/2 substeps, and its ratio to that of n/2 and n/4, give the order p at which the error falls,
and so the error D / (2^p - 1) of the frame (Richardson extrapolation). It contains all that depends on the length of a
substep: truncation in time, and what a single sweep of the constraints leaves.

The controller (Hairer, Norsett, Wanner, Solving Ordinary Differential Equations I, II.4) then takes as many substeps
that the errors of the frames in half a second add up to the wanted one.

A frame whose error is far beyond the wanted one is computed again with more substeps. Of frames with trials these are
the first, when nothing is known yet, as where a bent rope springs open, and the first after a body was placed.

The trials also tell how the work of contact falls with the substeps. Searches in a curved mesh go with the way of its
facets, not with the substeps. Then fewer of them save little time, and the body does not take fewer.

Between these frames the last substep of each tells how a sudden event changes its error, as a load that jerks its rope.
Its displacement differs from that by the trapezoidal rule by a quarter of h^3 x_ttt, where BDF2 errs by 2/9 of it. Such
a frame of a rope is computed again, too, as a whip is over before the next.
"""

from typing import Any

import warp as wp

from cloth_sim_ros.sim.arrays.state import Arrays, State, substeps_of
from cloth_sim_ros.sim.kernels.compiled import compiled
from cloth_sim_ros.sim.kernels.intrinsics import load_row, sync, xyz
from cloth_sim_ros.sim.substeps.arrays import StepLimits

_RARELY = 5  # periods from one measurement of bodies in step to the next
FIRST = wp.constant(4)  # number of frames at the start that are all measured
_PERIOD = 0.1  # time from one measurement to the next [s]
WINDOW = wp.constant(0.5)  # time over which solver.error counts [s]
# Truncation errors of all frames in a window add up. What a sweep leaves falls with the first power of the substeps; it
# pulls a body off its balance, to which it returns within this time [s]. Between these orders both are there, where
# steps are of second order.
RETURN, SWEEPS, TRUNCATES = wp.constant(0.08), wp.constant(1.0), wp.constant(1.4)
SAFETY = wp.constant(1.25)  # factor of estimates, as they are not exact
OF_ROPES = 1.5  # by how much truncation errors grow along the motion of a rope in a window, as in a whip
FEW = wp.constant(16)  # substeps below which trials are too coarse to tell the order, so all errors are added up
# The error is relative to the motion in the last window, and to this share of the body's size if it moved by less than
# another share of it. Then it is at rest, and only its static shape counts.
AT_REST, OF_SIZE = wp.constant(5.0e-3), wp.constant(0.1)
OF_START = wp.constant(2.0e-2)  # the same of a body that was let go, as nobody knows yet how far it moves
# Displacement in a window, as a share of the size, below which a body falls asleep: what float32 rounds.
STILL = wp.constant(6.0e-8)
# Bounds of the ratio of substeps in one change; ropes shrink less, as they whip before the next measurement.
MOST_GROWTH, LEAST_GROWTH, LEAST_OF_ROPES = wp.constant(3.0), wp.constant(0.65), wp.constant(0.8)
MOST_GROWN = wp.constant(4)  # largest factor over the most substeps that the budget pays without contact
SLOW_GROWTH = wp.constant(1.25)  # largest ratio where the error does not fall: less than one shrink undoes
FAR = wp.constant(2.0)  # a frame is computed again in more substeps if its error is so many times the wanted one
SPARE = wp.constant(0.9)  # substeps stay if this share of them would do
OVER = wp.constant(1.25)  # largest time beyond the budget, as a multiple of that in the fewest substeps


def is_measured(frame: int, frame_dt: float, in_step: bool = False) -> bool:
    """True if the error of a frame of this number and length [s] is measured: one in a period, and the first few.

    in_step: True for bodies that advance in step; their trials are dear, and one in five periods has to do.
    """
    if in_step:
        return frame % (_RARELY * period_of(frame_dt)) == 0
    return frame % period_of(frame_dt) == 0 or frame < FIRST


def period_of(frame_dt: float) -> int:
    """Number of frames of `frame_dt` [s] from one measurement to the next."""
    return max(1, round(_PERIOD / frame_dt))


@wp.func
def resample(g: int, longer: float, h: float, s: State):
    """Rewrite the last displacement and velocity of particle g for substeps `longer` times as long as `h` [s].

    They are read off the cubic through both ends of the last substep, or off the parabola if that has to be continued.
    """
    v, before, d = xyz(load_row(s.velocities, g)), s.last_velocities[g], s.last_displacements[g]
    a = h * (before + 2.0 * v) - 3.0 * d
    b = h * (before + v) - 2.0 * d
    if longer > 1.0:
        a = h * v - d
        b = wp.vec3(0.0)
    s.last_displacements[g] = longer * (h * v - longer * (a - longer * b))
    s.last_velocities[g] = v - (longer / h) * (2.0 * a - 3.0 * longer * b)


@wp.func
def resample_all(t: int, width: int, arrays: Arrays, b: int, old: int, new: int):
    """Resample the history of body b from `old` to `new` substeps of a frame."""
    if old != new:
        m = arrays.model.bodies[b]
        for i in range(t, m.count, width):
            resample(m.particles + i, float(old) / float(new), arrays.frames[0].length / float(old), arrays.state)


@wp.func
def forget_rope(a: Arrays, b: int):
    """Let a rope begin without history; what it did in a frame that is far too coarse is no guide, and adds energy."""
    if a.model.segment_length.shape[0] > 0 and a.state.history.shape[0] > 0:
        a.state.history[b] = 0


@wp.func
def take_substeps(t: int, width: int, arrays: Arrays, b: int, old: int, new: int, second: int):
    """Let body b take `new` substeps of a frame from now on, with its history resampled if it is of second order."""
    if second > 0:
        resample_all(t, width, arrays, b, old, new)
    sync()  # all threads have read what one will write
    if t == 0:
        arrays.state.control.substeps[b] = new
        if new > 2 * old:  # a history that is dropped costs a smooth motion accuracy
            forget_rope(arrays, b)


@wp.func
def apart(g: int, row: int, s: State, high: wp.array2d(dtype=wp.vec3), lo: wp.array2d(dtype=wp.vec3)) -> float:
    """Squared distance of particle g from where a trial left it [m^2]; then remember where it is now."""
    x, lost = xyz(load_row(s.positions, g)), xyz(load_row(s.position_lo, g))
    e = (x - high[row, g]) + (lost - lo[row, g])
    high[row, g] = x
    lo[row, g] = lost
    return wp.dot(e, e)


@wp.func
def total(part: Any):
    """Sum over the threads of a block, the same in all of them."""
    return wp.tile_sum(wp.tile(part, preserve_type=True))[0]


@wp.func
def size_of(squares: float, count: int, limits: StepLimits) -> float:
    """Root of the mean of `count` squares [m]; the body's size if a trial blew up or the body was not finite."""
    size = wp.sqrt(squares / float(count))
    return wp.where(wp.isfinite(size), size, limits.size)


@compiled
def begin_trial(given: wp.array(dtype=Arrays), tests: wp.array2d(dtype=int), second: int, divisor: int, block: int):
    bodies = given[0].limits.shape[0]
    k, t = wp.tid() / block, wp.tid() % block
    w, b = k / bodies, k % bodies
    s, n = given[w].state, substeps_of(given[w].state.control, given[w].limits[b], b)
    sync()  # all threads have read what one will write
    if t == 0:
        s.control.divisors[b] = divisor
        tests[0, k] = s.control.since[b][2]
    if second > 0:
        resample_all(t, block, given[w], b, n, wp.max(1, n / divisor))


@compiled
def change_substeps(given: wp.array(dtype=Arrays), substeps: int, second: int, block: int):
    bodies = given[0].limits.shape[0]
    k, t = wp.tid() / block, wp.tid() % block
    w, b = k / bodies, k % bodies
    s, limits = given[w].state, given[w].limits[b]
    chosen = s.control.substeps[b]
    wanted = substeps
    if substeps == 0:
        # Contact may have lowered them below the least.
        wanted = wp.where(chosen > 0, wp.clamp(chosen, limits.fewest, limits.most), 0)
    take_substeps(t, block, given[w], b, wp.where(chosen > 0, chosen, wanted), wanted, second)


@compiled
def end_trial(
    given: wp.array(dtype=Arrays),
    high: wp.array2d(dtype=wp.vec3),
    lo: wp.array2d(dtype=wp.vec3),
    differences: wp.array(dtype=float),
    tests: wp.array2d(dtype=int),
    block: int,
):
    bodies = given[0].limits.shape[0]
    k, t = wp.tid() / block, wp.tid() % block
    w, b = k / bodies, k % bodies
    m, s = given[w].model.bodies[b], given[w].state
    part = float(0.0)
    for i in range(t, m.count, block):
        part += apart(m.particles + i, w, s, high, lo)
    squares = total(part)
    if t == 0:
        differences[k] = size_of(squares, m.count, given[w].limits[b])
        tests[1, k] = s.control.since[b][2] - tests[0, k]


@wp.func
def is_all_redone(since: wp.vec4i, limits: StepLimits) -> bool:
    """True if every frame since the last measurement was computed again, which costs at least three times as much."""
    return since[0] > 0 and since[3] >= since[0] and limits.is_set == 0


@wp.func
def fixed_share(n: int, whole: int, half: int) -> float:
    """Share of the tests in a frame of n substeps that there are in fewer, too, if half of these have `half` tests."""
    if whole <= 0 or n < 2:
        return 0.0
    return wp.clamp((float(half) / float(whole) * float(n) - float(n / 2)) / float(n - n / 2), 0.0, 1.0)


@wp.func
def afforded(n: int, since: wp.vec4i, fixed: float, limits: StepLimits) -> int:
    """Substeps that the budget pays with as many tests for contact in a frame as `since` the last measurement.

    fixed: share of them that does not fall with the substeps. Twice n cost less than frames that are all computed
    again. Otherwise they fall slowly, and stay at n while some are. What slept has not met anything.
    """
    if since[1] == 0:
        return n
    if is_all_redone(since, limits):
        return wp.max(n, wp.min(2 * n, MOST_GROWN * limits.most))
    tests = limits.test * float(since[2])
    each, rest = 1.0 + (1.0 - fixed) * tests / float(since[1]), fixed * tests / float(since[0])
    over = OVER * (rest + each * float(limits.fewest)) - rest
    pays = wp.min(int(wp.max(float(limits.most) - rest, over) / each), limits.most)
    return wp.max(pays, wp.where(since[3] > 0, n, int(LEAST_GROWTH * float(n))))


@wp.func
def chosen(n: int, share: float, order: float, growth: float, least: int, most: int, error: float) -> int:
    """Substeps for the wanted error, from the share of the error of a frame of n substeps, and its order.

    Where errors do not fall as substeps double, as in chaos, more of them buy little. They grow by what they buy.
    growth: by how much errors grow along the motion, more than 1 of a rope.
    """
    ratio = wp.pow(share / error, 1.0 / wp.clamp(order, 1.0, 2.0))
    ratio = wp.max(ratio, wp.sqrt(wp.min(ratio, 1.0)))  # with fewer at once, a swing outruns the next measurement
    highest = wp.where(n < FEW, MOST_GROWTH, wp.max(SLOW_GROWTH, wp.pow(MOST_GROWTH, wp.min(order, 1.0))))
    lowest = wp.where(growth > 1.0, LEAST_OF_ROPES, LEAST_GROWTH)
    wanted = int(wp.ceil(float(n) * wp.clamp(ratio, lowest, highest)))
    if wanted <= n and float(wanted) > SPARE * float(n):
        wanted = n
    return wp.clamp(wanted, least, most)


@wp.func
def share_of(
    error: float, order: float, n: int, second: int, motion: float, length: float, growth: float, limits: StepLimits
) -> float:
    """Error of a frame of n substeps, summed over a window and relative to the motion in it [m]."""
    truncates = wp.clamp((order - SWEEPS) / (TRUNCATES - SWEEPS), 0.0, 1.0)
    if n < FEW or (second == 0 and motion >= AT_REST * limits.size):
        truncates = 1.0
    if motion < AT_REST * limits.size:
        motion = OF_SIZE * limits.size
    added = wp.lerp(RETURN, growth * WINDOW, truncates)
    return SAFETY * error * wp.max(added / length, 1.0) / motion


@wp.func
def is_pressed(g: int, a: Arrays) -> bool:
    """True if a collider pressed particle g in this frame; its velocity then jumps, by far more than steps err."""
    colliders, pressed = a.colliders.shape[0], bool(False)
    for c in range(colliders):
        pressed = pressed or wp.length_sq(xyz(load_row(a.state.contact.contact_forces, g * colliders + c))) > 0.0
    return pressed


@compiled
def watch(
    given: wp.array(dtype=Arrays), growth: float, wanted: wp.array(dtype=int), far: wp.array(dtype=int), block: int
):
    bodies = given[0].limits.shape[0]
    k, t = wp.tid() / block, wp.tid() % block
    w, b = k / bodies, k % bodies
    m, s, limits, length = given[w].model.bodies[b], given[w].state, given[w].limits[b], given[w].frames[0].length
    if s.control.asleep[b] > 0:
        return
    n, known = substeps_of(s.control, limits, b), s.control.errors[b]
    motion = wp.max(s.control.motions[b][0], s.control.motions[b][1])
    h, part = length / float(n), float(0.0)
    for i in range(t, m.count, block):
        g = m.particles + i
        if not is_pressed(g, given[w]):
            mean = 0.5 * (xyz(load_row(s.velocities, g)) + s.last_velocities[g])
            part += wp.length_sq(s.last_displacements[g] - h * mean)
    error = float(n) * size_of(total(part), m.count, limits)
    share = share_of(error, 2.0, n, 1, motion, length, growth, limits)
    pays = afforded(n, s.control.since[b], s.control.motions[b][3], limits)
    better = wp.max(n, chosen(n, share, 2.0, growth, n, pays, limits.error))
    take_substeps(t, block, given[w], b, n, better, 1)
    if t == 0:
        wanted[k] = better
        if growth > 1.0 and share > FAR * limits.error and n < better:
            wanted[k] = -better
            far[0] = 1
        share = wp.max(share, share_of(known[0], known[1], n, 1, motion, length, growth, limits))
        s.control.errors[b] = wp.vec4(known[0], known[1], known[2] + share * length / WINDOW, known[3])


@compiled
def control(
    given: wp.array(dtype=Arrays),
    high: wp.array2d(dtype=wp.vec3),
    lo: wp.array2d(dtype=wp.vec3),
    differences: wp.array(dtype=float),
    tests: wp.array2d(dtype=int),
    wanted: wp.array(dtype=int),
    most: wp.array(dtype=int),
    second: int,
    alone: int,
    watched: int,
    growth: float,
    far: wp.array(dtype=int),
    block: int,
):
    bodies = given[0].limits.shape[0]
    k, t = wp.tid() / block, wp.tid() % block
    w, b = k / bodies, k % bodies
    m, s, limits, length = given[w].model.bodies[b], given[w].state, given[w].limits[b], given[w].frames[0].length
    n, past, known = substeps_of(s.control, limits, b), s.control.motions[b], s.control.errors[b]
    since = s.control.since[b] + wp.vec4i(0)  # a copy, as one thread clears it
    elapsed = length * float(since[0])
    is_first = past[2] == 0.0
    is_early = past[1] == 0.0 and past[2] < (float(FIRST) - 0.5) * length
    begins = is_first or past[2] + elapsed > WINDOW
    part, moved = float(0.0), float(0.0)
    for i in range(t, m.count, block):
        g = m.particles + i
        part += apart(g, w, s, high, lo)
        x = xyz(load_row(s.positions, g))
        if not is_first:
            moved += wp.length_sq(x - s.control.anchors[g])
        if begins:
            s.control.anchors[g] = x
    fine, way = size_of(total(part), m.count, limits), size_of(total(moved), m.count, limits)
    # Differences fall at this order as the substeps double.
    order = wp.clamp(wp.log2(differences[k] / wp.max(fine, 1.0e-12)), 0.0, 2.0)
    error = fine / wp.max(wp.pow(2.0, order) - 1.0, 1.0)
    way = wp.max(past[0], way)
    motion = wp.max(wp.max(way, past[1]), wp.where(is_early and alone > 0, OF_START * limits.size, 0.0))
    share = share_of(error, order, n, second, motion, length, growth, limits)
    fixed = wp.where(since[3] == 0, fixed_share(n, since[2] - tests[0, k], tests[1, k]), past[3])
    pays = afforded(n, since, fixed, limits)
    # Substeps do not fall while frames are computed again, and rise if all of them were.
    least = wp.min(wp.where(since[3] > 0, n, limits.least), pays)
    if is_all_redone(since, limits):
        least = pays
    better = chosen(n, share, order, growth, least, pays, limits.error)
    if t == 0:
        # Watched frames since the last measurement were added before.
        grown = known[2] + share * wp.where(watched > 0, length, elapsed) / WINDOW
        if begins:
            s.control.motions[b] = wp.vec4(0.0, way, elapsed, fixed)
            s.control.errors[b] = wp.vec4(error, order, 0.0, grown)
        else:
            s.control.motions[b] = wp.vec4(way, past[1], past[2] + elapsed, fixed)
            s.control.errors[b] = wp.vec4(error, order, grown, known[3])
        s.control.since[b] = wp.vec4i(0)
        if begins and not is_first and limits.sleeps > 0 and way < STILL * limits.size:
            s.control.asleep[b] = 1
        wanted[k] = better
        most[k] = pays
        if alone > 0:
            s.control.substeps[b] = better
            if is_early and share > FAR * limits.error and n < pays:
                wanted[k] = -wp.min(int(MOST_GROWTH) * n, pays)  # trials are too coarse to tell the order
                far[0] = 1
    if alone > 0 and second > 0:
        resample_all(t, block, given[w], b, n, better)


@compiled
def begin_better(
    given: wp.array(dtype=Arrays), wanted: wp.array(dtype=int), far: wp.array(dtype=int), second: int, block: int
):
    bodies = given[0].limits.shape[0]
    k, t = wp.tid() / block, wp.tid() % block
    w, b = k / bodies, k % bodies
    if wp.tid() == 0:
        far[0] = 0
    if wanted[k] < 0:
        n = substeps_of(given[w].state.control, given[w].limits[b], b)
        take_substeps(t, block, given[w], b, n, -wanted[k], second)
