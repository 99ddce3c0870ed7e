"""One launch a stage and a colour, for bodies too large for a block; on a GPU a frame is captured in one CUDA graph.

The same stages as the resident schedule, on plain device arrays, in the same order: both give the same state but for
the rounding of the compiler's choices.
"""

from functools import lru_cache

import warp as wp

from cloth_sim_ros.sim.constraints import make_project_cell, make_project_spring, make_project_tuple
from cloth_sim_ros.sim.constraints.cell import is_collapsed, is_plain, springs_of
from cloth_sim_ros.sim.constraints.cell_lanes import LANES, project_lanes
from cloth_sim_ros.sim.model import Body, Features
from cloth_sim_ros.sim.physics.integrate import Step, make_step
from cloth_sim_ros.sim.schedules.contact import make_contact
from cloth_sim_ros.sim.schedules.edge_contact import make_edge_contact
from cloth_sim_ros.sim.schedules.lines import make_solve_chain
from cloth_sim_ros.sim.schedules.native import CPU_FLAGS, array_address, load4i, load_row
from cloth_sim_ros.sim.schedules.reel import make_turn
from cloth_sim_ros.sim.schedules.stages import (
    in_turn,
    make_finish,
    make_panel,
    make_predict,
    moving_of,
    sweep_collider,
)
from cloth_sim_ros.sim.schedules.symmetry import goes_back, parts_of_motion
from cloth_sim_ros.sim.schedules.twist import ask_for
from cloth_sim_ros.sim.schedules.watch import count_fault, is_good, keep, put_back
from cloth_sim_ros.sim.state import Arrays, compliance_of, gathered, given_type

GRAPHS = 4  # frames kept at a time, for as many pairs of substeps and iterations


