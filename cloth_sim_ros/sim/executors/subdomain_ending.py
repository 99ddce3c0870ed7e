# SPDX-License-Identifier: Apache-2.0
"""The kernels that end a frame of subdomains: what is good is kept, the rest put back (see subdomains.py)."""

import warp as wp

from cloth_sim_ros.sim.compiled import compiled
from cloth_sim_ros.sim.executors.buffers import make_buffer_of
from cloth_sim_ros.sim.executors.subdomain_plan import SubdomainArrays
from cloth_sim_ros.sim.intrinsics import load4, store_row
from cloth_sim_ros.sim.model import Features
from cloth_sim_ros.sim.stages.fault_recovery import count_fault, keep, put_back
from cloth_sim_ros.sim.state import State, given_type


@wp.func
def take_forces(slot: int, member: int, subdomains: SubdomainArrays, s: State):
    """What colliders did to a member of a subdomain in the frame goes to the state, if it is the subdomain's own."""
    colliders = s.contact_forces.shape[0] / s.positions.shape[0]
    for c in range(colliders):
        if subdomains.rings[member] == 0:
            s.contact_forces[subdomains.members[member] * colliders + c] = subdomains.forces[slot * colliders + c]
        subdomains.forces[slot * colliders + c] = wp.vec4(0.0)


def make_settle(features: Features, capacity: int, block: int, waits: bool):
    """The kernel that ends a frame: bodies that are good are kept, others put back."""
    buffer_of, argument = make_buffer_of(SubdomainArrays), given_type(features)

    @compiled(module="unique")
    def settle(given: argument, subdomains: SubdomainArrays, side: int, substeps: int):
        q = wp.tid() / wp.static(block)
        t = wp.tid() - q * wp.static(block)
        w = q / subdomains.body.shape[0]
        n = q - w * subdomains.body.shape[0]
        if wp.static(features.worlds):
            m = given[w].model
            s = given[w].state
        else:
            m = given.model
            s = given.state
        if wp.static(waits):
            if q == 0 and t == 0:
                subdomains.sent[0] += substeps
        last = buffer_of(s, subdomains, side, w)
        for i in range(t, wp.static(capacity), wp.static(block)):
            if wp.static(bool(features.shapes)):
                take_forces(q * wp.static(capacity) + i, n * wp.static(capacity) + i, subdomains, s)
            if subdomains.rings[n * wp.static(capacity) + i] == 0:
                g = subdomains.members[n * wp.static(capacity) + i]
                if s.faulty[subdomains.body[n]] == 1:
                    put_back(g, s.relapses[subdomains.body[n]], m, s)
                else:
                    keep(g, load4(last.positions, g), load4(last.low, g), s)
                    store_row(s.velocities, g, load4(last.velocities, g))

    return settle


def make_count_faults(features: Features):
    """The kernel that counts the bodies that were put back."""
    argument = given_type(features)

    @compiled(module="unique")
    def count_faults(given: argument):
        b = wp.tid()
        if wp.static(features.worlds):
            bodies = given[0].model.bodies.shape[0]
            w = b / bodies
            b -= w * bodies
            s = given[w].state
        else:
            s = given.state
        s.history[b] = wp.where(count_fault(b, s), 0, 1)

    return count_faults
