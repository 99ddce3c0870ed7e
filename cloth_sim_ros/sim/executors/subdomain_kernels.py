# SPDX-License-Identifier: Apache-2.0
"""The kernel of subdomains: several substeps a launch (see subdomains.py)."""

from functools import lru_cache

import warp as wp

from cloth_sim_ros.sim import intrinsics as native
from cloth_sim_ros.sim.compiled import compiled
from cloth_sim_ros.sim.executors.buffers import make_buffer_of
from cloth_sim_ros.sim.executors.halo_exchange import Exchange, exchange_of, receive, send
from cloth_sim_ros.sim.executors.subdomain_contact import travelled
from cloth_sim_ros.sim.executors.subdomain_ending import make_count_faults, make_settle
from cloth_sim_ros.sim.executors.subdomain_forces import Carried, InSubdomain, Widths, make_springs
from cloth_sim_ros.sim.executors.subdomain_plan import OUTSIDE, SWEPT, SubdomainArrays
from cloth_sim_ros.sim.executors.subdomain_substep import make_kick_all, make_look_out, make_memory, make_substep
from cloth_sim_ros.sim.intrinsics import load4, store4, sync, xyz
from cloth_sim_ros.sim.model import Features
from cloth_sim_ros.sim.physics.integrate import make_step, next_outer, outer_weight
from cloth_sim_ros.sim.stages.fault_recovery import is_good
from cloth_sim_ros.sim.stages.motion import (
    pack,
    spring_constants,
)
from cloth_sim_ros.sim.stages.near import everything
from cloth_sim_ros.sim.state import given_type


@lru_cache
def make_kernels(features: Features, capacity: int, block: int, widths: Widths, waits: bool) -> dict[str, wp.Kernel]:
    """The kernels for subdomains of `capacity` places and `block` threads, with what lies around a particle in
    `widths`.

    With a thread for every member (block > 1), it and its springs are read once a launch and stay in registers. On a
    CPU one thread has them all (block = 1) and reads them every substep. Where a subdomain `waits` for its neighbours,
    a launch is a whole frame.
    """
    return {
        "advance": _make_advance(features, capacity, block, widths, waits),
        "settle": make_settle(features, capacity, block, waits),
        "count_faults": make_count_faults(features),
    }


def _make_swap(features: Features):
    """A Warp function: the subdomain's own particles go to its neighbours before substep k, and the halo is
    received."""

    @wp.func
    def swap(ring: int, depth: int, k: int, now: Carried, exchange: Exchange):
        late = bool(False)
        if ring == 0:
            send(xyz(now.x), now.low, now.v, exchange, k)
        sync()  # what is sent does not wait behind what waits
        if 0 < ring and ring <= depth:
            message = receive(exchange, k)
            if wp.static(bool(features.shapes)):
                now.clearance -= travelled(xyz(message.x) - xyz(now.x))
            now.x = pack(xyz(message.x), now.x[3])
            now.low = xyz(message.low)
            now.v = xyz(message.v)
            late = message.late
        return now, late

    return swap


def _make_enter(features: Features):
    """A Warp function: what the members of subdomain n of world w are given, and the state of that world."""
    argument = given_type(features)

    @wp.func
    def enter(given: argument, subdomains: SubdomainArrays, w: int, n: int):
        body = subdomains.body[n]
        here = InSubdomain()
        here.subdomains = subdomains
        here.subdomain = n
        here.body = body
        # Each part by itself, so that the arrays of a single world stay in the kernel's constant arguments.
        if wp.static(features.worlds):
            s = given[w].state
            here.spring_types = given[w].model.spring_types
            here.frame = given[w].frames[0]
            here.material = given[w].materials[body]
            here.colliders = given[w].colliders
        else:
            s = given.state
            here.spring_types = given.model.spring_types
            here.frame = given.frames[0]
            here.material = given.materials[body]
            here.colliders = given.colliders
        here.last_displacements = s.last_displacements
        here.strain_found = s.strain_found
        if wp.static(bool(features.shapes)):
            here.near = everything(s.near, body, here.colliders.shape[0])
        here.constants = spring_constants(here.material)
        return here, s

    return enter


