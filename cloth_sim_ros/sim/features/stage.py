# SPDX-License-Identifier: Apache-2.0
"""A stage of a substep, the ways to make one of what is done to a particle, and several stages in turn."""

from __future__ import annotations

from dataclasses import dataclass

import warp as wp

from cloth_sim_ros.sim.arrays.context import Context
from cloth_sim_ros.sim.kernels.cooperative import sync_all
from cloth_sim_ros.sim.kernels.intrinsics import sync


@dataclass(frozen=True)
class Stage:
    """run(t, width, ctx). rounds: whether it is run once for each round of lines. every: n, in substeps n divides."""

    name: str
    run: wp.Function
    rounds: bool = False
    every: int = 1


def over_particles(name: str, stage) -> Stage:
    """A stage of every particle."""

    def run(t: int, width: int, ctx: Context):
        # From the last to the first: a rope has one particle more than segments, and the first is often pinned.
        for i in range(ctx.body.count - 1 - t, -1, -width):
            stage(i, ctx)

    return Stage(name, wp.func(run, name=f"over_particles_{name}"))


def over_meeting(name: str, met_in, stage, at_last=None) -> Stage:
    """A stage of every particle that meets colliders, and in the last iteration another one behind it."""

    def run(t: int, width: int, ctx: Context):
        met = met_in(ctx)
        for i in range(ctx.body.count - 1 - t, -1, -width):
            met.slot = ctx.body.particles + i
            stage(i, met, ctx)
            if wp.static(at_last is not None):
                if ctx.last:
                    at_last(i, ctx)

    return Stage(name, wp.func(run, name=f"over_meeting_{name}"))


def both(first, second):
    """A Warp function of a particle: one, then the other."""

    @wp.func
    def run(i: int, ctx: Context):
        first(i, ctx)
        second(i, ctx)

    return run


def once(stage):
    """A Warp function: one thread runs what is done to a body."""

    @wp.func
    def run(t: int, width: int, ctx: Context):
        if t == 0:
            stage(0, ctx)

    return run


@wp.func
def wait_in_block(ctx: Context):
    """A barrier of the threads of a block."""
    sync()


@wp.func
def wait_in_group(ctx: Context):
    """A barrier of the threads of all blocks that have a body together."""
    sync_all(ctx.cooperative_group)


def in_sequence(stages: list[Stage], name: str, called: bool, wait=wait_in_block):
    """A Warp function: the threads of a body run `stages` one after the other; None without any.

    wait(ctx): the barrier behind each. called: whether each is a function that is called. A CPU compiles a frame with
    contact in less time then, and 0.2 us a call are nothing beside it. Elsewhere all are inlined.
    """
    run = None
    for stage in stages:
        run = _then(run, _with_barrier(stage, called, wait), f"{name}_to_{stage.name}")
    return run


def _then(first, second, name: str):
    if first is None:
        return second

    def both(t: int, width: int, ctx: Context):
        first(t, width, ctx)
        second(t, width, ctx)

    return wp.func(both, name=name)


def _with_barrier(stage: Stage, called: bool, wait):
    """A stage with its rounds, and a barrier behind each."""
    run = stage.run

    def once(t: int, width: int, ctx: Context):
        if wp.static(stage.every == 1) or ctx.substep % wp.static(stage.every) == 0:
            run(t, width, ctx)
            wait(ctx)

    def rounds(t: int, width: int, ctx: Context):
        inside = ctx
        for g in range(ctx.body.groups, ctx.body.groups_end):
            inside.group = g
            run(t, width, inside)
            wait(ctx)

    return wp.func(rounds if stage.rounds else once, name=f"block_{stage.name}", inline=False if called else None)
