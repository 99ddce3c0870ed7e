# SPDX-License-Identifier: Apache-2.0
"""The membrane of a mesh: springs whose rest lengths follow the lengths around them (topology/membrane.py)."""

import warp as wp

from cloth_sim_ros.sim.arrays.context import Context
from cloth_sim_ros.sim.arrays.model import Model
from cloth_sim_ros.sim.kernels.intrinsics import load4, xyz
from cloth_sim_ros.sim.kernels.native import LANES, ROWS, on_cpu, source

# Least and largest rest length over that of the material.
SHORTENED, LENGTHENED = wp.constant(0.25), wp.constant(4.0)
# (omega h_e)^2 of the springs up to which the whole coupling acts, that from which least of it does, and that share.
WHOLE, STIFF, LEAST = wp.constant(60.0), wp.constant(240.0), wp.constant(0.8)


@wp.func
def coupled_share(ctx: Context) -> float:
    """Return the share of the coupling that acts in this substep."""
    rate = ctx.body.line_rate * ctx.material.largest_inverse_mass / wp.max(ctx.material.compliance[0], 1.0e-30)
    return wp.clamp((STIFF - rate / ctx.step.inverse_square) / (STIFF - WHOLE), 0.0, 1.0) * (1.0 - LEAST) + LEAST


@wp.func
def coupled_length(k: int, x: wp.uint64, lo: wp.uint64, m: Model) -> float:
    """Return the rest length [m] of the spring in slot k at positions x + lo, with all of the coupling."""
    i, j, across = m.line_nodes[k], m.line_others[k], m.line_across[k]
    p, q = across[0], across[1]
    xi, xj, xp, xq = load4(x, i), load4(x, j), load4(x, p), load4(x, q)
    li, lj, lp, lq = load4(lo, i), load4(lo, j), load4(lo, p), load4(lo, q)
    lengths = wp.vec4(
        wp.length(xyz((xp - xi) + (lp - li))),
        wp.length(xyz((xp - xj) + (lp - lj))),
        wp.length(xyz((xq - xi) + (lq - li))),
        wp.length(xyz((xq - xj) + (lq - lj))),
    )
    base = m.line_bases[k]
    length = base[0] + base[1] * wp.length(xyz((xj - xi) + (lj - li)))
    return length + wp.dot(m.line_shares[k], lengths)


@wp.func_native(on_cpu(ROWS + source(__file__, "lengthen", LANES=LANES), "return false;"))
def _lengthen_lanes(
    begin: int,
    end: int,
    nodes: wp.array(dtype=int),
    others: wp.array(dtype=int),
    across: wp.array(dtype=wp.vec2i),
    shares: wp.array(dtype=wp.vec4),
    bases: wp.array(dtype=wp.vec2),
    rests: wp.array(dtype=float),
    x: wp.uint64,
    lo: wp.uint64,
    part: float,
    least: float,
    most: float,
    lengths: wp.array(dtype=float),
) -> bool:
    """Store the rest lengths of the springs in these slots on a CPU; on a GPU do nothing and return False."""
    ...


@wp.func
def lengthen(t: int, width: int, ctx: Context):
    """Stage that finds the rest lengths of springs where the substep starts; thread t of `width` does its share."""
    share, m, lengths = coupled_share(ctx), ctx.model, ctx.state.lines.line_lengths
    if _lengthen_lanes(
        ctx.body.lines,
        ctx.body.lines_end,
        m.line_nodes,
        m.line_others,
        m.line_across,
        m.line_shares,
        m.line_bases,
        m.line_rests,
        ctx.x,
        ctx.position_lo,
        share,
        SHORTENED,
        LENGTHENED,
        lengths,
    ):
        return
    for k in range(ctx.body.lines + t, ctx.body.lines_end, width):
        rest = ctx.model.line_rests[k]
        if rest >= 0.0:
            length = coupled_length(k, ctx.x, ctx.position_lo, ctx.model)
            rest = wp.clamp(rest + share * (length - rest), SHORTENED * rest, LENGTHENED * rest)
        ctx.state.lines.line_lengths[k] = rest
