# SPDX-License-Identifier: Apache-2.0
"""The program of a substep: its stages for the features of a scene, in order. It is written once for all executors.

The contract of an executor (block.py: one launch a frame; graph.py: several launches, with contact of objects between):

1. It gives every stage a `Context` of one body in one world: `begin` makes it for a frame, `enter` for a substep.
2. Each substep runs `before`, then `solved` and `touched` in each iteration, then `kept` and `after`. `ending` ends the
   frame.
   Contact between objects is solved before `touched`, so that an object on a floor sticks to it under any load. Their
   displacements are clamped after `kept`, so that no push moves one object through another.
3. A stage is run(t, width, ctx). `width` threads with numbers t call it, of which `threads` solve chains. All threads
   of the body see what they stored before the next stage begins.
4. A stage with `rounds` is run once for each round of lines, in order, with `ctx.group` set and a barrier between.
   Its `width` is a multiple of a warp on a GPU.
5. It sets `ctx.step.first`, `store` and `repeats`, and `ctx.last`, which is True in the last iteration. Stages of
   `every` n substeps run in substeps that n divides.
6. An executor knows no physics, and a stage knows no executor.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import warp as wp

from cloth_sim_ros.sim.arrays.context import Context
from cloth_sim_ros.sim.arrays.model import Features
from cloth_sim_ros.sim.arrays.state import Arrays, substeps_of, was_smooth
from cloth_sim_ros.sim.features.air.panels import make_panels
from cloth_sim_ros.sim.features.collider_contact.arrays import SWEPT
from cloth_sim_ros.sim.features.collider_contact.broad_phase import list_colliders, make_forget_contacts, measure_extent
from cloth_sim_ros.sim.features.collider_contact.facet_clamp import make_facet_clamp, make_give_up_way
from cloth_sim_ros.sim.features.collider_contact.part import forget_overlaps, is_placed, make_part
from cloth_sim_ros.sim.features.collider_contact.particle import make_contact, make_met_in
from cloth_sim_ros.sim.features.collider_contact.pinch_hold import make_feel_pinched, make_hold_pinched
from cloth_sim_ros.sim.features.collider_contact.surface import make_carry_presses, make_press, make_yield
from cloth_sim_ros.sim.features.collider_contact.sweep import sweep_collider
from cloth_sim_ros.sim.features.constraints.solve import make_stages
from cloth_sim_ros.sim.features.fault_recovery import find_fault, make_count, make_settle
from cloth_sim_ros.sim.features.grasp.hold import feel, hold
from cloth_sim_ros.sim.features.motion import make_finish, make_predict
from cloth_sim_ros.sim.features.plate.bending import damp, make_bend, make_curve_triangle
from cloth_sim_ros.sim.features.stage import Stage, both, once, over_meeting, over_particles
from cloth_sim_ros.sim.features.tearing.tear import followers, make_tear
from cloth_sim_ros.sim.features.twist.twist import make_find_twist, push_by_couples
from cloth_sim_ros.sim.features.winch.drum import make_turn
from cloth_sim_ros.sim.kernels.intrinsics import array_address, sync_warp
from cloth_sim_ros.sim.lines.membrane import lengthen
from cloth_sim_ros.sim.lines.solve import make_solve_line_row
from cloth_sim_ros.sim.physics.integrate import WEIGHED, make_step
from cloth_sim_ros.sim.ropes.solve import make_solve, start
from cloth_sim_ros.sim.topology.line_layout import WARP

_A_FRAME = 1 << 30  # number of substeps, more than a frame has


@dataclass
class Program:
    """The stages of a frame, in order."""

    before: list[Stage] = field(default_factory=list)
    solved: list[Stage] = field(default_factory=list)
    touched: list[Stage] = field(default_factory=list)
    kept: list[Stage] = field(default_factory=list)
    after: list[Stage] = field(default_factory=list)
    ending: list[Stage] = field(default_factory=list)


def make_program(features: Features, on_cpu: bool, threads: int = 1) -> Program:
    """Return the program for `features`.

    on_cpu: True for a CPU. threads: those that solve a rope.
    """
    program = Program()
    before, explicit = program.before, features.method == "verlet"
    if features.shapes:
        before += _look_around(features)
    if features.winch:
        before.append(Stage("winch", once(make_turn(features.order))))
    if features.membrane:
        before.append(Stage("lengthen", lengthen))
    if features.panels:
        before.append(Stage("panels", make_panels(features)))
    predict, finish = make_predict(features), make_finish(features)
    if features.twist:
        before.append(Stage("twist", once(make_find_twist(features.order))))
        predict = both(predict, push_by_couples)
    if features.handles:
        predict, finish = both(predict, hold), both(feel, finish)
    if features.pinches:
        predict, finish = both(predict, make_hold_pinched(features)), both(make_feel_pinched(features), finish)
    if features.plate and not explicit:
        predict = both(predict, damp)
    if features.curved and explicit:
        before.append(_make_curve(explicit))
    before.append(over_particles("predict", predict))
    if features.curved and not explicit:
        before.append(_make_curve(explicit))
    if features.plate and not explicit:
        before.append(over_particles("bend", make_bend(features)))
    if features.chain:
        begin = both(start, make_part(features)) if features.leans else start
        program.solved += [over_particles("start", begin), Stage("chain", make_solve(features, threads))]
    if features.lines:
        program.solved.append(_make_lines(features, on_cpu))
    if features.constraints:
        program.solved += make_stages(features)
    if features.shapes:
        _keep_out(program, features, None if features.in_step else finish)
    if features.in_step or not features.shapes:
        program.after.append(over_particles("finish", finish))
    if features.tears:
        program.after.append(Stage("tear", make_tear(features)))
    program.ending += [over_particles("find_faults", find_fault), over_particles("settle", make_settle(features))]
    if features.tears:
        program.ending += [Stage(f.key, f) for f in followers(features)]
    program.ending.append(Stage("count", once(make_count(features))))
    return program


def _keep_out(program: Program, features: Features, ends) -> None:
    """Add the stages that keep a body out of colliders, with `ends` as the end of the substep.

    `ends` joins the last stage: a GPU then waits once for both, and reads the many instructions of contact once.
    """
    met_in, contact = make_met_in(features), make_contact(features)
    if not features.surface:
        program.touched.append(over_meeting("contact", met_in, contact, ends))
        return
    program.touched.append(over_meeting("contact", met_in, contact))
    program.touched.append(Stage("press", make_press(features)))
    program.touched.append(over_meeting("give_way", met_in, make_yield(features)))
    program.kept.append(Stage("stop", make_facet_clamp(features)))
    program.kept.append(over_meeting("stay", met_in, make_give_up_way(features), ends))


def _look_around(features: Features) -> list[Stage]:
    """Return the stages that begin a frame, and some of its substeps, if there are colliders."""
    stages = []
    if features.surface:
        stages.append(Stage("carry_presses", make_carry_presses(features), every=_A_FRAME))
    stages.append(Stage("forget_contacts", make_forget_contacts(features), every=_A_FRAME))
    stages.append(Stage("forget_overlaps", forget_overlaps, every=_A_FRAME))
    if features.listed:
        stages.append(Stage("measure_extent", measure_extent, every=_A_FRAME))
        stages.append(Stage("list_colliders", list_colliders, every=_A_FRAME))
    stages.append(Stage("sweep", _sweep, every=SWEPT))
    return stages


def make_begin(features: Features):
    """Return a Warp function: the Context of body b of a world for a frame, with its particles in device arrays."""
    measured = features.measured

    @wp.func
    def begin(arrays: Arrays, b: int) -> Context:
        ctx = Context()
        ctx.model = arrays.model
        ctx.state = arrays.state
        ctx.body = arrays.model.bodies[b]
        ctx.material = arrays.materials[b]
        ctx.frame = arrays.frames[0]
        ctx.frame.substeps = arrays.limits[b].start
        if wp.static(measured):
            ctx.frame.substeps = substeps_of(ctx.state.control, arrays.limits[b], b)
        ctx.frame.dt = ctx.frame.length / float(ctx.frame.substeps)
        ctx.colliders = arrays.colliders
        ctx.numbers = arrays.numbers
        if wp.static(features.handles):
            ctx.handles = arrays.handles
            ctx.handle_counts = arrays.handle_counts
        if wp.static(features.winch):
            ctx.drive = arrays.drives[b]
        if wp.static(features.twist):
            ctx.turn = arrays.ends[b].turn
        ctx.x = array_address(arrays.state.positions, ctx.body.particles)
        ctx.position_lo = array_address(arrays.state.position_lo, ctx.body.particles)
        ctx.d = array_address(arrays.state.displacements, ctx.body.particles)
        return ctx

    return begin


def make_enter(features: Features):
    """Return a Warp function: the Context of a substep, from the one that `begin` made."""

    @wp.func
    def enter(given: Context, substep: int) -> Context:
        ctx = given
        ctx.substep = substep
        smooth = bool(False)
        if wp.static(features.looks_back):
            smooth = was_smooth(ctx.state.events, ctx.state.history, ctx.body.index, substep)
        ctx.step = make_step(ctx.frame.dt, smooth, wp.static(features.order), ctx.frame.global_damping)
        ctx.step.weighs = substep == 0 or (ctx.frame.moves > 0 and substep % WEIGHED == 0)
        if wp.static(features.order == 2):
            ctx.step.weighs = ctx.step.weighs or not smooth
        bodies, colliders = ctx.model.bodies.shape[0], ctx.colliders.shape[0]
        ctx.sweep = (substep % wp.static(SWEPT) * bodies + ctx.body.index) * colliders
        if wp.static(features.shapes != ()):
            ctx.placed = is_placed(ctx.body.index, ctx.state)
        return ctx

    return enter


@wp.func
def _sweep(t: int, width: int, ctx: Context):
    colliders = ctx.colliders.shape[0]
    for q in range(t, wp.static(SWEPT) * colliders, width):
        ahead = q / colliders
        substep, c = ctx.substep + ahead, q - ahead * colliders
        if substep < ctx.frame.substeps:
            count = float(ctx.frame.substeps)
            place = ctx.sweep + ahead * ctx.model.bodies.shape[0] * colliders + c
            before, after = float(substep) / count, float(substep + 1) / count
            ctx.state.contact.sweeps[place] = sweep_collider(ctx.colliders[c], before, after)


def _make_curve(explicit: bool) -> Stage:
    curve_triangle = make_curve_triangle(explicit)

    @wp.func
    def curve(t: int, width: int, ctx: Context):
        for c in range(ctx.body.curves + t, ctx.body.curves_end, width):
            curve_triangle(c, ctx)

    return Stage("curve", curve)


def _make_lines(features: Features, on_cpu: bool) -> Stage:
    solve_line_row, team = make_solve_line_row(features), 1 if on_cpu else WARP

    @wp.func
    def lines(t: int, width: int, ctx: Context):
        group = ctx.model.groups[ctx.group]
        first, end, many = group[0], group[1], group[2]
        for r in range(first + many * (t / wp.static(team)), end, many * (width / wp.static(team))):
            for k in range(many):
                solve_line_row(r + k, ctx)
                if wp.static(not on_cpu):
                    sync_warp()

    return Stage("lines", lines, rounds=True)
