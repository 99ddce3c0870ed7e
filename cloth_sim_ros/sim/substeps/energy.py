# SPDX-License-Identifier: Apache-2.0
"""The energy of each body before and after a frame. A frame that gains energy is rejected, and computed again.

A frame may not end with more than the `ceiling`, plus the work of hands, colliders and air in it. The ceiling is the
energy of the last frames: it falls towards the energy by a tenth of the difference a frame, so that energy may go to
and fro between springs that a sweep has not solved and motion. What is changed between frames moves it.

Elastic energy is half the force of each spring times its elongation. That holds for springs of their own, and for those
of a membrane, whose forces are linear in all elongations. That of ropes is in rope_energy.py.
"""

import warp as wp

from cloth_sim_ros.sim.arrays.state import Arrays, compliance_of, rests, substeps_of
from cloth_sim_ros.sim.features.collider_contact.sweep import slip_of, sweep_collider
from cloth_sim_ros.sim.features.plate.bending import around, curve_moment, rigidity_of
from cloth_sim_ros.sim.features.twist.arrays import Twist
from cloth_sim_ros.sim.kernels.compiled import compiled
from cloth_sim_ros.sim.kernels.intrinsics import array_address, load4, load_row, sync, xyz
from cloth_sim_ros.sim.lines.membrane import coupled_length
from cloth_sim_ros.sim.physics.integrate import effective_step
from cloth_sim_ros.sim.physics.plate import rest_curvature
from cloth_sim_ros.sim.substeps.control import forget_rope, resample_all, total
from cloth_sim_ros.sim.substeps.rope_energy import elastic_of_rope, is_rigid_rope, work_of_clamps

FALLS = wp.constant(wp.float64(0.1))  # share by which the ceiling falls towards the energy in a frame
FADES = wp.constant(wp.float64(0.98))  # share of the scale that is left a frame later
# Largest gain in a frame over the scale: the largest kinetic and elastic energy of the last frames, or this share of
# the work of its weight over its size, or the kinetic energy at this speed [m/s].
MOST_GAIN, OF_FALL, SLOW = wp.constant(wp.float64(0.02)), wp.constant(3.0e-3), wp.constant(2.0e-2)
MORE = wp.constant(2)  # factor of the substeps from one repetition to the next
MOST_REPEATED = wp.constant(64)  # largest factor of the substeps
NONE = wp.constant(wp.float64(1.0e300))  # no gain is known
FINEST = wp.constant(2000)  # substeps from which on more do not help, as float32 rounds what happens in one


@wp.struct
class Energies:
    """Energies [J]: kinetic, elastic, that of the weight, zero at the origin, and the work done in the frame."""

    kinetic: wp.float64
    elastic: wp.float64
    weight: wp.float64
    work: wp.float64


@wp.func
def energy_of_spring(k: int, kind: int, b: int, a: Arrays) -> float:
    """Elastic energy [J] of the spring in slot k of body b; a rigid one has none."""
    m, body = a.model, a.model.bodies[b]
    x, lo = array_address(a.state.positions, body.particles), array_address(a.state.position_lo, body.particles)
    i, j, rest = m.line_nodes[k], m.line_others[k], m.line_rests[k]
    length = wp.length(xyz((load4(x, j) - load4(x, i)) + (load4(lo, j) - load4(lo, i))))
    stretched = length - rest
    if m.line_bases.shape[0] > 0:
        stretched = length - coupled_length(k, x, lo, m)
    compliance = m.line_scales[k] * compliance_of(a.materials[b], kind)
    return wp.where(compliance > 0.0, 0.5 * (length - rest) * stretched / wp.max(compliance, 1.0e-30), 0.0)


