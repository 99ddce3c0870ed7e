# SPDX-License-Identifier: Apache-2.0
"""The arguments of every stage of a substep.

Functions take a Context, a Model or a State by value. By reference (`wp.ref`) CUDA's compiler makes a frame in half of
the time, but keeps them in local memory where the scene has facets: 27 kB a thread for 1.4.
"""

import warp as wp

from cloth_sim_ros.sim.arrays.model import Body, Model
from cloth_sim_ros.sim.arrays.state import ColliderMotion, Frame, HandleMotion, Material, State
from cloth_sim_ros.sim.features.winch.arrays import Drive
from cloth_sim_ros.sim.input.numbers import NumbersRow
from cloth_sim_ros.sim.kernels.cooperative import CooperativeGroup
from cloth_sim_ros.sim.physics.integrate import Step

SEARCH = wp.constant(3)  # cost of a search of a facet in a box, in tests whether a box can touch it


@wp.struct
class Context:
    """A body in a substep. x, position_lo, d: addresses of rows of four numbers for each of its particles.

    x: positions [m] and inverse masses [1/kg]. position_lo: rounding error of the float32 positions [m]. d:
    displacements plus position_lo [m], and effective inverse masses.
    """

    model: Model
    state: State
    body: Body
    material: Material
    frame: Frame
    step: Step
    x: wp.uint64
    position_lo: wp.uint64
    d: wp.uint64
    cooperative_group: CooperativeGroup  # the blocks that compute the body together
    colliders: wp.array(dtype=ColliderMotion)
    handles: wp.array(dtype=HandleMotion)
    handle_counts: wp.array(dtype=int)
    numbers: wp.array(dtype=NumbersRow)  # of the scene's own forces, then of its constraints and seams
    drive: Drive  # of a winch
    turn: float  # of the end of a rope [rad]
    substep: int
    sweep: int  # where the motion of its first collider in this substep lies in ContactState.sweeps
    group: int  # round of lines
    last: bool  # last iteration
    placed: bool  # the body was placed into a collider when anything was changed last, see part.py


@wp.func_native("""
#ifndef __CUDA_ARCH__
    work.data[b][2] += tests;
#endif
""")
def _add_tests(tests: int, work: wp.array(dtype=wp.vec4i), b: int):
    """Add tests on a CPU; a GPU, whose threads share them, has no price for them."""
    ...


@wp.func
def note_work(tests: int, ctx: Context):
    """Count work that depends on the motion, in tests of a facet; its cost bounds the substeps (see prices.py)."""
    _add_tests(tests, ctx.state.control.since, ctx.body.index)


@wp.func
def note_searches(searches: int, collider: ColliderMotion, ctx: Context):
    """Count searches of a facet for the point that a collider touches."""
    note_work(SEARCH * searches * collider.facets, ctx)