class Coloured:
    """The launches of one batch. `advance()` simulates one frame of every body in every world of it."""

    def __init__(self, features: Features, worlds: list[Arrays], device: wp.Device):
        self._features, self._device = features, device
        self._kernels = make_kernels(features, device.is_cpu)
        self._lanes = LANES if device.is_cpu else 1  # cells at a time
        self._worlds, self._given = len(worlds), gathered(worlds, device)
        arrays = worlds[0]
        self._colliders = arrays.colliders.shape[0]
        self._bodies = [dict(zip(Body.vars, body, strict=True)) for body in arrays.model.bodies.numpy().tolist()]
        self._groups = arrays.model.groups.numpy().tolist()
        self._recorded: dict[tuple, wp.Launch] = {}
        self._frame: list[wp.Launch] = []
        self._frames: dict[tuple[int, int], list[wp.Launch] | wp.Graph] = {}

    def advance(self, substeps: int, iterations: int) -> None:
        """Launch one frame; a new number of substeps or iterations is recorded, on a GPU in a graph; a few are kept."""
        settings = (substeps, iterations)
        if settings not in self._frames:
            if len(self._frames) == GRAPHS:
                self._frames.pop(next(iter(self._frames)))
            self._frames[settings] = self._record(*settings)
        frame = self._frames[settings]
        if isinstance(frame, wp.Graph):
            wp.capture_launch(frame)
            return
        for launch in frame:
            launch.launch()

    def _record(self, substeps: int, iterations: int) -> list[wp.Launch] | wp.Graph:
        self._frame = []
        self._launch_frame(substeps, iterations)
        if not self._device.is_cuda:
            return self._frame
        with wp.ScopedCapture(device=self._device) as capture:
            for launch in self._frame:
                launch.launch()
        return capture.graph

    def _launch(
        self, stage: str, size: int, b: int = 0, substep: int = 0, iteration: int = 0, store: int = 0, g: int = 0
    ) -> None:
        """Append a launch to the frame; those that are alike are one, packed once."""
        numbers = (size, b, substep, iteration, store, g)
        key = (stage, *numbers)
        if key not in self._recorded:
            inputs, dim = [self._given, *numbers], self._worlds * size
            kernel, device = self._kernels[stage], self._device
            self._recorded[key] = wp.launch(kernel, dim=dim, inputs=inputs, device=device, record_cmd=True)
        self._frame.append(self._recorded[key])

    def _launch_frame(self, substeps: int, iterations: int) -> None:
        if "cell" in self._features.constraints:
            for b, body in enumerate(self._bodies):
                begin, end = self._groups[body["groups"]][2], self._groups[body["tuple_groups"] - 1][3]
                self._launch("find_collapsed", end - begin, b)
        for substep in range(substeps):
            for b, body in enumerate(self._bodies):
                if self._colliders:
                    self._launch("sweep", self._colliders, b, substep)
                if self._features.winch:
                    self._launch("reel", 1, b)
                if self._features.panels:
                    self._launch("panel", body["panels_end"] - body["panels"], b)
                self._launch("predict", body["count"], b)
                for iteration in range(iterations):
                    store = int(iterations > 1 or substep == substeps - 1)
                    self._launch_iteration(b, body, iteration, store)
                self._launch("finish", body["count"], b, substep)
            if self._features.looks_back:
                self._launch("age", len(self._bodies), substep=substep)
        for b, body in enumerate(self._bodies):
            self._launch("find_faults", body["count"], b)
            self._launch("settle", body["count"], b)
        self._launch("count_faults", len(self._bodies))

    def _launch_iteration(self, b: int, body: dict, iteration: int, store: int) -> None:
        turn = iteration if iteration < 2 else 2 + iteration % 2  # of those after the first the parity alone matters
        if self._features.chain:
            self._launch("chain", 1, b, iteration=turn, store=store)
        kinds = dict.fromkeys(("springs", "cells"), ("groups", "tuple_groups")) | {
            "tuples": ("tuple_groups", "groups_end")
        }
        for stage, (begin, end) in kinds.items():
            if stage in self._kernels:
                sizes = [self._groups[g][3] - self._groups[g][2] for g in range(body[begin], body[end])]
                each = self._lanes if stage == "cells" else 1
                for g, size in enumerate(map(max, sizes, reversed(sizes)), body[begin]):
                    self._launch(stage, size // each, b, iteration=turn, store=store, g=g)
        if "edge" in self._features.constraints:
            for g in range(body["groups_end"], body["edge_groups_end"]):
                self._launch("edges", self._groups[g][3] - self._groups[g][2], b, iteration=turn, g=g)
        if self._colliders:
            self._launch("contact", body["count"], b, iteration=turn)


@wp.struct
class Here:
    """A body, the addresses of its positions, low parts and displacements, and the substep it is in."""

    body: Body
    x: wp.uint64
    low: wp.uint64
    d: wp.uint64
    step: Step


@lru_cache
def make_kernels(features: Features, lanes: bool) -> dict[str, wp.Kernel]:
    """The kernels of the stages that `features` need, in one module of their own; `lanes`: cells LANES at a time."""
    predict_particle, finish_particle = make_predict(features), make_finish(features)
    panel_force = make_panel(features) if features.panels else None
    contact_particle = make_contact(features) if features.shapes else None
    contact_edge = make_edge_contact(features.shapes, features.order) if "edge" in features.constraints else None
    project_one_spring, project_one_cell = make_project_spring(features.order), make_project_cell(features.order)
    project_one_tuple = make_project_tuple(features.constraints, features.order)
    solve_chain = make_solve_chain(features, 1, True) if features.chain else None
    turn = make_turn(features.order) if features.winch else None
    module = wp.get_module(f"cloth_sim_ros.coloured.{features.key()}{'.lanes' if lanes else ''}")
    wp.set_module_options(CPU_FLAGS, module)
    kernels: dict[str, wp.Kernel] = {}
    argument = given_type(features)

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
        kernels[function.__name__] = wp.kernel(launched, enable_backward=False, module=module)

    @wp.func
    def look(arrays: Arrays, b: int, iteration: int, store: int) -> Here:
        """Where body b is in this substep and iteration."""
        here = Here()
        here.body = arrays.model.bodies[b]
        here.x = array_address(arrays.state.positions, here.body.particles)
        here.low = array_address(arrays.state.low, here.body.particles)
        here.d = array_address(arrays.state.displacements, here.body.particles)
        smooth = bool(False)
        if wp.static(features.looks_back):
            smooth = arrays.state.history[b] > 0
        frame = arrays.frames[0]
        parts = parts_of_motion(here.body, arrays.materials[b], frame)
        here.step = make_step(frame.dt, smooth, wp.static(features.order), parts, frame.global_damping)
        here.step.first = iteration == 0
        if wp.static(features.order == 2):
            here.step.backward = goes_back(iteration, here.body, arrays.materials[b], arrays.frames[0])
        here.step.store = store != 0
        here.step.repeats = arrays.frames[0].iterations > 1
        if wp.static("cell" in features.constraints):
            here.step.collapsed = arrays.state.collapsed[b] > 0
        if wp.static(features.chain):
            here.step.torn = arrays.state.torn[b] > 0
        return here

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
            here.d,
        )

    @stage
    def finish(arrays: Arrays, i: int, b: int, substep: int, iteration: int, store: int, g: int):
        here = look(arrays, b, 0, 0)
        moving = finish_particle(i, substep, True, arrays.state, here.body, here.step, here.x, here.low, here.d)
        if wp.static(features.looks_back):
            if moving.rough > 0:
                arrays.state.events[b] = substep + 1

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
                arrays.state.tensions[body.segments + i] = 0.0
                if wp.static(features.beam):
                    arrays.state.moments[body.segments + i] = wp.vec3(0.0)
                if wp.static(features.twist):
                    arrays.state.couples[body.segments + i] = wp.vec3(0.0)
        else:
            keep(p, arrays.state.positions[p], arrays.state.low[p], arrays.state)

    @stage
    def count_faults(arrays: Arrays, i: int, b: int, substep: int, iteration: int, store: int, g: int):
        if wp.static(features.twist):
            if arrays.state.faulty[i] == 1:
                arrays.state.twists[i] = arrays.state.good_twists[i]
            else:
                arrays.state.good_twists[i] = arrays.state.twists[i]
        if wp.static(features.winch):
            if arrays.state.faulty[i] == 1:
                arrays.state.reels[i] = arrays.state.good_reels[i]
            else:
                arrays.state.good_reels[i] = arrays.state.reels[i]
        if count_fault(i, arrays.state):
            if wp.static(features.looks_back):
                arrays.state.history[i] = 0
        if wp.static("cell" in features.constraints):
            arrays.state.collapsed[i] = 0

    if features.shapes:

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

    if features.panels:

        @stage
        def panel(arrays: Arrays, i: int, b: int, substep: int, iteration: int, store: int, g: int):
            here = look(arrays, b, 0, 0)
            panel_force(
                here.body.panels + i,
                arrays.model,
                arrays.state,
                here.body,
                arrays.materials[b],
                arrays.frames[0],
                here.x,
            )

    if "spring" in features.constraints:

        @stage
        def springs(arrays: Arrays, i: int, b: int, substep: int, iteration: int, store: int, g: int):
            here = look(arrays, b, iteration, store)
            group = arrays.model.groups[in_turn(g, here.body.groups, here.body.tuple_groups, here.step)]
            k = group[2] + i
            if k >= group[3]:
                return
            project_one_spring(
                arrays.model.springs[k],
                k,
                group,
                arrays.model,
                arrays.state,
                here.body,
                arrays.materials[b],
                here.step,
                here.x,
                here.low,
                here.d,
            )

    if "cell" in features.constraints:

        @stage
        def find_collapsed(arrays: Arrays, i: int, b: int, substep: int, iteration: int, store: int, g: int):
            body = arrays.model.bodies[b]
            k = arrays.model.groups[body.groups][2] + i
            if is_collapsed(arrays.model.cells[k], array_address(arrays.state.positions, body.particles)):
                arrays.state.collapsed[b] = 1

        @stage
        def cells(arrays: Arrays, i: int, b: int, substep: int, iteration: int, store: int, g: int):
            here = look(arrays, b, iteration, store)
            group = arrays.model.groups[in_turn(g, here.body.groups, here.body.tuple_groups, here.step)]
            k = group[2] + i * wp.static(LANES if lanes else 1)
            if k >= group[3]:
                return
            material = arrays.materials[b]
            springs = springs_of(here.body, material, here.step)
            m = arrays.model
            if wp.static(lanes):
                if is_plain(material, here.step):
                    project_lanes(k, springs, m, here.x, here.d)
                    return
            for n in range(k, wp.min(k + wp.static(LANES if lanes else 1), group[3])):
                project_one_cell(
                    load4i(m.cells, n),
                    n,
                    springs,
                    m,
                    arrays.state,
                    here.body,
                    material,
                    here.step,
                    here.x,
                    here.low,
                    here.d,
                )

    if project_one_tuple is not None:

        @stage
        def tuples(arrays: Arrays, i: int, b: int, substep: int, iteration: int, store: int, g: int):
            here = look(arrays, b, iteration, store)
            group = arrays.model.groups[in_turn(g, here.body.tuple_groups, here.body.groups_end, here.step)]
            alpha = compliance_of(arrays.materials[b], group[1]) * here.step.inverse_square
            k = group[2] + i
            if k >= group[3]:
                return
            project_one_tuple(
                group[0],
                k,
                alpha,
                arrays.model,
                arrays.state,
                here.body,
                arrays.materials[b],
                here.step,
                here.x,
                here.low,
                here.d,
            )

    if features.chain:

        @stage
        def chain(arrays: Arrays, i: int, b: int, substep: int, iteration: int, store: int, g: int):
            here = look(arrays, b, iteration, store)
            m, s, material = arrays.model, arrays.state, arrays.materials[b]
            if wp.static(features.twist):
                ask_for(arrays.ends[b].turn, b, s)
            if solve_chain(0, m, s, here.body, material, here.step, here.x, here.low, here.d, here.x):
                arrays.state.torn[b] = 1

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

    return kernels
