"""Ropes of third order: one launch a frame, in which one thread, on GPUs too, takes a rope through all its substeps.

A substep that is not smooth is done again by implicit Euler from where it began: where a segment turns too far or is
torn, Newton's method does not settle, or a contact acts, and the one behind it at once.
"""

import dataclasses
from functools import lru_cache

import warp as wp

from cloth_sim_ros.sim.model import Body, Features, Model
from cloth_sim_ros.sim.physics.integrate import Step, make_step
from cloth_sim_ros.sim.schedules.air import make_panels
from cloth_sim_ros.sim.schedules.contact import make_contact
from cloth_sim_ros.sim.schedules.edge_contact import make_edge_contact
from cloth_sim_ros.sim.schedules.lines import make_solve_chain
from cloth_sim_ros.sim.schedules.native import CPU_FLAGS, array_address, load4, xyz
from cloth_sim_ros.sim.schedules.radau import finish_stages, keep_tensions, make_predict_stages, solve_stages
from cloth_sim_ros.sim.schedules.rope_watch import make_slacken
from cloth_sim_ros.sim.schedules.stages import make_finish, make_predict, moving_of, sweep_colliders
from cloth_sim_ros.sim.schedules.watch import count_fault, is_good, keep, put_back
from cloth_sim_ros.sim.state import Arrays, ColliderMotion, Frame, Material, State, gathered, given_type

THREADS = 32  # of a block


class Serial:
    """The launch of one batch. `advance()` simulates one frame of every rope in every world of it."""

    def __init__(self, features: Features, worlds: list[Arrays], device: wp.Device):
        bodies = worlds[0].model.bodies.shape[0]
        self._launch = wp.launch(
            make_frame(features),
            dim=len(worlds) * bodies,
            inputs=[gathered(worlds, device)],
            device=device,
            block_dim=THREADS,
            record_cmd=True,
        )

    def advance(self, substeps: int, iterations: int) -> None:
        """Launch one frame; both numbers are read from the device's Frame, where they are already."""
        self._launch.launch()


def make_touch(features: Features):
    """A Warp function: keeps a rope outside all colliders, by its edges and then by its particles; whether any
    touched."""
    contact = make_contact(features)
    edge_contact = make_edge_contact(features.shapes, features.order) if "edge" in features.constraints else None

    @wp.func
    def touch(
        b: int,
        m: Model,
        s: State,
        body: Body,
        material: Material,
        colliders: wp.array(dtype=ColliderMotion),
        step: Step,
        x: wp.uint64,
        low: wp.uint64,
        d: wp.uint64,
    ) -> bool:
        touched = bool(False)
        # Where the solve put them, which is the same where no collider is.
        for i in range(body.count):
            s.solved[body.particles + i] = xyz(load4(d, i))
        if wp.static(edge_contact is not None):
            for g in range(body.groups_end, body.edge_groups_end):
                for k in range(m.groups[g][2], m.groups[g][3]):
                    edge_contact(k, b, body, material, colliders, m, s, step, x, low, d)
        for i in range(body.count):
            g = body.particles + i
            sweep = b * colliders.shape[0]
            speeds, moves = s.velocities, s.last_displacements
            contact(i, sweep, g, material, colliders, s.sweeps, s.contacts, speeds, moves, step, x, low, d)
            touched = touched or wp.length_sq(xyz(load4(d, i)) - s.solved[g]) > 0.0
        return touched

    return touch


def make_smooth_substep(features: Features, touch):
    """A Warp function: one substep of third order; whether the motion was smooth, else nothing but scratch changed."""
    predict = make_predict_stages(features)

    @wp.func
    def smooth_substep(
        b: int,
        arrays: Arrays,
        m: Model,
        s: State,
        body: Body,
        material: Material,
        frame: Frame,
        step: Step,
        x: wp.uint64,
        low: wp.uint64,
        d: wp.uint64,
    ) -> bool:
        for i in range(body.count):
            predict(i, moving_of(i, s, body, x, low), m, s, body, frame, step, d)
        if not solve_stages(frame.iterations, m, s, body, material, step, x, low, d):
            return False
        if wp.static(touch is not None):
            if touch(b, m, s, body, material, arrays.colliders, step, x, low, d):
                return False
        for k in range(body.segments, body.segments_end):
            keep_tensions(k, s)
        for i in range(body.count):
            finish_stages(i, s, body, step, x, low, d)
        return True

    return smooth_substep