def _make_advance(features: Features, capacity: int, block: int, widths: Widths, waits: bool):
    """The kernel that makes `count` substeps from `first` on, out of one buffer (`side`) into the other.

    A launch begins with halos of `depth` rings. A substep uses up one of them, the slow forces as many as they reach
    (`widths.reach`). Runs of substeps lie between what a subdomain does for all of its members at once: the exchange
    with its neighbours, the slow forces, and a look at the colliders.
    """
    keeps, reach = block > 1, widths.reach
    force = make_springs(widths.springs, capacity)
    load, store = make_memory(capacity)
    substep = make_substep(features, capacity, keeps, force)
    kick_all = make_kick_all(features, capacity, keeps, widths) if features.has_outer else None
    look_out = make_look_out(features, capacity, keeps) if features.shapes else None
    swap = _make_swap(features) if waits else None
    buffer_of, argument = make_buffer_of(SubdomainArrays), given_type(features)
    tile_address = native.make_tile_address(6 * capacity)
    gather, enter = force.gather, _make_enter(features)

    # One block a multiprocessor is enough: with its registers the springs of a member do not wait for one another.
    @compiled(module="unique", launch_bounds=(block, 1))
    def advance(given: argument, subdomains: SubdomainArrays, side: int, first: int, count: int, depth: int):
        q = wp.tid() / wp.static(block)
        t = wp.tid() - q * wp.static(block)
        w = q / subdomains.body.shape[0]
        n = q - w * subdomains.body.shape[0]
        body = subdomains.body[n]
        here, s = enter(given, subdomains, w, n)
        here.block = q
        here.first = first
        here.shared = tile_address(wp.tile_empty(shape=(wp.static(6 * capacity),), dtype=wp.vec4, storage="shared"))
        step = make_step(here.frame.dt, first > 0 or s.history[body] > 0, 1, here.frame.global_damping)
        before = buffer_of(s, subdomains, side, w)
        now = Carried()
        mine = t
        if wp.static(keeps):
            mine = subdomains.places[n * wp.static(block) + t]
        for i in range(mine, wp.static(capacity), wp.static(capacity if keeps else 1)):
            g = subdomains.members[n * wp.static(capacity) + i]
            now.x = load4(before.positions, g)
            now.low = xyz(load4(before.low, g))
            now.v = xyz(load4(before.velocities, g))
            store(now, here.shared, i)
            store(now, here.shared, wp.static(3 * capacity) + i)  # where what is pinned stays
        springs = gather(mine, here)
        ring = subdomains.rings[n * wp.static(capacity) + mine]
        lag = int(0)
        if wp.static(keeps):
            # What is pinned needs no turn: it lies in both halves of the memory.
            lag = wp.where(now.x[3] > 0.0, ring, wp.static(OUTSIDE))
        exchange = Exchange()
        if wp.static(waits):
            particle = w * s.positions.shape[0] + subdomains.members[n * wp.static(capacity) + mine]
            exchange = exchange_of(particle, subdomains.positions.shape[0], subdomains.messages, subdomains.sent[0])
        sync()
        left = depth
        k = int(0)
        half = int(0)
        goes_on = bool(True)
        while goes_on:
            ends = k == count
            weight = float(0.0)
            if wp.static(features.has_outer):
                weight = outer_weight(first + k, here.frame.substeps, here.frame.outer)
            rings = wp.where(weight > 0.0, wp.static(reach), 0) + wp.where(ends, 0, 1)
            if wp.static(waits):
                if left < rings:
                    now, late = swap(ring, depth, k, now, exchange)
                    if late:
                        exchange.patience = 0
                        s.faulty[body] = 1
                    exchange.side = 1 - exchange.side
                    left = depth
            if ends and (weight == 0.0 or first + k < here.frame.substeps or left < rings):
                break  # what lacks rings is left to the next launch
            if wp.static(keeps):
                # Every run begins in the first half, so that the halves are constants.
                store(now, here.shared, mine)
                sync()
            run = wp.min(count - k, left)
            if wp.static(look_out is not None):
                if k % wp.static(SWEPT) == 0 and not ends:
                    now = look_out(t, mine, k, count, now, half, here)
                run = wp.min(run, wp.static(SWEPT) - k % wp.static(SWEPT))
            if wp.static(kick_all is not None):
                if weight > 0.0:
                    left -= wp.static(reach)
                    now = kick_all(mine, now, left, half, weight * here.frame.dt, here)
                run = wp.min(run, next_outer(first + k, here.frame.substeps, here.frame.outer) - first - k)
                run = wp.min(run, left)
            turns = left - lag
            if wp.static(keeps):
                turns = wp.min(turns, run)
            for turn in range(0, run, wp.static(2 if keeps else 1)):
                now = substep(mine, k + turn, turns - turn, now, half, springs, here, step)
                step.second = True
                if wp.static(keeps):
                    # Two substeps a round. A CPU's compiler would round their two copies differently.
                    later = wp.static(3 * capacity)
                    now = substep(mine, k + turn + 1, turns - turn - 1, now, later, springs, here, step)
                else:
                    half = wp.static(3 * capacity) - half
            k += run
            left -= run
            goes_on = not ends
        after = buffer_of(s, subdomains, 1 - side, w)
        for i in range(mine, wp.static(capacity), wp.static(capacity if keeps else 1)):
            if subdomains.rings[n * wp.static(capacity) + i] == 0:
                g = subdomains.members[n * wp.static(capacity) + i]
                if wp.static(not keeps):
                    now = load(here.shared, half + i)
                v = pack(now.v, 0.0)
                store4(after.positions, g, now.x)
                store4(after.low, g, pack(now.low, 0.0))
                store4(after.velocities, g, v)
                if first + count == here.frame.substeps and not is_good(now.x, v):
                    s.faulty[body] = 1

    return advance
