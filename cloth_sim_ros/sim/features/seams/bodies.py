# SPDX-License-Identifier: Apache-2.0
"""Data of seams: the stitches between bodies of all batches in one list, and the arrays behind them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import warp as wp

from cloth_sim_ros.sim.arrays.model import Body
from cloth_sim_ros.sim.arrays.state import Arrays, Frame
from cloth_sim_ros.sim.features.seams.arrays import SeamState
from cloth_sim_ros.sim.input.numbers import NumbersRow
from cloth_sim_ros.sim.substeps.arrays import ControlState, StepLimits
from cloth_sim_ros.sim.topology import Topology


@wp.struct
class SewnArrays:
    """The arrays of a batch in one world that seams need."""

    bodies: wp.array(dtype=Body)
    frames: wp.array(dtype=Frame)
    limits: wp.array(dtype=StepLimits)
    control: ControlState
    positions: wp.array(dtype=wp.vec4)
    position_lo: wp.array(dtype=wp.vec4)
    displacements: wp.array(dtype=wp.vec4)
    events: wp.array(dtype=int)
    history: wp.array(dtype=int)
    seams: SeamState
    numbers: wp.array(dtype=NumbersRow)


@wp.struct
class Stitch:
    """One stitch between two points, each on the line between two particles.

    batches, bodies: of each point, and the number of its body there. seconds: 1 for second order. particles: in the
    arrays of these batches, two of the first point and two of the second. shares: of the second of each two. rope: the
    first and last particle of the rope that it slides along, or -1. number: in SeamState of its first batch. row: of
    the live numbers.
    """

    batches: wp.vec2i
    bodies: wp.vec2i
    seconds: wp.vec2i
    particles: wp.vec4i
    shares: wp.vec2
    rope: wp.vec2i
    number: int
    row: int


@wp.struct
class Seams:
    """All stitches of all worlds.

    arrays: (batches x worlds,), all worlds of the first batch first. stitches: (S,). bodies: (B,) batch of each sewn
    body, its number there, and 1 if it is of second order. touched: (T,) batch of each particle that a stitch may
    reach, and its number there. firsts: (batches,) the place of the first particle of a batch among all. moves: sums of
    displacements that stitches ask for, three for each particle of each world. counts: stitches at each of them.
    """

    arrays: wp.array(dtype=SewnArrays)
    stitches: wp.array(dtype=Stitch)
    bodies: wp.array(dtype=wp.vec3i)
    touched: wp.array(dtype=wp.vec2i)
    firsts: wp.array(dtype=int)
    moves: wp.array(dtype=wp.int64)
    counts: wp.array(dtype=int)
    particles: int
    worlds: int


def seams_of(
    batches: Sequence[Sequence[Arrays]],
    orders: Sequence[int],
    homes: dict[str, tuple[int, int]],
    topologies: dict[str, Topology],
    device: wp.Device,
) -> Seams:
    """Build the Seams of batches.

    batches: the arrays of each batch in all worlds. orders: of each batch. homes: name -> batch, and number of the body
    there. device: where arrays are allocated.
    """
    seams, worlds = Seams(), len(batches[0])
    bodies = [arrays[0].model.bodies.numpy() for arrays in batches]
    sizes = [arrays[0].state.positions.shape[0] for arrays in batches]
    stitches, used, numbers = [], [], [0] * len(batches)
    for name, (batch, body) in homes.items():
        for each in topologies[name].stitches:
            rows = _rows(each, (batch, body), homes[each.other], bodies, numbers[batch])
            rows["seconds"] = np.array(orders)[rows["batches"]] - 1
            numbers[batch] += len(rows)
            stitches.append(rows)
            used += [np.column_stack([rows["batches"][:, k // 2], rows["particles"][:, k]]) for k in range(4)]
            if each.slides:
                other, number = homes[each.other]
                rope = bodies[other][number]
                along = rope["particles"] + np.arange(rope["count"])
                used.append(np.column_stack([np.full(len(along), other), along]))
    seams.arrays = wp.array([_arrays_of(each) for arrays in batches for each in arrays], SewnArrays, device=device)
    seams.stitches = wp.array(np.concatenate(stitches), dtype=Stitch, device=device)
    sewn = [(*home, orders[home[0]] - 1) for home in homes.values()]
    seams.bodies = wp.array(np.array(sewn, np.int32), dtype=wp.vec3i, device=device)
    touched = np.unique(np.concatenate(used), axis=0).astype(np.int32)
    seams.touched = wp.array(touched, dtype=wp.vec2i, device=device)
    seams.firsts = wp.array(np.cumsum([0, *sizes[:-1]]), dtype=int, device=device)
    seams.particles, seams.worlds = sum(sizes), worlds
    seams.moves = wp.zeros(3 * worlds * seams.particles, dtype=wp.int64, device=device)
    seams.counts = wp.zeros(worlds * seams.particles, dtype=int, device=device)
    return seams


def _rows(stitches, home: tuple[int, int], other: tuple[int, int], bodies: list[np.ndarray], first: int) -> np.ndarray:
    """The rows of Stitch of one seam, whose first number in SeamState is `first`."""
    rows = np.zeros(len(stitches.shares), dtype=Stitch.numpy_dtype())
    begin, ropes = (bodies[batch][body]["particles"] for batch, body in (home, other)), bodies[other[0]][other[1]]
    rows["batches"], rows["bodies"] = (home[0], other[0]), (home[1], other[1])
    rows["particles"] = stitches.particles + np.repeat(list(begin), 2)
    rows["shares"], rows["row"] = stitches.shares, stitches.row
    last = ropes["particles"] + ropes["count"] - 1
    rows["rope"] = (ropes["particles"], last) if stitches.slides else (-1, -1)
    rows["number"] = first + np.arange(len(rows))
    return rows


def _arrays_of(arrays: Arrays) -> SewnArrays:
    found, state = SewnArrays(), arrays.state
    found.bodies, found.frames, found.limits = arrays.model.bodies, arrays.frames, arrays.limits
    found.control, found.seams, found.numbers = state.control, state.seams, arrays.numbers
    for name in ("positions", "position_lo", "displacements", "events", "history"):
        setattr(found, name, getattr(state, name))
    return found
