# SPDX-License-Identifier: Apache-2.0
"""Forces of the air on eight triangles at a time, in CPU vector registers; formulas as in physics/aerodynamics.py."""

import warp as wp

from cloth_sim_ros.sim.arrays.model import Body, Model
from cloth_sim_ros.sim.arrays.state import Frame, State
from cloth_sim_ros.sim.kernels.native import LANES, ROWS, on_cpu, source


@wp.func_native(on_cpu(ROWS + source(__file__, "panel_simd", LANES=LANES), "return false;"))
def _forces(
    panels: wp.array(dtype=wp.vec3i),
    begin: int,
    end: int,
    x: wp.uint64,
    v: wp.uint64,
    wind: wp.vec3,
    density: float,
    drag: float,
    lift: float,
    forces: wp.array(dtype=wp.vec4),
) -> bool: ...


@wp.func
def triangle_forces(m: Model, s: State, body: Body, frame: Frame, x: wp.uint64, v: wp.uint64) -> bool:
    """Store the air's force on all triangles of a body in State.panel_forces; on a GPU do nothing and return False."""
    return _forces(
        m.panels,
        body.panels,
        body.panels_end,
        x,
        v,
        frame.wind,
        frame.air_density,
        frame.drag,
        frame.lift,
        s.air.panel_forces,
    )
