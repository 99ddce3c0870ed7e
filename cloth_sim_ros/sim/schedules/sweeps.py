"""How the threads of a block share the springs and cells of a body: one sweep over all colours or passes.

The record of the next element is on its way while the present one is projected and while the block waits at a barrier,
because a fetch from a GPU's memory takes as long as a whole colour.
"""

import warp as wp

from cloth_sim_ros.sim.cells import ODD
from cloth_sim_ros.sim.constraints import make_project_cell, make_project_spring
from cloth_sim_ros.sim.constraints.cell import has, is_plain, make_project_plainly, springs_of
from cloth_sim_ros.sim.constraints.cell_lanes import LANES, project_lanes
from cloth_sim_ros.sim.model import Body, Features, Model
from cloth_sim_ros.sim.physics.integrate import Step
from cloth_sim_ros.sim.schedules.native import array_address, load4, load_record, sync
from cloth_sim_ros.sim.state import Material, State


def make_sweep(features: Features, shared: bool):
    """A Warp function: thread t of `width` projects its share of all colours or passes; None without springs.

    records: address of the body's first cell, where there are cells.
    """
    if "cell" in features.constraints:
        return make_sweep_cells(features.order) if shared else make_sweep_lanes()
    return make_sweep_springs(features.order, shared) if "spring" in features.constraints else None


def make_sweep_springs(order: int, shared: bool):
    """The sweep over single springs."""
    project_spring = make_project_spring(order)

    @wp.func
    def sweep_springs(
        t: int,
        width: int,
        m: Model,
        s: State,
        body: Body,
        material: Material,
        step: Step,
        records: wp.uint64,
        x: wp.uint64,
        low: wp.uint64,
        d: wp.uint64,
    ):
        last = m.springs.shape[0] - 1
        records = array_address(m.springs, 0)
        group = m.groups[body.groups]
        spring = wp.vec4()
        following = wp.vec4()
        ahead = wp.vec4()
        if wp.static(shared):
            spring = load4(records, wp.min(group[2] + t, last))
        for g in range(body.groups, body.tuple_groups):
            next = m.groups[wp.min(g + 1, body.tuple_groups - 1)]
            if wp.static(shared):
                ahead = load4(records, wp.min(next[2] + t, last))
            k = group[2] + t
            while k < group[3]:
                if wp.static(shared):
                    if k + width < group[3]:
                        following = load4(records, k + width)
                else:
                    spring = load4(records, k)
                project_spring(spring, k, group, m, s, body, material, step, x, low, d)
                spring = following
                k += width
            spring = ahead
            group = next
            sync()

    return sweep_springs


def make_sweep_lanes():
    """The sweep over cells of springs on a CPU, LANES at a time."""

    @wp.func
    def sweep_lanes(
        t: int,
        width: int,
        m: Model,
        s: State,
        body: Body,
        material: Material,
        step: Step,
        records: wp.uint64,
        x: wp.uint64,
        low: wp.uint64,
        d: wp.uint64,
    ):
        springs = springs_of(body, material, step)
        for k in range(body.cells, body.cells_end, wp.static(LANES)):
            project_lanes(k, springs, m, s, body, material, step, x, low, d)

    return sweep_lanes


def make_sweep_cells(order: int, stores: bool = True):
    """The sweep over cells of springs on a GPU; unless it `stores`, without multipliers.

    Passes hold multiples of the cell_width: a barrier is due where the next record of a thread is of another one.
    """
    plainly, in_every_case = make_project_plainly(order), make_project_cell(order, stores)

    def make_loop(project):
        @wp.func
        def loop(
            t: int,
            m: Model,
            s: State,
            body: Body,
            material: Material,
            step: Step,
            records: wp.uint64,
            x: wp.uint64,
            low: wp.uint64,
            d: wp.uint64,
        ):
            springs = springs_of(body, material, step)
            left = body.cells_end - body.cells
            last = left - 1
            idle = t >= body.cell_width  # and comes along for the barriers
            k = wp.min(t, body.cell_width - 1)
            stride = body.cell_width
            ahead = load_record(records, k)
            while left > 0:
                record = ahead
                ahead = load_record(records, wp.min(k + stride, last))
                if not idle:
                    project(record, body.cells + k, springs, m, s, body, material, step, x, low, d)
                k += stride
                left -= body.cell_width
                if has(record[1] ^ ahead[1], wp.static(ODD)):
                    sync()
            sync()

        return loop

    loop_plainly, loop_in_every_case = make_loop(plainly), make_loop(in_every_case)

    @wp.func
    def sweep_cells(
        t: int,
        width: int,
        m: Model,
        s: State,
        body: Body,
        material: Material,
        step: Step,
        records: wp.uint64,
        x: wp.uint64,
        low: wp.uint64,
        d: wp.uint64,
    ):
        if is_plain(material, step):
            loop_plainly(t, m, s, body, material, step, records, x, low, d)
        else:
            loop_in_every_case(t, m, s, body, material, step, records, x, low, d)

    return sweep_cells
