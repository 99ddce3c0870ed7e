"""The kernels of the coloured schedule: a stage each (see coloured.py)."""

from collections.abc import Callable
from functools import lru_cache

import warp as wp

from cloth_sim_ros.sim.model import Body, Features
from cloth_sim_ros.sim.physics.integrate import Step, make_step, outer_weight
from cloth_sim_ros.sim.schedules.air import make_panels
from cloth_sim_ros.sim.schedules.coloured_constraints import add_constraints
from cloth_sim_ros.sim.schedules.contact import make_contact
from cloth_sim_ros.sim.schedules.edge_contact import make_edge_contact
from cloth_sim_ros.sim.schedules.native import CPU_FLAGS, array_address, load_row
from cloth_sim_ros.sim.schedules.plate import curve_triangle, make_bend
from cloth_sim_ros.sim.schedules.reel import make_turn
from cloth_sim_ros.sim.schedules.rope_watch import make_settle_ends, make_slacken
from cloth_sim_ros.sim.schedules.stages import (
    SWEPT,
    make_finish,
    make_kick,
    make_predict,
    moving_of,
    store_velocity,
    sweep_collider,
)
from cloth_sim_ros.sim.schedules.watch import count_fault, is_good, keep, put_back
from cloth_sim_ros.sim.state import Arrays, given_type

OVER_ALL = ("count_faults",)  # stages whose elements are bodies


@wp.struct
class Here:
    """A body, the addresses of its positions, low parts, displacements and predicted displacements, its substep."""

    body: Body
    x: wp.uint64
    low: wp.uint64
    d: wp.uint64
    p: wp.uint64
    step: Step


@lru_cache
def make_kernels(features: Features, threads_a_row: int) -> dict[str, wp.Kernel]:
    """The kernels of the stages that `features` need, in one module of their own.

    threads_a_row: how many threads share a row of lines.
    """
    kernels: dict[str, wp.Kernel] = {}
    stage = _make_stage(features, f"cloth_sim_ros.coloured.{features.key()}.{threads_a_row}", kernels)
    look = _make_look(features)
    _add_motion(stage, look, features)
    add_constraints(stage, look, features, threads_a_row)
    if features.shapes:
        _add_contact(stage, look, features)
    _add_watch(stage, features)
    return kernels


def _make_stage(features: Features, module: str, kernels: dict[str, wp.Kernel]) -> Callable:
    """A decorator that puts the kernel of a function, by its name, into `kernels` and `module`."""
    found, argument = wp.get_module(module), given_type(features)
    wp.set_module_options(CPU_FLAGS, found)

    def stage(function):
        """Makes the kernel that runs `function` on element i of a launch, in the world of `arrays`."""
        run = wp.func(function)
        by_body = function.__name__ not in OVER_ALL

        def launched(given: argument, size: int, b: int, substep: int, iteration: int, store: int, g: int):
            i = wp.tid()
            if wp.static(features.worlds):
                w = i // size
                if wp.static(features.redoes and by_body):
                    if given[w].state.rejected[b] == 0:
                        return
                run(given[w], i - w * size, b, substep, iteration, store, g)
            else:
                if wp.static(features.redoes and by_body):
                    if given.state.rejected[b] == 0:
                        return
                run(given, i, b, substep, iteration, store, g)

        launched.__qualname__ = f"launch_{function.__name__}"
        kernels[function.__name__] = wp.kernel(launched, enable_backward=False, module=found)

    return stage


def _make_look(features: Features):
    """A Warp function: where body b is in this substep and iteration."""

    @wp.func
    def look(arrays: Arrays, b: int, substep: int, iteration: int, store: int) -> Here:
        here = Here()
        here.body = arrays.model.bodies[b]
        here.x = array_address(arrays.state.positions, here.body.particles)
        here.low = array_address(arrays.state.low, here.body.particles)
        here.d = array_address(arrays.state.displacements, here.body.particles)
        here.p = here.d
        if wp.static(features.plate and features.method == "xpbd"):
            here.p = array_address(arrays.state.predicted, here.body.particles)
        smooth = bool(False)
        if wp.static(features.looks_back):
            # What the substep before found; two places take turns, so that none is read while it is written.
            smooth = arrays.state.events[2 * b + (substep + 1) % 2] != substep
            if substep == 0:
                smooth = arrays.state.history[b] > 0
        frame = arrays.frames[0]
        here.step = make_step(frame.dt, smooth, wp.static(features.order), frame.global_damping)
        here.step.first = iteration == 0
        here.step.store = store != 0
        here.step.repeats = frame.iterations > 1
        if wp.static(features.chain):
            here.step.torn = arrays.state.torn[b] > 0
        return here

    return look