@wp.func
def part_of(
    t: int, width: int, a: Arrays, b: int, families: wp.array(dtype=wp.vec4i), second: int, placed: bool
) -> Energies:
    """The part of the energies of body b that thread t of `width` sums; placed: see rope_energy.py."""
    e = Energies()
    m, s, body, material = a.model, a.state, a.model.bodies[b], a.materials[b]
    x, lo = array_address(s.positions, body.particles), array_address(s.position_lo, body.particles)
    rigidity = float(0.0)
    if body.plate_width > 0:
        usual = substeps_of(s.control, a.limits[b], b) / wp.max(1, s.control.factors[b])
        h = effective_step(a.frames[0].length / float(usual), second > 0)
        rigidity = rigidity_of(material, body, 1.0 / (h * h))
    for i in range(t, body.count, width):
        place = load4(x, i)
        if place[3] > 0.0:
            v, mass = xyz(load_row(s.velocities, body.particles + i)), 1.0 / place[3]
            e.kinetic += wp.float64(0.5 * mass * wp.dot(v, v))
            e.weight -= wp.float64(mass) * wp.dot(wp.vec3d(xyz(place)), wp.vec3d(a.frames[0].gravity))
        if body.plate_width > 0:
            e.elastic += wp.float64(0.5 * rigidity * wp.dot(xyz(place), around(i, m, body, x, lo)))
    for c in range(body.curves + t, body.curves_end, width):
        p, q, r, moment = curve_moment(c, m, x, lo, lo)
        e.elastic -= wp.float64(rigidity * wp.dot(rest_curvature(p, q, r, moment).normal, moment))
    for f in range(families.shape[0]):
        family = families[f]
        if family[0] == b:
            for k in range(family[2] + t, family[3], width):
                if m.line_rests[k] >= 0.0:
                    e.elastic += wp.float64(energy_of_spring(k, family[1], b, a))
    if m.segment_length.shape[0] > 0 and not is_rigid_rope(a, b):
        e.elastic += elastic_of_rope(t, width, a, b, placed)
    return e


@wp.func
def summed(k: int, parts: wp.array2d(dtype=Energies)) -> Energies:
    """Sum of the parts of body k of all worlds that its blocks have found."""
    e = Energies()
    for q in range(parts.shape[1]):
        part = parts[k, q]
        e.kinetic += part.kinetic
        e.elastic += part.elastic
        e.weight += part.weight
        e.work += part.work
    return e


@wp.func
def most_of_air(
    p: int, a: Arrays, b: int, starts: wp.array(dtype=wp.vec4), start_velocities: wp.array(dtype=wp.vec4)
) -> float:
    """Largest work [J] of the air on panel p of body b in the frame: its largest force, times the way of the panel.

    The force is largest where the frame begins, as drag takes relative velocity away.
    """
    s, frame, corners, first = a.state, a.frames[0], a.model.panels[p], a.model.bodies[b].particles
    move, velocity = wp.vec3(0.0), wp.vec3(0.0)
    count = wp.where(corners[2] < 0, 2, 3)
    for c in range(count):
        g = first + corners[c]
        move += xyz(load_row(s.positions, g) - load_row(starts, g)) / float(count)
        velocity += xyz(load_row(start_velocities, g)) / float(count)
    origin = xyz(load_row(s.positions, first + corners[0]))
    e = xyz(load_row(s.positions, first + corners[1])) - origin
    area = 2.0 * a.materials[b].thickness * wp.length(e)
    if count == 3:
        area = 0.5 * wp.length(wp.cross(e, xyz(load_row(s.positions, first + corners[2])) - origin))
    pressure = 0.5 * frame.air_density * (frame.drag + 2.0 * frame.lift) * wp.length_sq(frame.wind - velocity)
    return pressure * area * wp.length(move)


@wp.func
def work_on(
    t: int, width: int, a: Arrays, b: int, starts: wp.array(dtype=wp.vec4), start_velocities: wp.array(dtype=wp.vec4)
) -> float:
    """The part of thread t of the work [J] done on body b in the frame, by all that did work on a particle.

    starts, start_velocities: of particles when the frame began. It takes the mean forces of hands and colliders over
    the frame, and a bound for the air. A soft collider gives back what it took, so its force goes with the body's own
    way too.
    """
    s, body, colliders = a.state, a.model.bodies[b], a.colliders.shape[0]
    work = float(0.0)
    for i in range(t, body.count, width):
        g = body.particles + i
        move = xyz(load_row(s.positions, g) - load_row(starts, g))
        if s.grasp.grip_forces.shape[0] > 0:
            if s.grasp.held[b] > 0:
                if s.grasp.grips[g][3] > 0.0:
                    work += wp.max(0.0, wp.dot(move, xyz(load_row(s.grasp.grip_forces, g))))
        if s.contact.pinch_pulls.shape[0] > 0:
            work += wp.max(0.0, wp.dot(move, xyz(load_row(s.contact.pinch_pulls, g))))
        for c in range(colliders):
            force = xyz(load_row(s.contact.contact_forces, g * colliders + c))
            if wp.length_sq(force) > 0.0:
                sweep = sweep_collider(a.colliders[c], 0.0, 1.0)
                start = xyz(load_row(starts, g)) - sweep.position
                slip = wp.transpose(sweep.to_local) * slip_of(start, move, sweep)
                own = wp.where(a.colliders[c].compliance > 0.0, wp.dot(move, force), 0.0)
                work += wp.max(0.0, wp.max(own, wp.dot(move - slip, force)))
    if s.air.panel_forces.shape[0] > 0:
        for p in range(body.panels + t, body.panels_end, width):
            work += most_of_air(p, a, b, starts, start_velocities)
    return work


