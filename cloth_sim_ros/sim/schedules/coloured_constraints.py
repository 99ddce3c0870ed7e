"""The stages of the coloured schedule that solve constraints, a family of lines or a colour a launch."""

from collections.abc import Callable

import warp as wp

from cloth_sim_ros.sim.lines.solve import make_solve_line_row
from cloth_sim_ros.sim.model import Features
from cloth_sim_ros.sim.schedules.lines import make_solve_chain
from cloth_sim_ros.sim.schedules.twist import ask_for
from cloth_sim_ros.sim.state import Arrays


def add_constraints(stage: Callable, look: wp.Function, features: Features, threads_a_row: int) -> None:
    """The stages of all constraints; threads_a_row: a warp on a GPU, one thread on a CPU."""
    solve_chain = make_solve_chain(features, 1, True) if features.chain else None

    if "line" in features.constraints:
        solve_line_row = make_solve_line_row(features)

        @stage
        def lines(arrays: Arrays, i: int, b: int, substep: int, iteration: int, store: int, g: int):
            here = look(arrays, b, iteration, store)
            m, s, material = arrays.model, arrays.state, arrays.materials[b]
            group = m.groups[g]
            r = group[2] + i / wp.static(threads_a_row)
            solve_line_row(r, group[1], m, s, here.body, material, here.step, here.x, here.low, here.d)

    if features.chain:

        @stage
        def chain(arrays: Arrays, i: int, b: int, substep: int, iteration: int, store: int, g: int):
            here = look(arrays, b, iteration, store)
            m, s, material = arrays.model, arrays.state, arrays.materials[b]
            if wp.static(features.twist):
                ask_for(arrays.ends[b].turn, b, s)
            if solve_chain(0, m, s, here.body, material, here.step, here.x, here.low, here.d, here.x):
                arrays.state.torn[b] = 1
