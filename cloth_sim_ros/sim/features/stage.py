# SPDX-License-Identifier: Apache-2.0
"""Stages of a substep: make one from a function of a particle, and run several in sequence."""

from __future__ import annotations

from dataclasses import dataclass

import warp as wp

from cloth_sim_ros.sim.arrays.context import Context
from cloth_sim_ros.sim.kernels.cooperative import sync_all
from cloth_sim_ros.sim.kernels.intrinsics import sync


@dataclass(frozen=True)
class Stage:
    """A stage run(t, width, ctx). rounds: run it once per round of lines. every: run it in substeps divisible by it."""

    name: str
    run: wp.Function
    rounds: bool = False
    every: int = 1


def over_particles(name: str, stage) -> Stage:
    """Return a stage that runs `stage`(i, ctx) for every particle i of a body."""

    def run(t: int, width: int, ctx: Context):
        # Go from the last to the first: a rope has one particle more than segments, and the first is often pinned.
        for i in range(ctx.body.count - 1 - t, -1, -width):
            stage(i, ctx)

    return Stage(name, wp.func(run, name=f"over_particles_{name}"))


def over_meeting(name: str, met_in, stage, at_last=None) -> Stage:
    """Return a stage that runs `stage`(i, met, ctx) for every particle i, which may touch colliders.

    met_in: makes the Met of a body. at_last: another function of (i, ctx), which runs after it in the last iteration.
    """

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
    """Return a Warp function of a particle that runs `first`, then `second`."""

    @wp.func
    def run(i: int, ctx: Context):
        first(i, ctx)
        second(i, ctx)

    return run


def once(stage):
    """Return a Warp function in which one thread runs `stage`, a function of a body."""

    @wp.func
    def run(t: int, width: int, ctx: Context):
        if t == 0:
            stage(0, ctx)

    return run


@wp.func
def wait_in_block(ctx: Context):
    """Wait for the threads of a block."""
    sync()


@wp.func
def wait_in_group(ctx: Context):
    """Wait for the threads of all blocks that share a body."""
    sync_all(ctx.cooperative_group)


def in_sequence(stages: list[Stage], name: str, called: bool, wait=wait_in_block):
    """Return a Warp function in which the threads of a body run `stages` one after the other; None if there are none.

    name: prefix of its name. wait(ctx): the barrier after each stage. called: True if each stage is a function call,
    which costs 0.2 us but lets a CPU compile a frame with contact faster. Otherwise all are inlined.
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
    """Return the function of a stage with its rounds, and a barrier after each."""
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
