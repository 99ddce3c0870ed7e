"""Constraints projected colour by colour: each gathers its particles, asks physics/ for the correction, scatters it.

A new constraint: a file with `project`, its elements in topology.py, its name in model.CONSTRAINTS and in PROJECTIONS.
"""

import warp as wp

from cloth_sim_ros.sim.constraints import bend, hinge, spring
from cloth_sim_ros.sim.model import CONSTRAINTS, Body, Model
from cloth_sim_ros.sim.physics.integrate import Step
from cloth_sim_ros.sim.state import Material, State

PROJECTIONS = {"spring": spring.make_project, "hinge": hinge.make_project, "bend": bend.make_project}


def make_project(present: tuple[str, ...], order: int):
    """A Warp function that projects element k of a constraint type, holding those in `present` and no others.

    alpha is the material compliance of the colour divided by h_e^2; x and d are addresses (see schedules/memory.py).
    """
    chosen = PROJECTIONS[present[0]](order)
    for name in present[1:]:
        chosen = _or(chosen, PROJECTIONS[name](order), name)
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
        d: wp.uint64,
    ):
        if type == wp.static(index):
            project_this(type, k, alpha, m, s, body, material, step, x, d)
        else:
            others(type, k, alpha, m, s, body, material, step, x, d)

    return wp.func(project, name=f"project_or_{name}")
