"""The kernels of the patched schedule: substeps of patches, and the watch at the end of a frame (see patched.py)."""

from functools import lru_cache

import warp as wp

from cloth_sim_ros.sim.model import Body, Features
from cloth_sim_ros.sim.physics.integrate import Step, make_step
from cloth_sim_ros.sim.schedules import native
from cloth_sim_ros.sim.schedules.buffers import make_buffer_of
from cloth_sim_ros.sim.schedules.contact import make_contact
from cloth_sim_ros.sim.schedules.exchange import Exchange, exchange_of, hear, receive, send, tell
from cloth_sim_ros.sim.schedules.native import load4, load_record, store4, store_row, sync, sync_any, xyz
from cloth_sim_ros.sim.schedules.patches import NOBODY, SENT, Patches, particle_of
from cloth_sim_ros.sim.schedules.stages import Moving, make_finish, make_predict, pack, sweep_colliders
from cloth_sim_ros.sim.schedules.sweeps import make_sweep_cells, make_sweep_lanes
from cloth_sim_ros.sim.schedules.symmetry import parts_of_motion
from cloth_sim_ros.sim.schedules.tangle import COLLAPSED, OFF, count_found, count_off, look_over, make_ease, note_found
from cloth_sim_ros.sim.schedules.watch import count_fault, is_good, keep, put_back
from cloth_sim_ros.sim.state import ColliderMotion, Material, State, given_type


@lru_cache
def make_kernels(
    features: Features, capacity: int, block: int, width: int, waits: bool, staged: int
) -> dict[str, wp.Kernel]:
    """The kernels for patches of `capacity` places, of which `width` cells are projected at a time.

    Where patches wait for one another, one makes a frame, and `staged` records of cells lie in shared memory.
    """
    if waits:
        return {"advance": _make_advance(features, capacity, block, width, True, True, staged)}
    return {
        "advance": _make_advance(features, capacity, block, width, False, False, 0),
        "finish": _make_advance(features, capacity, block, width, False, True, 0),
        "settle": _make_settle(features, capacity, block),
        "count_faults": _make_count_faults(features),
    }


def _options() -> dict:
    return {"enable_backward": False, "module": "unique", "module_options": native.CPU_FLAGS}


