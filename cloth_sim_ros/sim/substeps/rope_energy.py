# SPDX-License-Identifier: Apache-2.0
"""Elastic energy of a rope, and the work of clamps that twist it, for substeps/energy.py."""

import warp as wp

from cloth_sim_ros.sim.arrays.state import Arrays, HandleMotion
from cloth_sim_ros.sim.features.twist.arrays import Twist
from cloth_sim_ros.sim.features.twist.spread import stiffness_of
from cloth_sim_ros.sim.kernels.intrinsics import array_address, load4, xyz


@wp.func
def edge_of(k: int, x: wp.uint64, lo: wp.uint64) -> wp.vec3:
    """Vector from particle k to the next [m]."""
    return xyz((load4(x, k + 1) - load4(x, k)) + (load4(lo, k + 1) - load4(lo, k)))


@wp.func
def energy_of_stretch(j: int, b: int, placed: bool, a: Arrays) -> float:
    """Elastic energy [J] of segment j of body b along it: half its tension times its elongation.

    The tension is that of the solve. What the solve left of the elongation of a stiff segment is none. placed: True
    if positions may have been set since, so that the tension follows from the elongation.
    """
    body, m = a.model.bodies[b], a.model
    x, lo = array_address(a.state.positions, body.particles), array_address(a.state.position_lo, body.particles)
    rest = m.segment_length[body.segments + j]
    longer = wp.length(edge_of(j, x, lo)) - rest
    energy = 0.5 * a.state.rope.tensions[body.segments + j] * longer
    if placed:
        energy = wp.max(energy, 0.5 * longer * longer / (a.materials[b].compliance[0] * rest))
    return energy


@wp.func
def energy_of_joint(j: int, b: int, a: Arrays) -> float:
    """Elastic energy [J] of the joint between segments j and j + 1 of body b, by its bend and its twist."""
    body, m, material, twist = a.model.bodies[b], a.model, a.materials[b], a.state.twist
    x, lo = array_address(a.state.positions, body.particles), array_address(a.state.position_lo, body.particles)
    k = body.segments + j
    joint, energy = m.joints[k], float(0.0)
    turn = joint[3] * edge_of(j + 1, x, lo) - joint[2] * edge_of(j, x, lo)
    size = wp.length(turn)
    excess = (1.0 - joint[0] / wp.max(size, 1.0e-9)) * turn
    if twist.twisted.shape[0] > 0:
        excess -= twist.bends[k]
        if twist.twists[b].known == 1:
            angle = twist.twisted[k + 1].angle - twist.twisted[k].angle
            energy += 0.5 * stiffness_of(j, m, body, material, twist.twists[b].held) * angle * angle
    return energy + 0.5 * wp.length_sq(excess) / (material.compliance[2] * joint[1])


@wp.func
def elastic_of_rope(t: int, width: int, a: Arrays, b: int, placed: bool) -> wp.float64:
    """The part of the elastic energy [J] of rope b that thread t of `width` sums; see energy_of_stretch."""
    body, sum = a.model.bodies[b], wp.float64(0.0)
    for j in range(t, body.count - 1, width):
        sum += wp.float64(energy_of_stretch(j, b, placed, a))
        if a.model.joints.shape[0] > 0 and j + 2 < body.count:
            sum += wp.float64(energy_of_joint(j, b, a))
    return sum


@wp.func
def turn_of(handle: HandleMotion) -> float:
    """Angle by which a handle turns in the frame [rad]."""
    return 2.0 * wp.acos(wp.min(1.0, wp.abs(wp.dot(handle.start_orientation, handle.end_orientation))))


@wp.func
def work_of_clamps(a: Arrays, b: int, before: Twist) -> float:
    """Largest work [J] of the clamps of rope b that turned its ends in the frame; `before`: its twist as that began."""
    now = a.state.twist.twists[b]
    turned = wp.abs(now.wanted - before.turned)
    if now.start_by > 0:
        turned += turn_of(a.handles[now.start_by - 1])
    if now.end_by > 0:
        turned += turn_of(a.handles[now.end_by - 1])
    moment = wp.max(wp.abs(before.moment), wp.abs(now.moment))
    moment = wp.max(moment, wp.max(wp.abs(now.start_moment), wp.abs(now.end_moment)))
    return turned * moment


@wp.func
def is_rigid_rope(a: Arrays, b: int) -> bool:
    """True if rope b has an infinite stiffness, so that the energy it began with does not bound its motion."""
    stiff = a.materials[b].compliance
    rigid = stiff[0] == 0.0 or (a.model.joints.shape[0] > 0 and stiff[2] == 0.0)
    return rigid or (a.state.twist.twisted.shape[0] > 0 and stiff[1] == 0.0)
