"""The kernel of the resident schedule: a whole frame of a body (see resident.py)."""

from functools import lru_cache

import warp as wp

from cloth_sim_ros.sim.lines.solve import make_solve_lines
from cloth_sim_ros.sim.model import Body, Features, Model
from cloth_sim_ros.sim.physics.integrate import make_step, outer_weight
from cloth_sim_ros.sim.schedules import native
from cloth_sim_ros.sim.schedules.air import make_panels
from cloth_sim_ros.sim.schedules.contact import make_contact
from cloth_sim_ros.sim.schedules.edge_contact import make_edge_contact
from cloth_sim_ros.sim.schedules.lines import make_solve_chain
from cloth_sim_ros.sim.schedules.native import load4, load_row, store4, sync, sync_any, xyz
from cloth_sim_ros.sim.schedules.past import copy_past, with_past_at
from cloth_sim_ros.sim.schedules.plate import curve_triangle, make_bend
from cloth_sim_ros.sim.schedules.reel import make_turn
from cloth_sim_ros.sim.schedules.rope_watch import make_settle_body
from cloth_sim_ros.sim.schedules.scan import THREADS, scan_size
from cloth_sim_ros.sim.schedules.stages import (
    Moving,
    make_finish,
    make_kick,
    make_predict,
    moving_of,
    pack,
    store_velocity,
    sweep_colliders,
)
from cloth_sim_ros.sim.schedules.twist import ask_for
from cloth_sim_ros.sim.schedules.watch import is_good, keep, put_back
from cloth_sim_ros.sim.state import Frame, Material, State, given_type


