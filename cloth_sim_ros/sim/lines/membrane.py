# SPDX-License-Identifier: Apache-2.0
"""The membrane of a mesh: springs whose rest lengths follow the lengths around them (topology/membrane.py)."""

import warp as wp

from cloth_sim_ros.sim.arrays.context import Context
from cloth_sim_ros.sim.kernels.intrinsics import load4, xyz

# Least and largest rest length over that of the material.
SHORTENED, LENGTHENED = wp.constant(0.25), wp.constant(4.0)


@wp.func
def lengthen(r: int, lane: int, lanes: int, team: int, ctx: Context):
    """Find the rest lengths of the springs in row r, before its lines are solved; `team` threads share its lanes."""
    row = ctx.model.line_rows[r]
    for k in range(row[0] * lanes + lane, (row[0] + row[1]) * lanes, team):
        rest = ctx.model.line_rests[k]
        if rest >= 0.0 and row[3] == 0:
            i, j, across = ctx.model.line_nodes[k], ctx.model.line_others[k], ctx.model.line_across[k]
            p, q = across[0], across[1]
            xi, di, xj, dj = load4(ctx.x, i), load4(ctx.d, i), load4(ctx.x, j), load4(ctx.d, j)
            xp, dp, xq, dq = load4(ctx.x, p), load4(ctx.d, p), load4(ctx.x, q), load4(ctx.d, q)
            around = wp.vec4(
                wp.length(xyz((xp - xi) + (dp - di))),
                wp.length(xyz((xp - xj) + (dp - dj))),
                wp.length(xyz((xq - xi) + (dq - di))),
                wp.length(xyz((xq - xj) + (dq - dj))),
            )
            base = ctx.model.line_bases[k]
            length = base[0] + base[1] * wp.length(xyz((xj - xi) + (dj - di)))
            length += wp.dot(ctx.model.line_shares[k], around)
            rest = wp.clamp(length, SHORTENED * rest, LENGTHENED * rest)
        ctx.state.lines.line_lengths[k] = rest