def make_rough_substep(features: Features, touch):
    """A Warp function: one substep of first order; whether the next one had better be so too."""
    first_order = dataclasses.replace(features, order=1)
    predict, finish = make_predict(first_order), make_finish(first_order)
    solve_chain = make_solve_chain(first_order, 1, True)

    @wp.func
    def rough_substep(
        b: int,
        arrays: Arrays,
        m: Model,
        s: State,
        body: Body,
        material: Material,
        frame: Frame,
        step: Step,
        x: wp.uint64,
        low: wp.uint64,
        d: wp.uint64,
    ) -> bool:
        rough = bool(False)
        for k in range(body.segments, body.segments_end):
            s.tension_changes[k] = 0.0
        for i in range(body.count):
            predict(i, moving_of(i, s, body, x, low), m, s, body, material, frame, step, x, low, d)
        for iteration in range(frame.iterations):
            step.first = iteration == 0
            if solve_chain(0, m, s, body, material, step, x, low, d, x):
                step.torn = True
                rough = True
            if wp.static(touch is not None):
                if touch(b, m, s, body, material, arrays.colliders, step, x, low, d):
                    rough = True
        for i in range(body.count):
            finish(i, 0, True, s, body, step, x, low, d)
        return rough

    return rough_substep


@lru_cache
def make_frame(features: Features):
    """The kernel of a whole frame for `features`, of order 3."""
    touch = make_touch(dataclasses.replace(features, order=1)) if features.shapes else None
    smooth_substep, rough_substep = make_smooth_substep(features, touch), make_rough_substep(features, touch)
    panels, slacken = make_panels(features) if features.panels else None, make_slacken(features)
    argument = given_type(features)

    @wp.kernel(enable_backward=False, module="unique", module_options=CPU_FLAGS)
    def simulate_ropes(given: argument):
        b = wp.tid()
        if wp.static(features.worlds):
            bodies = given[0].model.bodies.shape[0]
            w = b // bodies
            b -= w * bodies
            arrays = given[w]
        else:
            arrays = given
        m = arrays.model
        s = arrays.state
        frame = arrays.frames[0]
        material = arrays.materials[b]
        body = m.bodies[b]
        x = array_address(s.positions, body.particles)
        d = array_address(s.displacements, body.particles)
        low = array_address(s.low, body.particles)
        step = make_step(frame.dt, False, 1, 3.0, frame.global_damping)
        step.first = True
        step.repeats = frame.iterations > 1
        rough = bool(s.rough[b] > 0)
        for substep in range(frame.substeps):
            if wp.static(bool(features.shapes)):
                sweep_colliders(0, 1, b * arrays.colliders.shape[0], substep, arrays.colliders, frame, s.sweeps)
            if wp.static(features.panels != ""):
                panels(0, 1, m, s, body, material, frame, x)
            step.store = frame.iterations > 1 or substep == frame.substeps - 1
            smooth = bool(False)
            if not rough:
                smooth = smooth_substep(b, arrays, m, s, body, material, frame, step, x, low, d)
            if smooth:
                rough = False
            else:
                rough = rough_substep(b, arrays, m, s, body, material, frame, step, x, low, d)
        for i in range(body.count):
            if not is_good(load4(x, i), s.velocities[body.particles + i]):
                s.faulty[b] = 1
        s.rough[b] = wp.where(rough and s.faulty[b] == 0, 1, 0)
        for i in range(body.count):
            g = body.particles + i
            if s.faulty[b] > 0:
                put_back(g, s.relapses[b], m, s)
                s.chain_forces[g] = wp.vec3(0.0)
            else:
                keep(g, load4(x, i), load4(low, i), s)
        if s.faulty[b] > 0:
            for k in range(body.segments, body.segments_end):
                slacken(k, s)
        count_fault(b, s)

    return simulate_ropes