@lru_cache
def make_frame(features: Features, shared: int, block: int, most_shared: int = 0):
    """The kernel of a whole frame for `features`; `shared` particles in shared memory of `most_shared` bytes; 0 is
    plain arrays.

    The compiler knows that a block has `block` threads, so that their registers fit the multiprocessor.
    """
    predict, finish = make_predict(features), make_finish(features)
    panels = make_panels(features) if features.panels else None
    kick = make_kick(features) if features.has_outer else None
    blows = features.panels != "" and not features.has_outer
    contact = make_contact(features) if features.shapes else None
    edge_contact = make_edge_contact(features.shapes, features.order) if "edge" in features.constraints else None
    stored = shared == 0 or shared > THREADS
    solve_chain = make_solve_chain(features, block, stored) if features.chain else None
    settle_body = make_settle_body(features)
    turn = make_turn(features.order) if features.winch else None
    # What every particle reads and writes once a substep lies in shared memory too where there is room.
    slots = scan_size(block) if shared and features.chain else 0
    keeps_low = "line" in features.constraints or features.chain
    all_shared = keeps_low and shared > 0 and 16 * (3 * shared + slots) <= most_shared
    tile_size = (3 if all_shared else 2) * shared
    tile_address = native.make_tile_address(tile_size) if shared else None
    # Velocities and what order 2 looks back at, 10 floats a particle, which a rope would fetch from afar every substep.
    past = 5 * shared // 2 if all_shared and features.chain and features.order == 2 else 0
    past = past if 16 * (tile_size + slots + past) <= most_shared else 0
    past_address = native.make_tile_address(past) if past else None
    solve_lines = make_solve_lines(features) if "line" in features.constraints else None
    # Where a prediction needs no other particle, it does not wait for those that others fetch.
    at_once = shared > 0 and features.method == "xpbd" and not (features.panels or features.winch)
    bend = make_bend(features) if features.plate and features.method == "xpbd" else None
    span_address = native.make_tile_address(slots) if slots else None
    argument = given_type(features)

    @wp.func
    def kick_all(
        t: int,
        substep: int,
        m: Model,
        s: State,
        body: Body,
        material: Material,
        frame: Frame,
        x: wp.uint64,
        low: wp.uint64,
        d: wp.uint64,
    ):
        """Slow forces before a substep, where it begins an outer step, or at the end of the frame."""
        width = wp.block_dim()
        weight = outer_weight(substep, frame.substeps, frame.outer)
        if weight > 0.0:
            if wp.static(features.panels != ""):
                panels(t, width, m, s, body, material, frame, False, x)
            if wp.static(features.curved):
                for c in range(body.curves + t, body.curves_end, width):
                    curve_triangle(c, m, s, body, x, low)
            sync()
            for i in range(t, body.count, width):
                kick(i, weight * frame.dt, m, s, body, material, x, low, d)
            sync()
            for i in range(t, body.count, width):
                store_velocity(i, s, body, d)
        sync()

    @wp.kernel(enable_backward=False, module="unique", launch_bounds=block, module_options=native.CPU_FLAGS)
    def simulate_frame(given: argument):
        # By the number of the thread alone: of two dimensions Warp would divide numbers of 64 bits.
        b = wp.tid() / wp.static(block)
        t = wp.tid() - b * wp.static(block)
        # Each part by itself, so that the arrays of a single world stay in the kernel's constant arguments.
        if wp.static(features.worlds):
            bodies = given[0].model.bodies.shape[0]
            w = b // bodies
            b -= w * bodies
            m = given[w].model
            s = given[w].state
            frame = given[w].frames[0]
            material = given[w].materials[b]
            colliders = given[w].colliders
        else:
            m = given.model
            s = given.state
            frame = given.frames[0]
            material = given.materials[b]
            colliders = given.colliders
        if wp.static(features.redoes):
            if s.rejected[b] == 0:
                return
        width = wp.block_dim()
        body = m.bodies[b]
        relapses = s.relapses[b]
        history = int(0)
        if wp.static(features.looks_back):
            history = s.history[b]
        step = make_step(frame.dt, history > 0, wp.static(features.order), frame.global_damping)
        # From the last to the first: a rope has one particle more than segments, and the first is often pinned.
        last = body.count - 1
        x = native.array_address(s.positions, body.particles)
        d = native.array_address(s.displacements, body.particles)
        low = native.array_address(s.low, body.particles)
        if wp.static(shared > 0):
            # Of displacements and low parts, the one that a particle's neighbours read lies beside x.
            tile = wp.tile_empty(shape=(wp.static(tile_size),), dtype=wp.vec4, storage="shared")
            x = tile_address(tile)
            if wp.static(features.method == "verlet"):
                low = native.beside(x, wp.static(shared))
            else:
                d = native.beside(x, wp.static(shared))
            if wp.static(all_shared):
                low = native.beside(x, wp.static(2 * shared))
        p = d
        if wp.static(bend is not None):
            p = native.array_address(s.predicted, body.particles)
        if wp.static(shared > 0):
            for i in range(last - t, -1, -width):
                # All that comes from afar is asked for before any of it is stored, which the compiler could not tell.
                position = load_row(s.positions, body.particles + i)
                lost = load_row(s.low, body.particles + i)
                velocity = load_row(s.velocities, body.particles + i)
                store4(x, i, position)
                if wp.static(all_shared or features.method == "verlet"):
                    store4(low, i, lost)
                if wp.static(at_once):
                    moving = Moving()
                    moving.w = position[3]
                    moving.velocity = xyz(velocity)
                    moving.low = xyz(lost)
                    predict(i, moving, m, s, body, material, frame, step, x, low, p)
        if wp.static(past > 0):
            home = s
            begin = past_address(wp.tile_empty(shape=(wp.static(past),), dtype=wp.vec4, storage="shared"))
            s = with_past_at(begin, wp.static(shared), body, home)
            for i in range(last - t, -1, -width):
                copy_past(body.particles + i, home, s)
        spans = x
        if wp.static(slots > 0):
            span_tile = wp.tile_empty(shape=(wp.static(slots),), dtype=wp.vec4, storage="shared")
            spans = span_address(span_tile)
        sync()
        if wp.static(features.twist):
            if t == 0:
                if wp.static(features.worlds):
                    ask_for(given[w].ends[b].turn, b, s)
                else:
                    ask_for(given.ends[b].turn, b, s)
        if wp.static(features.winch):
            if wp.static(features.worlds):
                drive = given[w].drives[b]
            else:
                drive = given.drives[b]
            if t == 0:
                turn(m, s, body, drive, frame.dt, x, low)
            sync()
        if wp.static(blows):
            panels(t, width, m, s, body, material, frame, step.second, x)
            sync()
        if wp.static(features.has_outer):
            kick_all(t, 0, m, s, body, material, frame, x, low, d)
        if wp.static(not at_once):
            for i in range(last - t, -1, -width):
                predict(i, moving_of(i, s, body, x, low), m, s, body, material, frame, step, x, low, p)
        bad = int(0)
        for substep in range(frame.substeps):
            if wp.static(bool(features.shapes)):
                sweep_colliders(t, width, b * colliders.shape[0], substep, colliders, frame, s.sweeps)
            sync()
            if wp.static(bend is not None):
                if wp.static(features.curved):
                    for c in range(body.curves + t, body.curves_end, width):
                        curve_triangle(c, m, s, body, x, p)
                    sync()
                for i in range(last - t, -1, -width):
                    bend(i, m, s, body, material, step, x, low, p, d)
                sync()
            if wp.static(features.chain):
                step.torn = False
            for iteration in range(frame.iterations):
                step.first = iteration == 0
                step.repeats = frame.iterations > 1
                step.store = frame.iterations > 1 or substep == frame.substeps - 1
                if wp.static(features.chain):
                    if solve_chain(t, m, s, body, material, step, x, low, d, spans):
                        step.torn = True
                    sync()
                if wp.static(solve_lines is not None):
                    solve_lines(t, width, m, s, body, material, step, x, low, d)
                if wp.static(edge_contact is not None):
                    for g in range(body.groups_end, body.edge_groups_end):
                        for k in range(m.groups[g][2] + t, m.groups[g][3], width):
                            edge_contact(k, b, body, material, colliders, m, s, step, x, low, d)
                        sync()
                if wp.static(bool(features.shapes)):
                    for i in range(last - t, -1, -width):
                        sweep, slot = b * colliders.shape[0], body.particles + i
                        speeds, moves = s.velocities, s.last_displacements
                        contact(
                            i, sweep, slot, material, colliders, s.sweeps, s.contacts, speeds, moves, step, x, low, d
                        )
                    sync()
            rough = int(0)
            if wp.static(features.panels != "" or features.looks_back or features.winch):
                for i in range(last - t, -1, -width):
                    moving = finish(i, substep, True, s, body, step, x, low, d)
                    rough += moving.rough
                rough = sync_any(rough)
            if wp.static(features.winch):
                if t == 0 and substep + 1 < frame.substeps:
                    turn(m, s, body, drive, frame.dt, x, low)
                sync()
            if wp.static(blows):
                if substep + 1 < frame.substeps:
                    panels(t, width, m, s, body, material, frame, rough == 0, x)
                sync()
            if wp.static(features.has_outer):
                kick_all(t, substep + 1, m, s, body, material, frame, x, low, d)
            if wp.static(features.looks_back):
                history = wp.where(rough == 0, 1, 0)
                if step.second != (history > 0):
                    step = make_step(frame.dt, history > 0, wp.static(features.order), frame.global_damping)
            # A thread owns its particles from the end of one substep to the next prediction; only methods that look
            # back or around need a barrier in between.
            ends = substep + 1 == frame.substeps
            i = last - t
            while i >= 0:
                if wp.static(features.panels == "" and not features.looks_back and not features.winch):
                    moving = finish(i, substep, ends, s, body, step, x, low, d)
                else:
                    moving = moving_of(i, s, body, x, low)
                if not ends:
                    predict(i, moving, m, s, body, material, frame, step, x, low, p)
                elif not is_good(load4(x, i), pack(moving.velocity, 0.0)):
                    bad = 1
                i -= width
        faulty = sync_any(bad) > 0
        for i in range(last - t, -1, -width):
            if faulty:
                put_back(body.particles + i, relapses, m, s)
                if wp.static(features.chain):
                    s.chain_forces[body.particles + i] = wp.vec3(0.0)
            else:
                keep(body.particles + i, load4(x, i), load4(low, i), s)
            if wp.static(past > 0):
                # Told anew, or its addresses would take registers all the time.
                if wp.static(features.worlds):
                    copy_past(body.particles + i, s, given[w].state)
                else:
                    copy_past(body.particles + i, s, given.state)
        settle_body(t, width, b, faulty, relapses, history, s, body)

    return simulate_frame
