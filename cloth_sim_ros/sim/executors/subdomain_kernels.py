# SPDX-License-Identifier: Apache-2.0
"""The kernels of subdomains: several substeps a launch, and the watch at the end of a frame (see subdomains.py)."""

from functools import lru_cache

import warp as wp

from cloth_sim_ros.sim import intrinsics as native
from cloth_sim_ros.sim.compiled import compiled
from cloth_sim_ros.sim.executors.buffers import make_buffer_of
from cloth_sim_ros.sim.executors.halo_exchange import Exchange, exchange_of, receive, send
from cloth_sim_ros.sim.executors.subdomain_contact import make_clearance, travelled
from cloth_sim_ros.sim.executors.subdomain_forces import Carried, InSubdomain, Widths, make_impulse, make_springs
from cloth_sim_ros.sim.executors.subdomain_plan import IN_REGISTERS, OUTSIDE, SWEPT, SubdomainArrays
from cloth_sim_ros.sim.intrinsics import load4, store4, store_row, sync, xyz
from cloth_sim_ros.sim.model import Features
from cloth_sim_ros.sim.physics.integrate import Step, make_step, next_outer, outer_weight, split_sum
from cloth_sim_ros.sim.stages.contact import Met, make_touch, share_of
from cloth_sim_ros.sim.stages.fault_recovery import count_fault, is_good, keep, put_back
from cloth_sim_ros.sim.stages.motion import (
    first_share,
    pack,
    prediction,
    rate_of,
    spring_constants,
    sweep_collider,
)
from cloth_sim_ros.sim.stages.near import everything
from cloth_sim_ros.sim.state import State, given_type


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
        "settle": _make_settle(features, capacity, block, waits),
        "count_faults": _make_count_faults(features),
    }


def _make_memory(capacity: int):
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
                met.sweeps = here.subdomains.sweeps
                met.contacts = here.subdomains.contacts
                met.forces = here.subdomains.forces
                met.velocities = here.subdomains.velocities
                met.last_displacements = here.last_displacements
                for iteration in range(here.frame.iterations):
                    step.first = iteration == 0
                    step.repeats = here.frame.iterations > 1
                    contact(
                        i,
                        met,
                        here.material,
                        here.colliders,
                        step,
                        here.shared + wp.uint64(16 * half),
                        here.shared + wp.uint64(16 * (half + capacity)),
                        here.shared + wp.uint64(16 * other),
                        0.0,
                    )
                total = load4(here.shared, other + i)
        d = xyz(total)
        then.v = rate_of(d - now.low, step)
        then.low = split_sum(xyz(now.x), d)
        then.x = pack(xyz(now.x) + d, w)
        return then

    return move


def _make_substep(features: Features, capacity: int, keeps: bool, force):
    """A Warp function: substep k of the launch for all members that are still valid, from half `half` of the memory to
    the other. A member takes part while `turn` is below its `turns`; where one thread has all, turns count from its
    ring."""
    load, store = _make_memory(capacity)
    move = _make_move(features, capacity, force)

    @wp.func
    def substep(
        mine: int,
        k: int,
        turn: int,
        turns: int,
        now: Carried,
        half: int,
        springs: force.Springs,
        here: InSubdomain,
        step: Step,
    ) -> Carried:
        other = wp.static(3 * capacity) - half
        if wp.static(keeps):
            if turn < turns:
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
                if turn < turns - here.subdomains.rings[here.subdomain * wp.static(capacity) + i]:
                    now = load(here.shared, half + i)
                    if now.x[3] > 0.0:
                        store(move(i, k, now, half, force.gather(i, here), here, step), here.shared, other + i)
        sync()
        return now

    return substep


def _make_kick_all(features: Features, capacity: int, keeps: bool, widths: Widths):
    """A Warp function: slow forces act over `span` [s] on all members within `ring` of the subdomain's own, at
    `half`."""
    load, _ = _make_memory(capacity)
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


def _make_look_out(features: Features, capacity: int, keeps: bool):
    """A Warp function: where colliders are in the next SWEPT substeps, and how far members are from them in these."""
    clearance = make_clearance(features)
    load, store = _make_memory(capacity)

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


def _make_advance(features: Features, capacity: int, block: int, widths: Widths, waits: bool):
    """The kernel that makes `count` substeps from `first` on, out of one buffer (`side`) into the other.

    A launch begins with halos of `depth` rings. A substep uses up one of them, the slow forces as many as they reach
    (`widths.reach`). Runs of substeps lie between what a subdomain does for all of its members at once: the exchange
    with its neighbours, the slow forces, and a look at the colliders.
    """
    keeps, reach = block > 1, widths.reach
    force = make_springs(widths.springs, capacity)
    load, store = _make_memory(capacity)
    substep = _make_substep(features, capacity, keeps, force)
    kick_all = _make_kick_all(features, capacity, keeps, widths) if features.has_outer else None
    look_out = _make_look_out(features, capacity, keeps) if features.shapes else None
    swap = _make_swap(features) if waits else None
    buffer_of, argument = make_buffer_of(SubdomainArrays), given_type(features)
    tile_address = native.make_tile_address(6 * capacity)
    gather = force.gather

    # One block a multiprocessor is enough: with its registers the springs of a member do not wait for one another.
    @compiled(module="unique", launch_bounds=(block, 1))
    def advance(given: argument, subdomains: SubdomainArrays, side: int, first: int, count: int, depth: int):
        q = wp.tid() / wp.static(block)
        t = wp.tid() - q * wp.static(block)
        w = q / subdomains.body.shape[0]
        n = q - w * subdomains.body.shape[0]
        body = subdomains.body[n]
        here = InSubdomain()
        here.subdomains = subdomains
        here.subdomain = n
        here.block = q
        here.first = first
        # Each part by itself, so that the arrays of a single world stay in the kernel's constant arguments.
        if wp.static(features.worlds):
            s = given[w].state
            here.spoke_types = given[w].model.spoke_types
            here.frame = given[w].frames[0]
            here.material = given[w].materials[body]
            here.colliders = given[w].colliders
        else:
            s = given.state
            here.spoke_types = given.model.spoke_types
            here.frame = given.frames[0]
            here.material = given.materials[body]
            here.colliders = given.colliders
        here.last_displacements = s.last_displacements
        if wp.static(bool(features.shapes)):
            here.near = everything(s.near, body, here.colliders.shape[0])
        here.constants = spring_constants(here.material)
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
                now = substep(mine, k + turn, turn, turns, now, half, springs, here, step)
                step.second = True
                if wp.static(keeps):
                    # Two substeps a round. A CPU's compiler would round their two copies differently.
                    later = wp.static(3 * capacity)
                    now = substep(mine, k + turn + 1, turn + 1, turns, now, later, springs, here, step)
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


@wp.func
def take_forces(slot: int, member: int, subdomains: SubdomainArrays, s: State):
    """What colliders did to a member of a subdomain in the frame goes to the state, if it is the subdomain's own."""
    colliders = s.contact_forces.shape[0] / s.positions.shape[0]
    for c in range(colliders):
        if subdomains.rings[member] == 0:
            s.contact_forces[subdomains.members[member] * colliders + c] = subdomains.forces[slot * colliders + c]
        subdomains.forces[slot * colliders + c] = wp.vec4(0.0)


def _make_settle(features: Features, capacity: int, block: int, waits: bool):
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


def _make_count_faults(features: Features):
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
