# SPDX-License-Identifier: Apache-2.0
"""What the members of a subdomain do in a substep, and between runs of substeps (see subdomain_kernels.py)."""

import warp as wp

from cloth_sim_ros.sim.executors.subdomain_contact import make_clearance, travelled
from cloth_sim_ros.sim.executors.subdomain_forces import Carried, InSubdomain, Widths, make_impulse
from cloth_sim_ros.sim.executors.subdomain_plan import IN_REGISTERS, SWEPT
from cloth_sim_ros.sim.intrinsics import load4, store4, sync, xyz
from cloth_sim_ros.sim.model import Features
from cloth_sim_ros.sim.physics.integrate import Step, split_sum
from cloth_sim_ros.sim.stages.contact import TOUCHED, Met, make_touch, share_of
from cloth_sim_ros.sim.stages.here import Here
from cloth_sim_ros.sim.stages.motion import (
    first_share,
    pack,
    prediction,
    rate_of,
    sweep_collider,
)
from cloth_sim_ros.sim.stages.thickness import note_strain


def make_memory(capacity: int):
    """Two Warp functions: what member `at` carries, out of shared memory and into it."""

    @wp.func
    def load(shared: wp.uint64, at: int) -> Carried:
        now = Carried()
        now.x = load4(shared, at)
        low = load4(shared, at + capacity)
        now.low = xyz(low)
        now.clearance = low[3]
        now.v = xyz(load4(shared, at + 2 * capacity))
        return now

    @wp.func
    def store(now: Carried, shared: wp.uint64, at: int):
        store4(shared, at, now.x)
        store4(shared, at + capacity, pack(now.low, now.clearance))
        store4(shared, at + 2 * capacity, pack(now.v, 0.0))

    return load, store


def _make_move(features: Features, capacity: int, force):
    """A Warp function: member i one substep later; what is farther from all colliders than it can move skips them."""
    contact = make_touch(features) if features.shapes else None

    @wp.func
    def move(i: int, k: int, now: Carried, half: int, springs: force.Springs, here: InSubdomain, step: Step) -> Carried:
        w = now.x[3]
        a = here.frame.gravity - here.frame.global_damping * now.v
        a += w * force.of(half, now, springs, here.material.damping, here.shared)
        total = prediction(wp.vec3(0.0), now.v, a * first_share(step), step.eased, w, now.low, step)
        then = Carried()
        if wp.static(contact is not None):
            then.clearance = now.clearance - travelled(xyz(total))
            if then.clearance < 0.0:
                count = here.colliders.shape[0]
                other = wp.static(3 * capacity) - half
                store4(here.shared, other + i, total)
                met = Met()
                met.slot = here.block * wp.static(capacity) + i
                met.first_sweep = (here.block * wp.static(SWEPT) + k % wp.static(SWEPT)) * count
                met.share = share_of(step, here.frame.substeps)
                met.near = here.near
                met.colliders = here.colliders
                met.sweeps = here.subdomains.sweeps
                met.contacts = here.subdomains.contacts
                met.forces = here.subdomains.forces
                met.velocities = here.subdomains.velocities
                met.last_displacements = here.last_displacements
                member = Here()
                member.material = here.material
                member.x = here.shared + wp.uint64(16 * half)
                member.low = here.shared + wp.uint64(16 * (half + capacity))
                member.d = here.shared + wp.uint64(16 * other)
                for iteration in range(here.frame.iterations):
                    step.first = iteration == 0
                    step.repeats = here.frame.iterations > 1
                    member.step = step
                    touched = contact(i, met, member, 0.0) & TOUCHED
                    if touched != 0:
                        note_strain(force.strain(half, now, springs, here.shared), here.body, here.strain_found)
                total = load4(here.shared, other + i)
        d = xyz(total)
        then.v = rate_of(d - now.low, step)
        then.low = split_sum(xyz(now.x), d)
        then.x = pack(xyz(now.x) + d, w)
        return then

    return move


