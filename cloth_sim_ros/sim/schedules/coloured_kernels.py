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
    make_finish,
    make_kick,
    make_predict,
    moving_of,
    store_velocity,
    sweep_collider,
)
from cloth_sim_ros.sim.schedules.watch import count_fault, is_good, keep, put_back
from cloth_sim_ros.sim.state import Arrays, given_type


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

        def launched(given: argument, size: int, b: int, substep: int, iteration: int, store: int, g: int):
            i = wp.tid()
            if wp.static(features.worlds):
                w = i // size
                run(given[w], i - w * size, b, substep, iteration, store, g)
            else:
                run(given, i, b, substep, iteration, store, g)

        launched.__qualname__ = f"launch_{function.__name__}"
        kernels[function.__name__] = wp.kernel(launched, enable_backward=False, module=found)

    return stage


def _make_look(features: Features):
    """A Warp function: where body b is in this substep and iteration."""

    @wp.func
    def look(arrays: Arrays, b: int, iteration: int, store: int) -> Here:
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

    @stage
    def predict(arrays: Arrays, i: int, b: int, substep: int, iteration: int, store: int, g: int):
        here = look(arrays, b, 0, 0)
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
        here = look(arrays, b, 0, 0)
        moving = finish_particle(i, substep, True, arrays.state, here.body, here.step, here.x, here.low, here.d)
        if wp.static(features.looks_back):
            if moving.rough > 0:
                arrays.state.events[b] = substep + 1

    if features.panels:

        @stage
        def panels(arrays: Arrays, i: int, b: int, substep: int, iteration: int, store: int, g: int):
            # g is how many threads share them.
            m, s, body = arrays.model, arrays.state, arrays.model.bodies[b]
            x = array_address(s.positions, body.particles)
            panel_forces(i, g, m, s, body, arrays.materials[b], arrays.frames[0], x)

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

    if features.looks_back:

        @stage
        def age(arrays: Arrays, i: int, b: int, substep: int, iteration: int, store: int, g: int):
            arrays.state.history[i] = wp.where(arrays.state.events[i] == substep + 1, 0, 1)
            arrays.state.events[i] = 0


def _add_plate(stage: Callable, look: wp.Function, features: Features) -> None:
    """The stages by which a sheet resists bending."""
    bend_particle = make_bend(features)

    @stage
    def bend(arrays: Arrays, i: int, b: int, substep: int, iteration: int, store: int, g: int):
        here = look(arrays, b, 0, 0)
        m, s, material = arrays.model, arrays.state, arrays.materials[b]
        bend_particle(i, m, s, here.body, material, here.step, here.x, here.low, here.p, here.d)

    @stage
    def curve(arrays: Arrays, i: int, b: int, substep: int, iteration: int, store: int, g: int):
        here = look(arrays, b, 0, 0)
        moved = here.p
        if wp.static(features.method == "verlet"):
            moved = here.low
        curve_triangle(here.body.curves + i, arrays.model, arrays.state, here.body, here.x, moved)


def _add_kick(stage: Callable, look: wp.Function, features: Features) -> None:
    """The stages of slow forces at outer steps."""
    kick_particle = make_kick(features)

    @stage
    def kick(arrays: Arrays, i: int, b: int, substep: int, iteration: int, store: int, g: int):
        here = look(arrays, b, 0, 0)
        frame, material = arrays.frames[0], arrays.materials[b]
        span = outer_weight(substep, frame.substeps, frame.outer) * frame.dt
        kick_particle(i, span, arrays.model, arrays.state, here.body, material, here.x, here.low, here.d)

    @stage
    def take_kick(arrays: Arrays, i: int, b: int, substep: int, iteration: int, store: int, g: int):
        here = look(arrays, b, 0, 0)
        store_velocity(i, arrays.state, here.body, here.d)


def _add_contact(stage: Callable, look: wp.Function, features: Features) -> None:
    """The stages that keep bodies outside colliders."""
    contact_particle = make_contact(features)
    contact_edge = make_edge_contact(features.shapes, features.order) if "edge" in features.constraints else None

    @stage
    def sweep(arrays: Arrays, i: int, b: int, substep: int, iteration: int, store: int, g: int):
        count = float(arrays.frames[0].substeps)
        arrays.state.sweeps[b * arrays.colliders.shape[0] + i] = sweep_collider(
            arrays.colliders[i], float(substep) / count, float(substep + 1) / count
        )

    @stage
    def contact(arrays: Arrays, i: int, b: int, substep: int, iteration: int, store: int, g: int):
        here = look(arrays, b, iteration, 0)
        contact_particle(
            i,
            b * arrays.colliders.shape[0],
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

    if contact_edge is not None:

        @stage
        def edges(arrays: Arrays, i: int, b: int, substep: int, iteration: int, store: int, g: int):
            here = look(arrays, b, iteration, 0)
            contact_edge(
                arrays.model.groups[g][2] + i,
                b,
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
        settle_ends(i, arrays.state.faulty[i] == 1, arrays.state)
        if count_fault(i, arrays.state):
            if wp.static(features.looks_back):
                arrays.state.history[i] = 0
