# SPDX-License-Identifier: Apache-2.0
"""Choose the executor that advances the bodies of a batch."""

from __future__ import annotations

from dataclasses import replace

import warp as wp

from cloth_sim_ros.sim.arrays.model import Features
from cloth_sim_ros.sim.arrays.state import Arrays
from cloth_sim_ros.sim.executors.block import Block, blocks_for, capacity, threads_for
from cloth_sim_ros.sim.executors.graph import Graph, Member

Executor = Block | Graph
EXECUTORS = ("block", "graph")
# Number of particles up to which one block is faster than two, on an H100, and number of blocks from which several are
# faster in any case, on an H200. Explicit steps have too little work between barriers for the latter.
_ALONE, _MANY = 1600, 10


def make_executor(
    features: Features, worlds: list[Arrays], counts: list[int], device: wp.Device, name: str | None
) -> Executor:
    """Return the executor of bodies of equal `features`: the one of this `name`, or the faster one if it is None.

    counts: number of particles of each body. Raises ValueError if a body does not fit the one block of "block".
    """
    largest, limit = max(counts), capacity(device)
    if name == "block" and largest > limit:
        raise ValueError(
            f"executor is 'block' for a body of {largest} particles; allowed are up to {limit} on {device.alias}"
        )
    if name == "graph":
        return Graph([Member(features, worlds, device)])
    return _in_blocks(features, worlds, counts, name == "block", device)


def make_safe_executor(
    features: Features, worlds: list[Arrays], numbers: tuple[wp.array, wp.array], counts: list[int], device: wp.Device
) -> Block:
    """Return the executor that repeats rejected explicit frames by XPBD of first order.

    numbers: (worlds, 1) Frame and (worlds, B) StepLimits to use. counts: number of particles of each body.
    """
    features = replace(features, method="xpbd", order=1, lines=True, redoes=True)
    again = []
    for w, world in enumerate(worlds):
        arrays = Arrays()
        for name in Arrays.vars:
            setattr(arrays, name, getattr(world, name))
        arrays.frames, arrays.limits = numbers[0][w], numbers[1][w]
        again.append(arrays)
    return _in_blocks(features, again, counts, False, device)


def _in_blocks(features: Features, worlds: list[Arrays], counts: list[int], alone: bool, device: wp.Device) -> Block:
    """Return an executor with one block a body, or with several if a body does not fit one.

    Several blocks are also faster for a large sheet, and for a smaller one if many multiprocessors are left to it;
    `alone` forbids them. A chain always has one block.
    """
    largest, bodies = max(counts), len(counts) * len(worlds)
    blocks, block = 1, threads_for(features, largest, device)
    if device.is_cuda and not features.chain and not alone:
        several = blocks_for(largest, bodies, device)
        many = several[0] >= _MANY and features.method == "xpbd"
        if many or largest > min(_ALONE, capacity(device)):
            blocks, block = several
    return Block(features, worlds, device, largest, blocks, block)