def make_substep(features: Features, capacity: int, keeps: bool, force):
    """A Warp function: substep k of the launch for all members that are still valid, from half `half` of the memory to
    the other. A member takes part while turns are `left`; where one thread has all, as many as its ring are none."""
    load, store = make_memory(capacity)
    move = _make_move(features, capacity, force)

    @wp.func
    def substep(
        mine: int,
        k: int,
        left: int,
        now: Carried,
        half: int,
        springs: force.Springs,
        here: InSubdomain,
        step: Step,
    ) -> Carried:
        other = wp.static(3 * capacity) - half
        if wp.static(keeps):
            if left > 0:
                own = springs
                if wp.static(force.width > IN_REGISTERS):
                    own = force.gather(mine, here)
                then = move(mine, k, now, half, own, here, step)
                store(then, here.shared, other + mine)
                now.x = then.x
                now.low = then.low
                now.v = then.v
                now.clearance = then.clearance
        else:
            for i in range(wp.static(capacity)):
                if here.subdomains.rings[here.subdomain * wp.static(capacity) + i] < left:
                    now = load(here.shared, half + i)
                    if now.x[3] > 0.0:
                        store(move(i, k, now, half, force.gather(i, here), here, step), here.shared, other + i)
        sync()
        return now

    return substep


def make_kick_all(features: Features, capacity: int, keeps: bool, widths: Widths):
    """A Warp function: slow forces act over `span` [s] on all members within `ring` of the subdomain's own, at
    `half`."""
    load, _ = make_memory(capacity)
    impulse = make_impulse(features, widths, capacity)

    @wp.func
    def kick_all(mine: int, now: Carried, ring: int, half: int, span: float, here: InSubdomain) -> Carried:
        other = wp.static(3 * capacity) - half
        if wp.static(keeps):
            v = now.v
            if here.subdomains.rings[here.subdomain * wp.static(capacity) + mine] <= ring:
                v = impulse(mine, half, now, span, here)
            sync()
            store4(here.shared, half + wp.static(2 * capacity) + mine, pack(v, 0.0))
            now.v = v
        else:
            for i in range(wp.static(capacity)):
                if here.subdomains.rings[here.subdomain * wp.static(capacity) + i] <= ring:
                    v = impulse(i, half, load(here.shared, half + i), span, here)
                    store4(here.shared, other + wp.static(2 * capacity) + i, pack(v, 0.0))
            for i in range(wp.static(capacity)):
                if here.subdomains.rings[here.subdomain * wp.static(capacity) + i] <= ring:
                    at = wp.static(2 * capacity) + i
                    store4(here.shared, half + at, load4(here.shared, other + at))
        sync()
        return now

    return kick_all


def make_look_out(features: Features, capacity: int, keeps: bool):
    """A Warp function: where colliders are in the next SWEPT substeps, and how far members are from them in these."""
    clearance = make_clearance(features)
    load, store = make_memory(capacity)

    @wp.func
    def look_out(t: int, mine: int, k: int, count: int, now: Carried, half: int, here: InSubdomain) -> Carried:
        colliders, first = here.colliders.shape[0], here.first + k
        ends = wp.min(wp.static(SWEPT), count - k)
        total = float(here.frame.substeps)
        for c in range(t, ends * colliders, wp.block_dim()):
            begin = float(first + c / colliders)
            here.subdomains.sweeps[here.block * wp.static(SWEPT) * colliders + c] = sweep_collider(
                here.colliders[c % colliders], begin / total, (begin + 1.0) / total
            )
        before, after = float(first) / total, float(first + ends) / total
        if wp.static(keeps):
            now.clearance = clearance(xyz(now.x), before, after, here)
        else:
            for i in range(wp.static(capacity)):
                member = load(here.shared, half + i)
                member.clearance = clearance(xyz(member.x), before, after, here)
                store(member, here.shared, half + i)
        sync()
        return now

    return look_out
