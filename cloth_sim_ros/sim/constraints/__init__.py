"""Constraints projected colour by colour: each gathers its particles, asks physics/ for the correction, scatters it.

A new constraint: a file with `make_project`, its elements in topology/, its name in model.CONSTRAINTS.
"""

from cloth_sim_ros.sim.constraints import hinge


def make_project_tuple(present: tuple[str, ...], order: int):
    """A Warp function that projects tuple k of those constraints in `present` that are tuples, or None.

    alpha is the material compliance of the colour divided by h_e^2; x, low and d are addresses (schedules/native.py).
    """
    return hinge.make_project(order) if "hinge" in present else None