def _make_advance(
    features: Features, capacity: int, block: int, width: int, waits: bool, last: bool, staged: int
) -> wp.Kernel:
    """The kernel of `count` substeps from substep `first` on: of one, unless patches wait for one another.

    last: with the frame's last substep, which stores multipliers and looks for faults.
    """
    predict, finish = make_predict(features), make_finish(features)
    contact = make_contact(features) if features.shapes else None
    tile_address = native.make_tile_address(3 * capacity)
    project = make_sweep_lanes(features.order) if block == 1 else make_sweep_cells(features.order, stores=last)
    staged_address = native.make_tile_address(staged) if staged else None
    buffer_of = make_buffer_of(Patches)
    ease = make_ease(features)
    argument = given_type(features)
    alone = block >= capacity  # a thread has one place at most

    @wp.func
    def finish_own(
        i: int,
        q: int,
        substep: int,
        colliders: wp.array(dtype=ColliderMotion),
        patches: Patches,
        s: State,
        here: State,
        body: Body,
        material: Material,
        step: Step,
        x: wp.uint64,
        low: wp.uint64,
        d: wp.uint64,
    ) -> Moving:
        """What own place i carries on after all passes of a substep."""
        if wp.static(bool(features.shapes)):
            sweep, slot = q * colliders.shape[0], body.particles + i
            speeds, moves = here.velocities, here.last_displacements
            contact(i, sweep, slot, material, colliders, patches.sweeps, s.contacts, speeds, moves, step, x, low, d)
        return finish(i, substep, False, here, body, step, x, low, d)

    # One block a multiprocessor is enough, and has its registers.
    @wp.kernel(launch_bounds=(block, 1), **_options())
    def advance(given: argument, patches: Patches, side: int, first: int, count: int):
        q = wp.tid() / wp.static(block)
        t = wp.tid() - q * wp.static(block)
        w = q / patches.body.shape[0]
        n = q - w * patches.body.shape[0]
        b = patches.body[n]
        # Each part by itself, so that the arrays of a single world stay in the kernel's constant arguments.
        if wp.static(features.worlds):
            s = given[w].state
            constants = given[w].model
            body = given[w].model.bodies[b]
            frame = given[w].frames[0]
            material = given[w].materials[b]
            colliders = given[w].colliders
        else:
            s = given.state
            constants = given.model
            body = given.model.bodies[b]
            frame = given.frames[0]
            material = given.materials[b]
            colliders = given.colliders
        m = patches.model
        tangled = s.tangled[b]
        smooth = bool(False)
        rough = 2 * (w * s.history.shape[0] + b)
        if wp.static(features.order == 2):
            smooth = s.history[b] > 0
            if first > 0:
                smooth = patches.rough[rough + (first - 1) % 2] != first
        parts = parts_of_motion(body, material, frame)
        step = make_step(frame.dt, smooth, wp.static(features.order), parts, frame.global_damping)
        step.first = True
        body.cells = patches.cells[n][0]
        body.cells_end = patches.cells[n][1]
        body.cell_width = wp.static(width)
        before = buffer_of(s, patches, side, w)
        after = buffer_of(s, patches, 1 - side, w)
        tile = wp.tile_empty(shape=(wp.static(3 * capacity),), dtype=wp.vec4, storage="shared")
        x = tile_address(tile)
        d = native.beside(x, wp.static(capacity))
        low = native.beside(x, wp.static(2 * capacity))
        # What the stages look up by particle they find by place: order 2 needs more than fits the shared memory.
        here = s
        if wp.static(features.order == 2):
            body.particles = q * wp.static(capacity)
            here.velocities = patches.here
            here.last_velocities = patches.last_here
            here.last_displacements = patches.moved_here
        if wp.static(last):
            here.cell_multipliers = patches.multipliers[w]
        if wp.static(last and not waits):
            step.store = True
            step.collapsed = s.collapsed[b] > 0
        mine = int(wp.static(NOBODY))
        if t < wp.static(capacity):
            mine = patches.members[n * wp.static(capacity) + t]
        for i in range(t, wp.static(capacity), wp.static(block)):
            member = mine
            if wp.static(not alone):
                member = patches.members[n * wp.static(capacity) + i]
            if member != wp.static(NOBODY):
                g = particle_of(member)
                moving = Moving()
                moving.velocity = xyz(load4(before.velocities, g))
                moving.low = xyz(load4(before.low, g))
                position = load4(before.positions, g)
                moving.w = position[3]
                store4(x, i, position)
                store4(low, i, pack(moving.low, 0.0))
                if wp.static(features.order == 2):
                    place = body.particles + i
                    store_row(here.velocities, place, pack(moving.velocity, 0.0))
                    if side == 0:
                        here.last_velocities[place] = s.last_velocities[g]
                        here.last_displacements[place] = s.last_displacements[g]
                    else:
                        second = w * s.positions.shape[0] + g
                        here.last_velocities[place] = patches.last_velocities[second]
                        here.last_displacements[place] = patches.last_displacements[second]
                predict(i, moving, m, here, body, material, frame, step, x, low, d)
        records = native.record_address(m.cells, body.cells)
        if wp.static(staged > 0):
            # From afar they come later than a pass takes.
            afar = records
            records = staged_address(wp.tile_empty(shape=(wp.static(staged),), dtype=wp.vec4, storage="shared"))
            for r in range(wp.static(-(-staged // block))):
                k = wp.min(t + r * wp.static(block), body.cells_end - body.cells - 1)
                native.store_record(records, k, load_record(afar, k))
        exchange = Exchange()
        account = w * constants.bodies.shape[0] + b
        relapses = s.relapses[b]
        if wp.static(waits):
            exchange = exchange_of(0, patches.positions.shape[0], patches.messages, patches.sent[account])
        bad, found = int(0), int(0)
        sync()
        if wp.static(waits or not last):
            if first == 0:
                found = look_over(t, wp.static(block), body, records, tangled, x)
                if wp.static(waits):
                    step.collapsed = (found & COLLAPSED) > 0
                elif t == 0:
                    note_found(found, b, s)
        # Not before: what nothing waits for comes from afar beside the particles.
        material = ease(material, tangled, s.thrown[b], body, frame.dt, frame)
        for k in range(count):
            if wp.static(waits):
                if k > 0:
                    exchange.side = k % 2
                    for i in range(t, wp.static(capacity), wp.static(block)):
                        member = mine
                        if wp.static(not alone):
                            member = patches.members[n * wp.static(capacity) + i]
                        if member >= 0:
                            moving = finish_own(
                                i, q, first + k - 1, colliders, patches, s, here, body, material, step, x, low, d
                            )
                            if member >= wp.static(SENT):
                                exchange.first = w * s.positions.shape[0] + (member & wp.static(SENT - 1))
                                send(xyz(load4(x, i)), moving.low, moving.velocity, exchange, k)
                            predict(i, moving, m, here, body, material, frame, step, x, low, d)
                    for i in range(t, wp.static(capacity), wp.static(block)):
                        member = mine
                        if wp.static(not alone):
                            member = patches.members[n * wp.static(capacity) + i]
                        if member < wp.static(NOBODY):
                            exchange.first = w * s.positions.shape[0] - 2 - member
                            message = receive(exchange, k)
                            if message.late:
                                exchange.patience = 0
                                bad = 1
                            moving = Moving()
                            moving.velocity = xyz(message.v)
                            moving.low = xyz(message.low)
                            moving.w = load4(x, i)[3]
                            store4(x, i, pack(xyz(message.x), moving.w))
                            store4(low, i, pack(moving.low, 0.0))
                            predict(i, moving, m, here, body, material, frame, step, x, low, d)
                    sync()
                step.store = k == count - 1
            if wp.static(bool(features.shapes)):
                # Seen by all after the barriers of the passes.
                first_sweep = q * colliders.shape[0]
                sweep_colliders(t, wp.static(block), first_sweep, first + k, colliders, frame, patches.sweeps)
            project(t, wp.static(block), m, here, body, material, step, records, x, low, d)
        substep = first + count - 1
        for i in range(t, wp.static(capacity), wp.static(block)):
            member = mine
            if wp.static(not alone):
                member = patches.members[n * wp.static(capacity) + i]
            if member >= 0:
                g = member & wp.static(SENT - 1)
                moving = finish_own(i, q, substep, colliders, patches, s, here, body, material, step, x, low, d)
                if wp.static(features.order == 2):
                    if moving.rough > 0:
                        patches.rough[rough + substep % 2] = substep + 1
                    place = body.particles + i
                    if side == 0:
                        second = w * s.positions.shape[0] + g
                        patches.last_velocities[second] = here.last_velocities[place]
                        patches.last_displacements[second] = here.last_displacements[place]
                    else:
                        s.last_velocities[g] = here.last_velocities[place]
                        s.last_displacements[g] = here.last_displacements[place]
                position = load4(x, i)
                velocity = pack(moving.velocity, 0.0)
                if wp.static(waits):
                    store_row(s.velocities, g, velocity)
                else:
                    store4(after.positions, g, position)
                    store4(after.low, g, pack(moving.low, 0.0))
                    store4(after.velocities, g, velocity)
                if wp.static(last):
                    if not is_good(position, velocity):
                        bad = 1
        if wp.static(waits):
            bad = wp.where(sync_any(bad) != 0, 1, 0)
            if t == 0:
                tell(q, float(bad + (found & OFF) * 2), exchange, count)
        elif wp.static(last):
            if bad > 0:
                s.faulty[b] = 1
        if wp.static(last):
            told = patches.tells[n]
            for j in range(told[0] + t, told[1], wp.static(block)):
                s.cell_multipliers[patches.told[j][1]] = here.cell_multipliers[patches.told[j][0]]
        if wp.static(waits):
            peers = patches.peers[n]
            for other in range(peers[0] + t, peers[1], wp.static(block)):
                word = int(hear(q - n + other, 1.0, exchange, count))
                bad |= word & 1
                found |= word >> 1
            bad = sync_any(bad)
            found = wp.where(sync_any(found & OFF) != 0, OFF, 0)
            for i in range(t, wp.static(capacity), wp.static(block)):
                member = mine
                if wp.static(not alone):
                    member = patches.members[n * wp.static(capacity) + i]
                if member >= 0:
                    if bad > 0:
                        put_back(member & wp.static(SENT - 1), relapses, constants, s)
                    else:
                        keep(member & wp.static(SENT - 1), load4(x, i), load4(low, i), s)
            if n == peers[0] and t == 0:
                patches.sent[account] += count
                s.faulty[b] = wp.where(bad > 0, 1, 0)
                count_fault(b, s)
                s.tangled[b] = count_off(found, tangled)

    return advance


def _make_settle(features: Features, capacity: int, block: int) -> wp.Kernel:
    """The kernel that keeps what the last substep of a frame left in a buffer, or puts back what is faulty."""
    buffer_of = make_buffer_of(Patches)
    argument = given_type(features)

    @wp.kernel(**_options())
    def settle(given: argument, patches: Patches, side: int):
        q = wp.tid() / wp.static(block)
        t = wp.tid() - q * wp.static(block)
        w = q / patches.body.shape[0]
        n = q - w * patches.body.shape[0]
        b = patches.body[n]
        if wp.static(features.worlds):
            m = given[w].model
            s = given[w].state
        else:
            m = given.model
            s = given.state
        last = buffer_of(s, patches, side, w)
        for i in range(t, wp.static(capacity), wp.static(block)):
            member = patches.members[n * wp.static(capacity) + i]
            if member >= 0:
                g = member & wp.static(SENT - 1)
                if s.faulty[b] == 1:
                    put_back(g, s.relapses[b], m, s)
                else:
                    keep(g, load4(last.positions, g), load4(last.low, g), s)
                    store_row(s.velocities, g, load4(last.velocities, g))
                if wp.static(features.order == 2):
                    if side == 1:
                        second = w * s.positions.shape[0] + g
                        s.last_velocities[g] = patches.last_velocities[second]
                        s.last_displacements[g] = patches.last_displacements[second]

    return settle


def _make_count_faults(features: Features) -> wp.Kernel:
    """The kernel that tells the next frame of every body what became of it in this one."""
    argument = given_type(features)

    @wp.kernel(**_options())
    def count_faults(given: argument, patches: Patches, substeps: int):
        i = wp.tid()
        b = i
        if wp.static(features.worlds):
            bodies = given[0].model.bodies.shape[0]
            b = i % bodies
            s = given[i / bodies].state
        else:
            s = given.state
        faulty = count_fault(b, s)
        count_found(b, s)
        if wp.static(features.order == 2):
            smooth = patches.rough[2 * i + (substeps - 1) % 2] != substeps
            s.history[b] = wp.where(smooth and not faulty, 1, 0)

    return count_faults