def _add_motion(stage: Callable, look: wp.Function, features: Features) -> None:
    """The stages around the constraints: what moves particles into a substep and out of it."""
    predict_particle, finish_particle = make_predict(features), make_finish(features)
    panel_forces = make_panels(features) if features.panels else None
    turn = make_turn(features.order) if features.winch else None
    touch = _make_touch(features) if features.shapes else None

    @stage
    def predict(arrays: Arrays, i: int, b: int, substep: int, iteration: int, store: int, g: int):
        here = look(arrays, b, substep, 0, 0)
        if wp.static(features.chain):
            if i == 0:
                arrays.state.torn[b] = 0
        moving = moving_of(i, arrays.state, here.body, here.x, here.low)
        material, frame = arrays.materials[b], arrays.frames[0]
        predict_particle(
            i,
            moving,
            arrays.model,
            arrays.state,
            here.body,
            material,
            frame,
            here.step,
            here.x,
            here.low,
            here.p,
        )

    @stage
    def finish(arrays: Arrays, i: int, b: int, substep: int, iteration: int, store: int, g: int):
        here = look(arrays, b, substep, iteration, 0)
        if wp.static(touch is not None):
            touch(arrays, i, b, substep, here)
        moving = finish_particle(i, substep, True, arrays.state, here.body, here.step, here.x, here.low, here.d)
        if wp.static(features.looks_back):
            if moving.rough > 0:
                arrays.state.events[2 * b + substep % 2] = substep + 1

    if features.panels:

        @stage
        def panels(arrays: Arrays, i: int, b: int, substep: int, iteration: int, store: int, g: int):
            # g is how many threads share them.
            here = look(arrays, b, substep, 0, 0)
            m, s, material, frame = arrays.model, arrays.state, arrays.materials[b], arrays.frames[0]
            panel_forces(i, g, m, s, here.body, material, frame, here.step.second, here.x)

    if features.plate:
        _add_plate(stage, look, features)
    if features.has_outer:
        _add_kick(stage, look, features)

    if turn is not None:

        @stage
        def reel(arrays: Arrays, i: int, b: int, substep: int, iteration: int, store: int, g: int):
            body = arrays.model.bodies[b]
            x = array_address(arrays.state.positions, body.particles)
            low = array_address(arrays.state.low, body.particles)
            turn(arrays.model, arrays.state, body, arrays.drives[b], arrays.frames[0].dt, x, low)


def _add_plate(stage: Callable, look: wp.Function, features: Features) -> None:
    """The stages by which a sheet resists bending."""
    bend_particle = make_bend(features)

    @stage
    def bend(arrays: Arrays, i: int, b: int, substep: int, iteration: int, store: int, g: int):
        here = look(arrays, b, substep, 0, 0)
        m, s, material = arrays.model, arrays.state, arrays.materials[b]
        bend_particle(i, m, s, here.body, material, here.step, here.x, here.low, here.p, here.d)

    @stage
    def curve(arrays: Arrays, i: int, b: int, substep: int, iteration: int, store: int, g: int):
        here = look(arrays, b, substep, 0, 0)
        moved = here.p
        if wp.static(features.method == "verlet"):
            moved = here.low
        curve_triangle(here.body.curves + i, arrays.model, arrays.state, here.body, here.x, moved)


def _add_kick(stage: Callable, look: wp.Function, features: Features) -> None:
    """The stages of slow forces at outer steps."""
    kick_particle = make_kick(features)

    @stage
    def kick(arrays: Arrays, i: int, b: int, substep: int, iteration: int, store: int, g: int):
        here = look(arrays, b, 0, 0, 0)
        frame, material = arrays.frames[0], arrays.materials[b]
        span = outer_weight(substep, frame.substeps, frame.outer) * frame.dt
        kick_particle(i, span, arrays.model, arrays.state, here.body, material, here.x, here.low, here.d)

    @stage
    def take_kick(arrays: Arrays, i: int, b: int, substep: int, iteration: int, store: int, g: int):
        here = look(arrays, b, 0, 0, 0)
        store_velocity(i, arrays.state, here.body, here.d)


