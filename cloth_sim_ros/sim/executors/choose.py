# SPDX-License-Identifier: Apache-2.0
"""Which executor advances the bodies of a batch."""

from __future__ import annotations

from dataclasses import replace

import warp as wp

from cloth_sim_ros.sim.arrays.model import Features
from cloth_sim_ros.sim.arrays.state import Arrays
from cloth_sim_ros.sim.executors.block import Block, blocks_for, capacity, threads_for
from cloth_sim_ros.sim.executors.graph import Graph, Member

Executor = Block | Graph
EXECUTORS = ("block", "graph")
_ALONE = 1600  # particles that one block computes faster than several, on an H100


def make_executor(
    features: Features, worlds: list[Arrays], counts: list[int], device: wp.Device, name: str | None
) -> Executor:
    """The executor of bodies of equal `features` and so many particles each: that of a `name`, else the faster.

    Raises ValueError where a body does not fit the one block that it is to have.
    """
    largest, limit = max(counts), capacity(device, features)
    if name == "block" and largest > limit:
        raise ValueError(
            f"executor is 'block' for a body of {largest} particles; allowed are up to {limit} on {device.alias}"
        )
    if name == "graph":
        return Graph([Member(features, worlds, device)])
    return _in_blocks(features, worlds, counts, name == "block", device)


def make_safe_executor(
    features: Features, worlds: list[Arrays], frames: wp.array, counts: list[int], device: wp.Device
) -> Block:
    """XPBD of first order for bodies whose explicit frame is rejected, in substeps as `frames` (worlds, 1) tell.

    counts: how many particles each body has.
    """
    features = replace(features, method="xpbd", order=1, lines=True, redoes=True)
    again = []
    for w, world in enumerate(worlds):
        arrays = Arrays()
        for name in Arrays.vars:
            setattr(arrays, name, getattr(world, name))
        arrays.frames = frames[w]
        again.append(arrays)
    return _in_blocks(features, again, counts, False, device)


def _in_blocks(features: Features, worlds: list[Arrays], counts: list[int], alone: bool, device: wp.Device) -> Block:
    """A block a body, or several where they do not fit one.

    Several compute a large sheet faster too; not if it shall be `alone`. The threads of a chain need one block.
    """
    largest, bodies = max(counts), len(counts) * len(worlds)
    if device.is_cuda and not features.chain and not alone and largest > min(_ALONE, capacity(device, features)):
        blocks, block = blocks_for(largest, bodies, device)
    else:
        blocks, block = 1, threads_for(features, largest, device)
    return Block(features, worlds, device, largest, blocks, block)