@wp.func
def is_elastic(a: Arrays, b: int, families: wp.array(dtype=wp.vec4i)) -> bool:
    """True if nothing of body b is rigid, so that the energy it began with bounds its motion."""
    rigid = bool(a.model.segment_length.shape[0] > 0 and is_rigid_rope(a, b))
    for f in range(families.shape[0]):
        rigid = rigid or (families[f][0] == b and compliance_of(a.materials[b], families[f][1]) == 0.0)
    return not rigid


@wp.func
def mass_of(a: Arrays, b: int) -> float:
    """Mass of body b [kg]."""
    return 1.0 / wp.max(a.materials[b].largest_inverse_mass * a.model.bodies[b].yielding, 1.0e-30)


@wp.func
def slow_energy(a: Arrays, b: int) -> wp.float64:
    """Kinetic energy [J] below which body b gains none, but settles: in other substeps it rests a little elsewhere."""
    return wp.float64(0.5 * SLOW * SLOW * mass_of(a, b))


@wp.func
def least_scale(a: Arrays, b: int) -> wp.float64:
    """Least energy [J] by which gains are judged."""
    return wp.float64(OF_FALL * wp.length(a.frames[0].gravity) * a.limits[b].size * mass_of(a, b)) + slow_energy(a, b)


@wp.func
def is_known(a: Arrays, b: int) -> bool:
    """True if nothing was changed since the energy of body b was found last, or if it rests."""
    known = a.state.control.ledgers[b][1] > wp.float64(0.0) and a.frames[0].wakes == 0
    return known or rests(a.state.control, a.frames[0], b)


@compiled
def find_energies(
    given: wp.array(dtype=Arrays),
    families: wp.array(dtype=wp.vec4i),
    starts: wp.array2d(dtype=wp.vec4),
    start_velocities: wp.array2d(dtype=wp.vec4),
    start_twists: wp.array2d(dtype=Twist),
    opens: int,
    second: int,
    block: int,
    parts: wp.array2d(dtype=Energies),
):
    """Let each block of a body find its part of the energies; `opens`: 1 where the frame begins, without work."""
    bodies, blocks = given[0].limits.shape[0], parts.shape[1]
    q, t = wp.tid() / block, wp.tid() % block
    k = q / blocks
    w, b = k / bodies, k % bodies
    if rests(given[w].state.control, given[w].frames[0], b) or (opens > 0 and is_known(given[w], b)):
        return
    first, width = (q % blocks) * block + t, blocks * block
    part = part_of(first, width, given[w], b, families, second, opens > 0)
    if opens == 0:
        part.work = wp.float64(work_on(first, width, given[w], b, starts[w], start_velocities[w]))
        if first == 0 and start_twists.shape[1] > 0:
            part.work += wp.float64(work_of_clamps(given[w], b, start_twists[w, b]))
    sum = Energies()
    sum.kinetic = total(part.kinetic)
    sum.elastic = total(part.elastic)
    sum.weight = total(part.weight)
    sum.work = total(part.work)
    if t == 0:
        parts[k, q % blocks] = sum


@compiled
def open_frames(
    given: wp.array(dtype=Arrays),
    parts: wp.array2d(dtype=Energies),
    factors: wp.array(dtype=int),
    best: wp.array(dtype=wp.vec2d),
):
    k = wp.tid()
    bodies = given[0].limits.shape[0]
    a, b = given[k / bodies], k % bodies
    factors[k] = 0
    best[k] = wp.vec2d(NONE, wp.float64(0.0))
    if is_known(a, b):
        return
    e, ledger = summed(k, parts), a.state.control.ledgers[b]
    now = e.kinetic + e.elastic + e.weight
    ceiling, scale = ledger[0] + (now - ledger[2]), ledger[1]
    if scale == wp.float64(0.0):
        ceiling, scale = now, wp.max(e.kinetic + e.elastic, least_scale(a, b))
    a.state.control.ledgers[b] = wp.vec4d(ceiling, scale, now, e.weight)


