# SPDX-License-Identifier: Apache-2.0
"""Bending and twist of a chain, before and after the solve of its stretch."""

import warp as wp

from cloth_sim_ros.sim.arrays.context import Context
from cloth_sim_ros.sim.arrays.model import Features
from cloth_sim_ros.sim.features.twist.twist import make_find_twist, push_by_couples
from cloth_sim_ros.sim.kernels.intrinsics import sync
from cloth_sim_ros.sim.ropes.beam import make_bend_by_moments, make_solve_beam
from cloth_sim_ros.sim.ropes.beam_parallel import make_solve_beam_together, most_together
from cloth_sim_ros.sim.ropes.beam_two_sided import make_solve_beam_two_sided


def make_bend_before(features: Features, threads: int):
    """Return a Warp function that applies the last substep's moments and the present twist; None without bending."""
    if not features.beam:
        return None
    bend_by_moments = make_bend_by_moments(features.bent, features.winch)
    find_twist = make_find_twist(features.order, features.handles) if features.twist else None

    @wp.func
    def bend_before(t: int, ctx: Context):
        if ctx.step.first:
            if wp.static(features.twist):
                if t == 0:
                    find_twist(ctx)
                sync()
            for i in range(t, ctx.body.count, threads):
                bend_by_moments(i, ctx)
                if wp.static(features.twist):
                    push_by_couples(i, ctx)
            sync()

    return bend_before


def make_bend_after(features: Features, threads: int):
    """Return a Warp function that solves for the moments; None without bending."""
    if not features.beam:
        return None
    bent, winch = features.bent, features.winch
    solve_beam = make_solve_beam(bent, winch)
    solve_beam_two_sided = make_solve_beam_two_sided(bent) if threads == 1 else None
    solve_beam_together = make_solve_beam_together(threads, bent) if threads > 1 else None

    @wp.func
    def bend_after(t: int, ctx: Context, shared: wp.uint64):
        if wp.static(winch):
            if t == 0:
                solve_beam(ctx)
        elif wp.static(threads > 1):
            if ctx.body.count <= wp.static(most_together(threads, bent)):
                solve_beam_together(t, ctx, shared)
            elif t == 0:
                solve_beam(ctx)
        elif not solve_beam_two_sided(ctx):
            solve_beam(ctx)

    return bend_after
