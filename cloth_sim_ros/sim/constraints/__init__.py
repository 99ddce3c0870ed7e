"""Constraints projected colour by colour: each gathers its particles, asks physics/ for the correction, scatters it.

A new constraint: a file with `project`, its elements in topology.py, its name in model.CONSTRAINTS and in PROJECTIONS.
"""

import warp as wp

from cloth_sim_ros.sim.constraints import bend, cell, hinge, spring
from cloth_sim_ros.sim.model import CONSTRAINTS, Body, Model
from cloth_sim_ros.sim.physics.integrate import Step
from cloth_sim_ros.sim.state import Material, State

PROJECTIONS = {"hinge": hinge.make_project, "bend": bend.make_project}
make_project_spring = spring.make_project
make_project_cell = cell.make_project


def make_project_tuple(present: tuple[str, ...], order: int):
    """A Warp function that projects tuple k of a constraint type, holding those in `present` and no others, or None.

    alpha is the material compliance of the colour divided by h_e^2; x, low and d are addresses (schedules/native.py).
    """
    chosen = None
    for name in present:
        if name in PROJECTIONS:
            this = PROJECTIONS[name](order)
            chosen = this if chosen is None else _or(chosen, this, name)
    return chosen


def _or(others, project_this, name: str):
    index = CONSTRAINTS.index(name)

    def project(
        type: int,
        k: int,
        alpha: float,
        m: Model,
        s: State,
        body: Body,
        material: Material,
        step: Step,
        x: wp.uint64,
        low: wp.uint64,
        d: wp.uint64,
    ):
        if type == wp.static(index):
            project_this(type, k, alpha, m, s, body, material, step, x, low, d)
        else:
            others(type, k, alpha, m, s, body, material, step, x, low, d)

    return wp.func(project, name=f"project_or_{name}")
