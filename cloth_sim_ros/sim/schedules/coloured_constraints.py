"""The stages of the coloured schedule that project constraints, a colour or a pass a launch."""

from collections.abc import Callable

import warp as wp

from cloth_sim_ros.sim.constraints import make_project_cell, make_project_spring, make_project_tuple
from cloth_sim_ros.sim.constraints.cell import springs_of
from cloth_sim_ros.sim.constraints.cell_lanes import LANES, project_lanes
from cloth_sim_ros.sim.model import Features
from cloth_sim_ros.sim.schedules.lines import make_solve_chain
from cloth_sim_ros.sim.schedules.native import load4i
from cloth_sim_ros.sim.schedules.twist import ask_for
from cloth_sim_ros.sim.state import Arrays, compliance_of


def add_constraints(stage: Callable, look: wp.Function, features: Features, lanes: bool) -> None:
    """The stages of all constraints; `lanes`: cells LANES at a time."""
    project_one_spring, project_one_cell = make_project_spring(features.order), make_project_cell(features.order)
    project_one_tuple = make_project_tuple(features.constraints, features.order)
    solve_chain = make_solve_chain(features, 1, True) if features.chain else None

    if "spring" in features.constraints:

        @stage
        def springs(arrays: Arrays, i: int, b: int, substep: int, iteration: int, store: int, g: int):
            here = look(arrays, b, iteration, store)
            group = arrays.model.groups[g]
            k = group[2] + i
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
        def cells(arrays: Arrays, i: int, b: int, substep: int, iteration: int, store: int, g: int):
            here = look(arrays, b, iteration, store)
            group = arrays.model.groups[g]
            k = group[2] + i * wp.static(LANES if lanes else 1)
            material = arrays.materials[b]
            springs = springs_of(here.body, material, here.step)
            m = arrays.model
            if wp.static(lanes):
                s, step = arrays.state, here.step
                project_lanes(k, springs, m, s, here.body, material, step, here.x, here.low, here.d)
            else:
                project_one_cell(
                    load4i(m.cells, k),
                    k,
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
            group = arrays.model.groups[g]
            material = arrays.materials[b]
            alpha = compliance_of(material, group[1]) * here.step.inverse_square
            k = group[2] + i
            project_one_tuple(
                group[0],
                k,
                alpha,
                arrays.model,
                arrays.state,
                here.body,
                material,
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