def _make_touch(features: Features):
    """A Warp function: keeps particle i of body b outside all colliders."""
    contact_particle = make_contact(features)

    @wp.func
    def touch(arrays: Arrays, i: int, b: int, substep: int, here: Here):
        contact_particle(
            i,
            (substep % wp.static(SWEPT) * arrays.model.bodies.shape[0] + b) * arrays.colliders.shape[0],
            here.body.particles + i,
            arrays.materials[b],
            arrays.colliders,
            arrays.state.sweeps,
            arrays.state.contacts,
            arrays.state.velocities,
            arrays.state.last_displacements,
            here.step,
            here.x,
            here.low,
            here.d,
        )

    return touch


def _add_contact(stage: Callable, look: wp.Function, features: Features) -> None:
    """The stages that keep bodies outside colliders; the last contact of a substep is part of `finish`."""
    touch = _make_touch(features)
    contact_edge = make_edge_contact(features.shapes, features.order) if "edge" in features.constraints else None

    @stage
    def sweep(arrays: Arrays, i: int, b: int, substep: int, iteration: int, store: int, g: int):
        colliders, count = arrays.colliders.shape[0], arrays.frames[0].substeps
        q = i / colliders
        c = i - q * colliders
        if substep + q < count:
            before, after = float(substep + q) / float(count), float(substep + q + 1) / float(count)
            place = (q * arrays.model.bodies.shape[0] + b) * colliders + c
            arrays.state.sweeps[place] = sweep_collider(arrays.colliders[c], before, after)

    @stage
    def contact(arrays: Arrays, i: int, b: int, substep: int, iteration: int, store: int, g: int):
        touch(arrays, i, b, substep, look(arrays, b, substep, iteration, 0))

    if contact_edge is not None:

        @stage
        def edges(arrays: Arrays, i: int, b: int, substep: int, iteration: int, store: int, g: int):
            here = look(arrays, b, substep, iteration, 0)
            contact_edge(
                arrays.model.groups[g][2] + i,
                substep % wp.static(SWEPT) * arrays.model.bodies.shape[0] + b,
                here.body,
                arrays.materials[b],
                arrays.colliders,
                arrays.model,
                arrays.state,
                here.step,
                here.x,
                here.low,
                here.d,
            )


def _add_watch(stage: Callable, features: Features) -> None:
    """The stages that end a frame."""
    slacken, settle_ends = make_slacken(features), make_settle_ends(features)

    @stage
    def find_faults(arrays: Arrays, i: int, b: int, substep: int, iteration: int, store: int, g: int):
        p = arrays.model.bodies[b].particles + i
        if not is_good(load_row(arrays.state.positions, p), load_row(arrays.state.velocities, p)):
            arrays.state.faulty[b] = 1

    @stage
    def settle(arrays: Arrays, i: int, b: int, substep: int, iteration: int, store: int, g: int):
        body = arrays.model.bodies[b]
        p = body.particles + i
        if arrays.state.faulty[b] == 1:
            put_back(p, arrays.state.relapses[b], arrays.model, arrays.state)
            if wp.static(features.chain):
                arrays.state.chain_forces[p] = wp.vec3(0.0)
            if body.segments + i < body.segments_end:
                slacken(body.segments + i, arrays.state)
        else:
            keep(p, arrays.state.positions[p], arrays.state.low[p], arrays.state)

    @stage
    def count_faults(arrays: Arrays, i: int, b: int, substep: int, iteration: int, store: int, g: int):
        if wp.static(features.redoes):
            if arrays.state.rejected[i] == 0:
                return
        settle_ends(i, arrays.state.faulty[i] == 1, arrays.state)
        faulty = count_fault(i, arrays.state)
        if wp.static(features.looks_back):
            substeps = arrays.frames[0].substeps
            smooth = arrays.state.events[2 * i + (substeps - 1) % 2] != substeps
            arrays.state.history[i] = wp.where(smooth and not faulty, 1, 0)
            arrays.state.events[2 * i] = 0
            arrays.state.events[2 * i + 1] = 0
