"""The kernels of the tiled schedule: several substeps a launch, and the watch at the end of a frame (see tiled.py)."""

from functools import lru_cache

import warp as wp

from cloth_sim_ros.sim.model import Features, Model
from cloth_sim_ros.sim.physics.integrate import Step, eased_by, make_step, split_sum
from cloth_sim_ros.sim.schedules import native
from cloth_sim_ros.sim.schedules.buffers import make_buffer_of
from cloth_sim_ros.sim.schedules.contact import make_touch
from cloth_sim_ros.sim.schedules.exchange import Exchange, exchange_of, receive, send
from cloth_sim_ros.sim.schedules.native import load4, store4, store_row, sync, xyz
from cloth_sim_ros.sim.schedules.stages import (
    first_share,
    pack,
    prediction,
    rate_of,
    spring_constants,
    sweep_collider,
)
from cloth_sim_ros.sim.schedules.tile_forces import Carried, make_drag, make_springs
from cloth_sim_ros.sim.schedules.tiles import OUTSIDE, SWEPT, Tiles
from cloth_sim_ros.sim.schedules.watch import count_fault, is_good, keep, put_back
from cloth_sim_ros.sim.state import ColliderMotion, Frame, Material, State, given_type


@lru_cache
def make_kernels(
    features: Features, capacity: int, block: int, width: int, panels: int, waits: bool
) -> dict[str, wp.Kernel]:
    """The kernels for tiles of `capacity` places, `width` springs and `panels` at a particle.

    With a thread for every member (block > 1) it and its springs are read once a launch and stay in registers; on a
    CPU, where one thread has them all (block = 1), they are read every substep. Where a tile `waits` for its
    neighbours, a launch is a whole frame.
    """
    contact = make_touch(features) if features.shapes else None
    tile_address = native.make_tile_address(6 * capacity)
    Springs, gather, force = make_springs(width, capacity)
    drag = make_drag(features, panels, capacity) if features.panels else None
    keeps = block > 1
    buffer_of = make_buffer_of(Tiles)
    argument = given_type(features)
    options = {"enable_backward": False, "module": "unique", "module_options": native.CPU_FLAGS}

    @wp.func
    def load(shared: wp.uint64, at: int) -> Carried:
        now = Carried()
        now.x = load4(shared, at)
        now.low = xyz(load4(shared, at + capacity))
        now.v = xyz(load4(shared, at + 2 * capacity))
        return now

    @wp.func
    def store(now: Carried, shared: wp.uint64, at: int):
        store4(shared, at, now.x)
        store4(shared, at + capacity, pack(now.low, 0.0))
        store4(shared, at + 2 * capacity, pack(now.v, 0.0))

    @wp.func
    def move(
        n: int,
        i: int,
        now: Carried,
        here: int,
        springs: Springs,
        sweep: int,
        slot: int,
        colliders: wp.array(dtype=ColliderMotion),
        s: State,
        tiles: Tiles,
        material: Material,
        frame: Frame,
        step: Step,
        shared: wp.uint64,
    ) -> Carried:
        """Member i of tile n one substep later."""
        w = now.x[3]
        there = wp.static(3 * capacity) - here
        a = frame.gravity - frame.global_damping * now.v
        eased = step.eased
        if wp.static(features.panels != ""):
            push = drag(n, i, here, now, tiles, frame, material, shared)
            a += w * xyz(push)
            eased = eased_by(frame.global_damping + w * push[3], step.effective)
        a += w * force(here, now, springs, material.damping, shared)
        total = prediction(wp.vec3(0.0), now.v, a * first_share(step), eased, w, now.low, step)
        if wp.static(bool(features.shapes)):
            store4(shared, there + i, total)
            for iteration in range(frame.iterations):
                step.first = iteration == 0
                step.repeats = frame.iterations > 1
                contact(
                    i,
                    sweep,
                    slot,
                    material,
                    colliders,
                    tiles.sweeps,
                    tiles.contacts,
                    s.velocities,
                    s.last_displacements,
                    step,
                    shared + wp.uint64(16 * here),
                    shared + wp.uint64(16 * (here + capacity)),
                    shared + wp.uint64(16 * there),
                )
            total = load4(shared, there + i)
        d = xyz(total)
        then = Carried()
        then.v = rate_of(d - now.low, step)
        then.low = split_sum(xyz(now.x), d)
        then.x = pack(xyz(now.x) + d, w)
        return then

    @wp.func
    def sweep_colliders(
        q: int, t: int, begin: int, colliders: wp.array(dtype=ColliderMotion), tiles: Tiles, frame: Frame
    ):
        """The motion of all colliders in the SWEPT substeps from `begin` on, for block q of the launch."""
        count = colliders.shape[0]
        for c in range(t, wp.static(SWEPT) * count, wp.block_dim()):
            substep = float(begin + c / count)
            tiles.sweeps[q * wp.static(SWEPT) * count + c] = sweep_collider(
                colliders[c % count], substep / float(frame.substeps), (substep + 1.0) / float(frame.substeps)
            )
        sync()

    @wp.func
    def substep(
        q: int,
        n: int,
        mine: int,
        k: int,
        turns: int,
        now: Carried,
        here: int,
        springs: Springs,
        constants: wp.vec3,
        colliders: wp.array(dtype=ColliderMotion),
        m: Model,
        s: State,
        tiles: Tiles,
        material: Material,
        frame: Frame,
        step: Step,
        shared: wp.uint64,
    ) -> Carried:
        """Substep k of the launch for all members that are still valid; from half `here` of the memory to the other."""
        there = wp.static(3 * capacity) - here
        sweep = (q * wp.static(SWEPT) + k % wp.static(SWEPT)) * colliders.shape[0]
        slot = q * wp.static(capacity)
        if wp.static(keeps):
            if k < turns:
                then = move(
                    n,
                    mine,
                    now,
                    here,
                    springs,
                    sweep,
                    slot + mine,
                    colliders,
                    s,
                    tiles,
                    material,
                    frame,
                    step,
                    shared,
                )
                store(then, shared, there + mine)
                now.x = then.x
                now.low = then.low
                now.v = then.v
        else:
            for i in range(wp.static(capacity)):
                if k < turns - tiles.rings[n * wp.static(capacity) + i]:
                    now = load(shared, here + i)
                    if now.x[3] > 0.0:
                        own = gather(n, i, m, tiles, constants)
                        then = move(
                            n,
                            i,
                            now,
                            here,
                            own,
                            sweep,
                            slot + i,
                            colliders,
                            s,
                            tiles,
                            material,
                            frame,
                            step,
                            shared,
                        )
                        store(then, shared, there + i)
        sync()
        return now

    # One block a multiprocessor is enough: with its registers the springs of a member do not wait for one another.
    @wp.kernel(launch_bounds=(block, 1), **options)
    def advance(given: argument, tiles: Tiles, side: int, first: int, count: int, depth: int):
        q = wp.tid() / wp.static(block)
        t = wp.tid() - q * wp.static(block)
        w = q / tiles.body.shape[0]
        n = q - w * tiles.body.shape[0]
        body = tiles.body[n]
        # Each part by itself, so that the arrays of a single world stay in the kernel's constant arguments.
        if wp.static(features.worlds):
            m = given[w].model
            s = given[w].state
            frame = given[w].frames[0]
            material = given[w].materials[body]
            colliders = given[w].colliders
        else:
            m = given.model
            s = given.state
            frame = given.frames[0]
            material = given.materials[body]
            colliders = given.colliders
        step = make_step(frame.dt, first > 0 or s.history[body] > 0, 1, frame.global_damping)
        constants = spring_constants(material)
        shared = tile_address(wp.tile_empty(shape=(wp.static(6 * capacity),), dtype=wp.vec4, storage="shared"))
        before = buffer_of(s, tiles, side, w)
        now = Carried()
        mine = t
        if wp.static(keeps):
            mine = tiles.places[n * wp.static(block) + t]
        for i in range(mine, wp.static(capacity), wp.static(capacity if keeps else 1)):
            g = tiles.members[n * wp.static(capacity) + i]
            now.x = load4(before.positions, g)
            now.low = xyz(load4(before.low, g))
            now.v = xyz(load4(before.velocities, g))
            store(now, shared, i)
            store(now, shared, wp.static(3 * capacity) + i)  # where what is pinned stays
        springs = gather(n, mine, m, tiles, constants)
        ring = tiles.rings[n * wp.static(capacity) + mine]
        end = wp.min(count, depth)  # of the substeps for which the halo lasts
        turns = end
        if wp.static(keeps):
            # What is pinned needs no turn: it lies in both halves of the memory.
            lag = wp.where(now.x[3] > 0.0, ring, wp.static(OUTSIDE))
            turns -= lag
        exchange = Exchange()
        if wp.static(waits):
            particle = w * s.positions.shape[0] + tiles.members[n * wp.static(capacity) + mine]
            exchange = exchange_of(particle, tiles.positions.shape[0], tiles.messages, tiles.sent[0])
        sync()
        for k in range(0, count, wp.static(2 if keeps else 1)):
            if wp.static(waits):
                if k == end:
                    end = wp.min(k + depth, count)
                    if ring == 0:
                        send(xyz(now.x), now.low, now.v, exchange, k)
                    sync()  # what is sent does not wait behind what waits
                    if 0 < ring and ring <= end - k:
                        message = receive(exchange, k)
                        now.x = pack(xyz(message.x), now.x[3])
                        now.low = xyz(message.low)
                        now.v = xyz(message.v)
                        if message.late:
                            exchange.patience = 0
                            s.faulty[body] = 1
                    exchange.side = 1 - exchange.side
                    turns = end - lag
                    store(now, shared, mine)
                    sync()
            if wp.static(bool(features.shapes)):
                if k % wp.static(SWEPT) == 0:
                    sweep_colliders(q, t, first + k, colliders, tiles, frame)
            # Two substeps a round, so that the halves of the memory are constants. A CPU's compiler would round their
            # two copies differently.
            now = substep(
                q,
                n,
                mine,
                k,
                turns,
                now,
                wp.static(0 if keeps else 3 * capacity) * (k % 2),
                springs,
                constants,
                colliders,
                m,
                s,
                tiles,
                material,
                frame,
                step,
                shared,
            )
            step.second = True
            if wp.static(keeps):
                now = substep(
                    q,
                    n,
                    mine,
                    k + 1,
                    turns,
                    now,
                    wp.static(3 * capacity),
                    springs,
                    constants,
                    colliders,
                    m,
                    s,
                    tiles,
                    material,
                    frame,
                    step,
                    shared,
                )
        after = buffer_of(s, tiles, 1 - side, w)
        for i in range(mine, wp.static(capacity), wp.static(capacity if keeps else 1)):
            if tiles.rings[n * wp.static(capacity) + i] == 0:
                g = tiles.members[n * wp.static(capacity) + i]
                if wp.static(not keeps):
                    now = load(shared, wp.static(3 * capacity) * (count % 2) + i)
                v = pack(now.v, 0.0)
                store4(after.positions, g, now.x)
                store4(after.low, g, pack(now.low, 0.0))
                store4(after.velocities, g, v)
                if first + count == frame.substeps and not is_good(now.x, v):
                    s.faulty[body] = 1

    @wp.kernel(**options)
    def settle(given: argument, tiles: Tiles, side: int, substeps: int):
        q = wp.tid() / wp.static(block)
        t = wp.tid() - q * wp.static(block)
        w = q / tiles.body.shape[0]
        n = q - w * tiles.body.shape[0]
        if wp.static(features.worlds):
            m = given[w].model
            s = given[w].state
        else:
            m = given.model
            s = given.state
        if wp.static(waits):
            if q == 0 and t == 0:
                tiles.sent[0] += substeps
        last = buffer_of(s, tiles, side, w)
        for i in range(t, wp.static(capacity), wp.static(block)):
            if tiles.rings[n * wp.static(capacity) + i] == 0:
                g = tiles.members[n * wp.static(capacity) + i]
                if s.faulty[tiles.body[n]] == 1:
                    put_back(g, s.relapses[tiles.body[n]], m, s)
                else:
                    keep(g, load4(last.positions, g), load4(last.low, g), s)
                    store_row(s.velocities, g, load4(last.velocities, g))

    @wp.kernel(**options)
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

    return {"advance": advance, "settle": settle, "count_faults": count_faults}
