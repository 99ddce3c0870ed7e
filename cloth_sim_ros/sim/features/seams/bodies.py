# SPDX-License-Identifier: Apache-2.0
"""Data of seams: the stitches between bodies of all batches in one list, and the arrays behind them.

A way is a line of structural springs away from a sewn particle, into its sheet, which stitches are solved with. No
particle is on two ways, and none on a way is sewn, so that each way is a chain with only one end that others move.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import warp as wp

from cloth_sim_ros.sim.arrays.model import Body
from cloth_sim_ros.sim.arrays.state import Arrays, Frame, Material
from cloth_sim_ros.sim.features.seams.arrays import SeamState
from cloth_sim_ros.sim.input.numbers import NumbersRow
from cloth_sim_ros.sim.kernels.device import allocated
from cloth_sim_ros.sim.ropes.arrays import Sewn
from cloth_sim_ros.sim.substeps.arrays import ControlState, StepLimits
from cloth_sim_ros.sim.topology import Topology

_LONGEST = 64  # springs of a way at most


@wp.struct
class SewnArrays:
    """The arrays of a batch in one world that seams need."""

    bodies: wp.array(dtype=Body)
    materials: wp.array(dtype=Material)
    frames: wp.array(dtype=Frame)
    limits: wp.array(dtype=StepLimits)
    control: ControlState
    positions: wp.array(dtype=wp.vec4)
    position_lo: wp.array(dtype=wp.vec4)
    displacements: wp.array(dtype=wp.vec4)
    events: wp.array(dtype=int)
    history: wp.array(dtype=int)
    bases: wp.array(dtype=wp.vec4)
    line_rests: wp.array(dtype=float)
    line_scales: wp.array(dtype=float)
    line_multipliers: wp.array(dtype=float)
    rope_targets: wp.array(dtype=wp.vec3)
    rope_sewn: wp.array(dtype=Sewn)
    seams: SeamState
    numbers: wp.array(dtype=NumbersRow)


@wp.func
def is_rope(arrays: SewnArrays) -> bool:
    """True for a batch of ropes, whose `line_...` are those of their segments: tensions [N] for multipliers."""
    return arrays.rope_sewn.shape[0] > 0


@wp.struct
class Stitch:
    """One stitch between two points, each on the line between two particles.

    batches, bodies: of each point, and the number of its body there. sewn: that body in Seams.bodies. seconds: 1 for
    second order. particles: in the arrays of these batches, two of the first point and two of the second. shares: of
    the second of each two. rope: the first and last particle of the rope that it slides along, or -1. held: the point,
    0 or 1, at a rope whose solve takes the stitch, or -1: none or both are ropes. number: in SeamState of its first
    batch. row: of the live numbers.
    """

    batches: wp.vec2i
    bodies: wp.vec2i
    sewn: wp.vec2i
    seconds: wp.vec2i
    particles: wp.vec4i
    shares: wp.vec2
    rope: wp.vec2i
    held: int
    number: int
    row: int


@wp.struct
class Seams:
    """All stitches of all worlds.

    arrays: (batches x worlds,), all worlds of the first batch first. stitches: (S,). bodies: (B,) batch of each sewn
    body, its number there, and 1 if it is of second order. touched: (T,) batch of each particle that a stitch may
    reach, its number there, its body, and 1 for second order. owners: (T,) its body in `bodies`. firsts: (batches,) the
    place of the first particle of a batch among all. moves: sums of displacements that stitches ask for, three for each
    particle of each world. counts: stitches at each of them. closing: (worlds B,) 1 if a stitch of that body closes in
    this substep. sharing: (worlds,) 1 if a particle has several of them now. inverses: the inverse mass of each with
    all that its ways drag along [1/kg]. starts: its displacement without stitches [m]. released: the same as its ways
    then move it. holds: (n,) stitches that a rope's solve takes, for each touched particle those that may be at it.
    hold_starts: (T + 1,) offsets into them.

    ways: (W,) first and end of its beads. way_starts: (T + 1,) those of a touched particle. beads: (n,) particle in its
    batch, and slot of the spring to it. pulls: (worlds n,) unit vector of that spring, and the mass behind it [kg].
    rests: (worlds n,) multiplier that the spring gains while its near end stays [kg m]. stiffs: (worlds n,) of a rope,
    the mass of that segment and what is behind it, seen from its near end [kg].
    """

    arrays: wp.array(dtype=SewnArrays)
    stitches: wp.array(dtype=Stitch)
    bodies: wp.array(dtype=wp.vec3i)
    touched: wp.array(dtype=wp.vec4i)
    owners: wp.array(dtype=int)
    firsts: wp.array(dtype=int)
    moves: wp.array(dtype=wp.int64)
    counts: wp.array(dtype=int)
    closing: wp.array(dtype=int)
    sharing: wp.array(dtype=int)
    inverses: wp.array(dtype=wp.mat33)
    starts: wp.array(dtype=wp.vec3)
    released: wp.array(dtype=wp.vec3)
    holds: wp.array(dtype=int)
    hold_starts: wp.array(dtype=int)
    ways: wp.array(dtype=wp.vec2i)
    way_starts: wp.array(dtype=int)
    beads: wp.array(dtype=wp.vec2i)
    pulls: wp.array(dtype=wp.vec4)
    rests: wp.array(dtype=float)
    stiffs: wp.array(dtype=wp.mat33d)
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
    worlds, bodies = len(batches[0]), [arrays[0].model.bodies.numpy() for arrays in batches]
    sizes = [arrays[0].state.positions.shape[0] for arrays in batches]
    every = worlds * sum(sizes)
    shapes = {"moves": 3 * every, "closing": worlds * len(homes), "sharing": worlds}
    seams = allocated(Seams, device, **shapes, **dict.fromkeys(("counts", "inverses", "starts", "released"), every))
    stitches, used, numbers = [], [], [0] * len(batches)
    ropes = np.array([arrays[0].state.rope.sewn.shape[0] > 0 for arrays in batches])
    places = {home: k for k, home in enumerate(homes.values())}
    for name, (batch, body) in homes.items():
        for each in topologies[name].stitches:
            rows = _rows(each, (batch, body), homes[each.other], bodies, numbers[batch])
            rows["seconds"] = np.array(orders)[rows["batches"]] - 1
            rows["sewn"] = (places[batch, body], places[homes[each.other]])
            rows["held"] = {(True, False): 0, (False, True): 1}.get(tuple(ropes[rows["batches"][0]]), -1)
            numbers[batch] += len(rows)
            stitches.append(rows)
            batch_of, body_of, second = (rows[part][:, [0, 0, 1, 1]] for part in ("batches", "bodies", "seconds"))
            used.append(np.stack([batch_of, rows["particles"], body_of, second], axis=-1).reshape(-1, 4))
            if each.slides:
                other, number = homes[each.other]
                first, count = (bodies[other][number][part] for part in ("particles", "count"))
                used.append([(other, first + k, number, orders[other] - 1) for k in range(count)])
    seams.arrays = wp.array([_arrays_of(each) for arrays in batches for each in arrays], SewnArrays, device=device)
    every_stitch = _taken_alone(np.concatenate(stitches))
    seams.stitches = wp.array(every_stitch, dtype=Stitch, device=device)
    sewn = [(*home, orders[home[0]] - 1) for home in homes.values()]
    seams.bodies = wp.array(np.array(sewn, np.int32), dtype=wp.vec3i, device=device)
    touched = np.unique(np.concatenate(used), axis=0).astype(np.int32)
    seams.touched = wp.array(touched, dtype=wp.vec4i, device=device)
    owners = [places[batch, body] for batch, _, body, _ in touched.tolist()]
    seams.owners = wp.array(owners, dtype=int, device=device)
    held = [_held_at(every_stitch, batch, particle) for batch, particle, *_ in touched.tolist()]
    seams.holds = wp.array(np.concatenate(held), dtype=int, device=device)
    seams.hold_starts = wp.array(np.cumsum([0, *map(len, held)]), dtype=int, device=device)
    of_homes = {home: topologies[name] for name, home in homes.items()}
    _add_ways(seams, touched, np.array([len(each) == 0 for each in held]), batches, of_homes, device)
    seams.firsts = wp.array(np.cumsum([0, *sizes[:-1]]), dtype=int, device=device)
    seams.particles, seams.worlds = sum(sizes), worlds
    return seams


def _taken_alone(stitches: np.ndarray) -> np.ndarray:
    """Return the stitches with none for a rope to take where another one moves the same particle: these would fight."""
    ends = np.stack([np.repeat(stitches["batches"], 2, axis=1), stitches["particles"]], axis=-1).reshape(-1, 2, 2, 2)
    held, rows = stitches["held"], np.arange(len(stitches))
    moved = {tuple(end) for end in ends[held < 0].reshape(-1, 2).tolist()}
    both = [any(tuple(end) in moved for end in each) for each in ends[rows, np.maximum(held, 0)].tolist()]
    stitches["held"] = np.where(both, -1, held)
    return stitches


def _held_at(stitches: np.ndarray, batch: int, particle: int) -> np.ndarray:
    """Numbers of the stitches that the solve of a rope takes and that may be at this particle of it."""
    held, rope = stitches["held"], stitches["rope"]
    rows, side = np.arange(len(stitches)), np.maximum(held, 0)
    ends = stitches["particles"].reshape(-1, 2, 2)[rows, side]
    slides = (rope[:, 0] >= 0) & (rope[:, 0] <= particle) & (particle <= rope[:, 1])
    here = (ends == particle).any(axis=1) | slides
    return np.flatnonzero((held >= 0) & (stitches["batches"][rows, side] == batch) & here)


def _add_ways(seams: Seams, touched: np.ndarray, begins: np.ndarray, batches, topologies, device: wp.Device) -> None:
    """Add the ways from touched particles. begins: from which. topologies: batch, number of the body there -> Topology.

    A rope takes its other stitches within its solve.
    """
    around: list[list[list[tuple[int, int]]]] = [[] for _ in touched]
    for home, topology in topologies.items():
        model = batches[home[0]][0].model
        body = model.bodies.numpy()[home[1]]
        rows = np.flatnonzero((touched[:, 0] == home[0]) & (touched[:, 2] == home[1]))
        first, slots = int(body["particles"]), _slots_of(model, body)
        found = _ways_of(topology, (touched[rows, 1] - first).tolist(), begins[rows].tolist())
        for row, ways in zip(rows, found, strict=True):
            for way in ways:
                ends = [touched[row, 1] - first, *way[:-1]]
                around[row].append([(first + j, slots[min(i, j), max(i, j)]) for i, j in zip(ends, way, strict=True)])
    ways = [way for each in around for way in each]
    ends = np.cumsum([0, *(len(way) for way in ways)])
    beads = np.array([bead for way in ways for bead in way], dtype=np.int32).reshape(-1, 2)
    bounds = np.column_stack([ends[:-1], ends[1:]]).astype(np.int32)
    seams.ways, seams.beads = (wp.array(each, dtype=wp.vec2i, device=device) for each in (bounds, beads))
    seams.way_starts = wp.array(np.cumsum([0, *map(len, around)]), dtype=int, device=device)
    worlds = len(batches[0])
    seams.pulls = wp.zeros(worlds * len(beads), dtype=wp.vec4, device=device)
    seams.rests = wp.zeros(worlds * len(beads), dtype=float, device=device)
    seams.stiffs = wp.zeros(worlds * len(beads), dtype=wp.mat33d, device=device)


def _ways_of(topology: Topology, sewn: Sequence[int], begins: Sequence[bool]) -> list[list[list[int]]]:
    """Return the ways from each of the particles `sewn` of an object, if it `begins` any: particles from near to far.

    All grow spring by spring, so that none takes what is nearer to another.
    """
    open_ways = [
        (k, way, []) for k, particle in enumerate(sewn) if begins[k] for way in _lines_from(topology, particle)
    ]
    taken, found = set(sewn), [[] for _ in sewn]
    for _ in range(_LONGEST):
        growing = []
        for k, ahead, way in open_ways:
            particle = next(ahead, None)
            if particle is None or particle in taken:
                continue
            if not way:
                found[k].append(way)
            taken.add(particle)
            way.append(particle)
            growing.append((k, ahead, way))
        open_ways = growing
    return found


def _lines_from(topology: Topology, particle: int):
    """Iterators over the particles of each line of structural springs from a particle on, one to each side of it."""
    if topology.chain is not None and topology.winch is None:
        yield iter(range(particle + 1, len(topology.masses)))
        yield iter(range(particle - 1, -1, -1))
    for family in topology.families:
        if family.kind != "structural":
            continue
        for line, at in np.argwhere(family.particles == particle):
            row, springs = family.particles[line], family.springs[line]
            ahead, behind = np.append(springs[at:] < 0, True), np.append(springs[:at][::-1] < 0, True)
            yield iter(row[at + 1 : at + 1 + int(np.argmax(ahead))].tolist())
            yield iter(row[:at][::-1][: int(np.argmax(behind))].tolist())


def _slots_of(model, body) -> dict[tuple[int, int], int]:
    """Slot of the structural spring or segment between two particles of a body, the lesser one first."""
    if model.segment_length.shape[0] > 0:
        return {(i, i + 1): int(body["segments"]) + i for i in range(int(body["count"]) - 1)}
    first, end = int(body["lines"]), int(body["lines_end"])
    nodes, others = (each.numpy()[first:end] for each in (model.line_nodes, model.line_others))
    there = np.flatnonzero(others >= 0)  # structural springs come last, where others join the same particles
    pairs = np.sort(np.column_stack([nodes, others])[there], axis=1)
    return {(int(i), int(j)): first + int(k) for (i, j), k in zip(pairs, there, strict=True)}


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
    found.materials, found.line_scales = arrays.materials, arrays.model.line_scales
    found.bases, found.line_multipliers = state.lines.bases, state.lines.line_multipliers
    found.rope_targets, found.rope_sewn = state.rope.targets, state.rope.sewn
    membrane = state.lines.line_lengths.shape[0] > 0
    found.line_rests = state.lines.line_lengths if membrane else arrays.model.line_rests
    if state.rope.sewn.shape[0] > 0:
        found.line_rests = found.line_scales = arrays.model.segment_length
        found.bases, found.line_multipliers = state.position_lo, state.rope.tensions
    for name in ("positions", "position_lo", "displacements", "events", "history"):
        setattr(found, name, getattr(state, name))
    return found