@wp.func
def next_factor(gain: wp.float64, substeps: int, factor: int, best: wp.vec2d) -> int:
    """Factor of the substeps with which a frame that gained energy [J] is computed again; `factor` if it is kept.

    gain: NONE if it was not finite. best: least gain so far, and its factor. Where no factor helps, that is taken, as
    a negative number. It is final.
    """
    if factor < MOST_REPEATED and (substeps < FINEST or gain == NONE):
        return MORE * wp.max(1, factor)
    if best[1] > wp.float64(0.0) and best[0] < gain:
        return -int(best[1])
    return factor


@compiled
def judge_frames(
    given: wp.array(dtype=Arrays),
    families: wp.array(dtype=wp.vec4i),
    parts: wp.array2d(dtype=Energies),
    recoveries: wp.array2d(dtype=int),
    factors: wp.array(dtype=int),
    best: wp.array(dtype=wp.vec2d),
    rejects: wp.array(dtype=int),
):
    k = wp.tid()
    bodies = given[0].limits.shape[0]
    a, b = given[k / bodies], k % bodies
    if rests(a.state.control, a.frames[0], b):
        return
    e, ledger = summed(k, parts), a.state.control.ledgers[b]
    scale = wp.max(ledger[1], wp.abs(e.weight - ledger[3]))
    now, ceiling = e.kinetic + e.elastic + e.weight, ledger[0] + e.work
    gains = is_elastic(a, b, families) and not (now <= ceiling + MOST_GAIN * scale or e.kinetic <= slow_energy(a, b))
    recovered = a.state.recoveries[b] != recoveries[k / bodies, b]
    if (gains or recovered) and factors[k] >= 0:
        gain = wp.where(recovered or not wp.isfinite(now), NONE, now - ceiling)
        again = next_factor(gain, substeps_of(a.state.control, a.limits[b], b), factors[k], best[k])
        if again != factors[k]:
            # Stores before the last read of `a` would have all of it copied, which takes 30 s to compile for a GPU.
            best[k] = wp.where(gain < best[k][0], wp.vec2d(gain, wp.float64(wp.max(1, factors[k]))), best[k])
            factors[k] = again
            rejects[0] = 1
            return
    ceiling = wp.max(now, ceiling - FALLS * (ceiling - now))
    scale = wp.max(wp.max(FADES * scale, e.kinetic + e.elastic), least_scale(a, b))
    a.state.control.ledgers[b] = wp.vec4d(ceiling, scale, now, e.weight)
    if factors[k] != 0:
        a.state.control.redone[b] += 1
        a.state.control.since[b] += wp.vec4i(0, 0, 0, 1)


@wp.func
def change_factor(t: int, width: int, a: Arrays, b: int, factor: int):
    """Multiply the substeps that are chosen for body b by `factor` from now on; 0 leaves them."""
    before = substeps_of(a.state.control, a.limits[b], b)
    after = before / wp.max(1, a.state.control.factors[b]) * wp.max(1, factor)
    sync()  # all threads have read what one will write
    if a.state.last_displacements.shape[0] > 0:
        resample_all(t, width, a, b, before, after)
    if t == 0:
        a.state.control.factors[b] = factor
        forget_rope(a, b)


@compiled
def begin_again(given: wp.array(dtype=Arrays), factors: wp.array(dtype=int), rejects: wp.array(dtype=int), block: int):
    k, t = wp.tid() / block, wp.tid() % block
    bodies = given[0].limits.shape[0]
    if wp.tid() == 0:
        rejects[0] = 0
    if factors[k] != 0:
        change_factor(t, block, given[k / bodies], k % bodies, wp.abs(factors[k]))


@compiled
def end_again(given: wp.array(dtype=Arrays), factors: wp.array(dtype=int), block: int):
    k, t = wp.tid() / block, wp.tid() % block
    bodies = given[0].limits.shape[0]
    a, b = given[k / bodies], k % bodies
    used = a.state.control.factors[b]
    # A rejected frame has another factor by now.
    if used > 0 and used == wp.abs(factors[k]):
        change_factor(t, block, a, b, 0)
