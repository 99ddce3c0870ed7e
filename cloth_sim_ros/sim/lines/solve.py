# SPDX-License-Identifier: Apache-2.0
"""XPBD along lines of springs: one Newton step for all multipliers of a line at once.

For the springs j of a line, with unit vectors u_j, inverse masses w and violation C_j = |e_j| - rest_j,

    (J M^-1 J^T (1 + gamma) + alpha / h^2) dlambda = -(C + alpha / h^2 lambda + gamma slip)

is Macklin, Mueller and Chentanez (2016, eq. 18 and 26) for the line as one block. The matrix is tridiagonal. Its
diagonal is w_i + w_j. The entry beside it is -w u_j . u_j+1, with w of the particle between two springs. The diagonal
is raised by a fraction of 1e-5, so that a rigid line between two pins has a solution.

Later lines of the sweep move the particles on, so the slip of a line is not yet that of the substep. Dashpots would
resist motion that later lines undo, and a sheet at rest under load would be too soft. So order 2, and a sewn
sheet in any order, adds to the slip the part that followed this solve in the substep before. This is all of that slip
less `line_slips`.

Nor does the force of a spring belong to its length when the substep ends. A sheet at rest would be too soft, the more
so the longer the substep. So order 2 adds to each violation a defect 2 q - p. There q follows what the law lacks at the
end, and p follows q, in n substeps:

    q += (C + alpha / h^2 lambda + gamma slip)_end / n,    p += (q - p) / n,    n h_e = DEFECT_TIME x dashpot's time

(defect correction, Stetter 1978; with the lead q - p of double exponential smoothing, Brown 1963). At rest the law
holds at the end then, for any substep. A correction that comes late feeds what swings, by less than the dashpots take:
its time is a small multiple of theirs. With the lead it is not late for what swings slowly, where dashpots do little.
Sheets that are sewn, or whose dashpots are short, have none. kMostDefect bounds q over the rest length.

In substeps that weigh (see WEIGHED in integrate.py), lines of a body with pinned or held particles make their particles
heavier. Each adds the size of its force there. The largest tension of a line counts too.
"""

from __future__ import annotations

from functools import lru_cache

import warp as wp

from cloth_sim_ros.sim.arrays.context import Context
from cloth_sim_ros.sim.arrays.model import Features
from cloth_sim_ros.sim.arrays.state import compliance_of
from cloth_sim_ros.sim.kernels.native import ROWS, on_cpu, source
from cloth_sim_ros.sim.lines.membrane import coupled_share

# Time constant of the defect correction over the time of the dashpots. With 2, a silk strip under load swings.
DEFECT_TIME = wp.constant(4.0)
DAMPED = wp.constant(4.0)  # least time of the dashpots in h_e; with 2, a sheet on a ball does not come to rest


@lru_cache
def _source(slots: int) -> str:
    ctx = source(__file__, "opening") + "constexpr float kMostDefect = 0.1f;\n"
    return ctx + on_cpu(ROWS + source(__file__, "lanes"), source(__file__, "warp", Slots=slots))


@lru_cache
def make_solve_row(slots_a_thread: int):
    """Return a Warp function that moves the particles of one row of lines; all 32 threads of a warp call it together.

    slots_a_thread: number of particles that each thread of a warp holds.
    """

    @wp.func_native(_source(slots_a_thread))
    def solve_row(
        first: int,
        slots: int,
        lines: int,
        nodes: wp.array(dtype=int),
        rests: wp.array(dtype=float),
        scales: wp.array(dtype=float),
        multipliers: wp.array(dtype=float),
        scratch: wp.array(dtype=float),
        alpha: float,
        gamma: float,
        carried: float,
        corrects: float,
        particle: int,
        bases: wp.array(dtype=wp.vec4),
        velocities: wp.array(dtype=wp.vec4),
        slips: wp.array(dtype=float),
        defects: wp.array(dtype=float),
        tautness: wp.array(dtype=float),
        span: float,
        fresh: bool,
        stores: bool,
        keeps: bool,
        weighs: float,
        x_address: wp.uint64,
        position_lo: wp.uint64,
        d_address: wp.uint64,
    ): ...

    return solve_row


def make_solve_line_row(features: Features):
    """Return a Warp function that solves row r of the lines of a family."""
    solve_row = make_solve_row(features.line_slots)

    @wp.func
    def solve_line_row(r: int, ctx: Context):
        row = ctx.model.line_rows[r]
        alpha = compliance_of(ctx.material, row[3]) * ctx.step.inverse_square
        gamma = ctx.material.damping * ctx.body.line_damping * ctx.step.inverse
        carried, corrects = float(0.0), float(0.0)
        keeps = bool(False)
        held = ctx.body.pinned
        if wp.static(features.handles):
            held = held or ctx.state.grasp.held[ctx.body.index] > 0
        weighs = wp.where(held and ctx.step.weighs and ctx.step.first, ctx.step.inverse_square, 0.0)
        if wp.static(features.order == 2 or features.sewn):
            keeps = ctx.last and gamma > 0.0
            if wp.static(features.order == 1) or ctx.step.second:
                carried = wp.static(1.0 / 3.0)
        if wp.static(features.order == 2 and not features.sewn):  # a seam moves what lines have solved
            whole = bool(True)
            if wp.static(features.membrane):
                whole = coupled_share(ctx) == 1.0  # in longer substeps a mesh on a ball trembles with it
            # A trial, and a frame that is computed again, are corrected as the frame that they stand for.
            divisor, factor = ctx.state.control.divisors[ctx.body.index], ctx.state.control.factors[ctx.body.index]
            step = ctx.step.effective * float(wp.max(factor, 1)) / float(wp.max(divisor, 1))
            if whole and ctx.material.damping > DAMPED * step:
                corrects = ctx.step.effective / (DEFECT_TIME * ctx.material.damping)
        rests = ctx.model.line_rests
        if wp.static(features.membrane):
            rests = ctx.state.lines.line_lengths
        solve_row(
            row[0],
            row[1],
            row[2],
            ctx.model.line_nodes,
            rests,
            ctx.model.line_scales,
            ctx.state.lines.line_multipliers,
            ctx.state.lines.line_scratch,
            alpha,
            gamma,
            carried,
            corrects,
            ctx.body.particles,
            ctx.state.lines.bases,
            ctx.state.velocities,
            ctx.state.lines.line_slips,
            ctx.state.lines.line_defects,
            ctx.state.lines.tautness,
            ctx.step.effective,
            ctx.step.first,
            ctx.step.store,
            keeps,
            weighs,
            ctx.x,
            ctx.position_lo,
            ctx.d,
        )

    return solve_line_row
