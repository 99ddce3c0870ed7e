"""The patches of a batch on the device, and how large they are best (see patched.py)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp

from cloth_sim_ros.sim import cells, patching
from cloth_sim_ros.sim.constraints.cell_lanes import LANES
from cloth_sim_ros.sim.model import Body, Features, Model
from cloth_sim_ros.sim.schedules.buffers import piece_memory
from cloth_sim_ros.sim.schedules.exchange import run_at_once
from cloth_sim_ros.sim.schedules.resident_kernel import CELL_THREADS
from cloth_sim_ros.sim.schedules.tiles import Unfit
from cloth_sim_ros.sim.state import Arrays, Sweep
from cloth_sim_ros.sim.topology import Topology

_BYTES_A_MEMBER = 48  # position, low part and displacement
_SIZES = (4, 5, 6, 8, 10, 12, 16, 20, 24, 32, 40, 48)  # particles along a side that a patch owns
NOBODY = -1  # in place of a member
SENT = 1 << 30  # on top of an own particle that other patches need
# Microseconds on an H200: a launch, an exchange within one, 1024 places around either, a pass however small, and 1024
# cells of a pass.
_LAUNCH, _EXCHANGE, _THOUSAND_PLACES, _LEAST, _THOUSAND_CELLS = 3.5, 0.1, 1.8, 0.25, 1.8


@wp.struct
class Patches:
    """All T patches of a batch, each of `capacity` C places, and the second buffer of what they exchange."""

    body: wp.array(dtype=int)  # (T,)
    members: wp.array(dtype=int)  # (T C,) particles counted in the batch, + SENT; those of the margin as -2 - particle
    cells: wp.array(dtype=wp.vec2i)  # (T,) where a patch's records begin and end in those of `model`
    model: Model  # cells as in the Model of the batch, R in all, with places for particles
    peers: wp.array(dtype=wp.vec2i)  # (T,) first patch and end of those of the same body
    multipliers: wp.array2d(dtype=float)  # (worlds, 6 R) of a frame's last substep
    told: wp.array(dtype=wp.vec2i)  # (S,) which of these a patch tells, and where in State.cell_multipliers, by patch
    tells: wp.array(dtype=wp.vec2i)  # (T,) where those of a patch begin and end
    positions: wp.array(dtype=wp.vec4)  # (worlds N,)
    low: wp.array(dtype=wp.vec4)  # (worlds N,)
    velocities: wp.array(dtype=wp.vec4)  # (worlds N,)
    messages: wp.array(dtype=wp.vec4)  # (2 x 3 worlds N + worlds T,) where patches wait for one another (exchange.py)
    sent: wp.array(dtype=int)  # (worlds B,) substeps of all frames so far, by which messages are numbered
    last_velocities: wp.array(dtype=wp.vec3)  # (worlds N,) order 2 alone, as all below
    last_displacements: wp.array(dtype=wp.vec3)  # (worlds N,)
    here: wp.array(dtype=wp.vec4)  # (worlds T C,) velocities of the places of all patches
    last_here: wp.array(dtype=wp.vec3)  # (worlds T C,) their last velocities
    moved_here: wp.array(dtype=wp.vec3)  # (worlds T C,) their last displacements
    rough: wp.array(dtype=int)  # (2 worlds B,) 1 + the even and the odd substep whose motion was last not smooth
    sweeps: wp.array(dtype=Sweep)  # (worlds T K,)


@wp.func
def particle_of(member: int) -> int:
    """The particle, counted in the batch, that a patch has as `member`."""
    return wp.where(member < 0, -2 - member, member & wp.static(SENT - 1))


@dataclass(frozen=True)
class Plan:
    """Patches of every body; whether they wait for one another within a launch instead of having one a substep; the
    estimated microseconds of a substep in them, and with a block for each whole body."""

    bodies: list[list[patching.Patch]]
    waits: bool
    cost: float
    whole: float

    @property
    def capacity(self) -> int:
        """Places of a patch."""
        return -(-max(len(patch.members) for patch in sum(self.bodies, [])) // 32) * 32


def plan(
    features: Features,
    topologies: list[Topology],
    worlds: int,
    device: wp.Device,
    size: int | None = None,
    waits: bool | None = None,
) -> Plan:
    """The patches that own `size` x `size` particles, or those estimated to be fastest.

    waits: within a launch for one another; None: where all are on the device at once. Raises Unfit where there are
    none.
    """
    if features.constraints != ("cell",):
        raise Unfit("xpbd of other than the springs of a grid", "method verlet or grids that bend by springs or not")
    if features.panels:
        raise Unfit("wind", "a scene without wind, method verlet")
    sweeps = [cells.passes(topology) for topology in topologies]
    grids = [topology.grid for topology in topologies]
    shared = piece_memory(device)
    costs = {}
    for side in _SIZES if size is None else (size,):
        pieces = [patching.largest(grid, sweep, side) for grid, sweep in zip(grids, sweeps, strict=True)]
        places = max(len(patch.members) for patch, _ in pieces)
        if places * _BYTES_A_MEMBER > shared:
            break
        count = worlds * sum(number for _, number in pieces)
        # Whether a substep was smooth, as order 2 asks, all patches of a body decide, not neighbours alone.
        wait = waits is not False and features.order == 1 and run_at_once(count, device)
        cost = _cost([patch.passes for patch, _ in pieces], places, count, device)
        costs[side] = (cost + (_EXCHANGE if wait else _LAUNCH), wait)
    if not costs:
        raise Unfit("sweeps that reach too far", "fewer passes")
    side = min(costs, key=costs.get)
    bodies = [patching.cut(grid, sweep, side) for grid, sweep in zip(grids, sweeps, strict=True)]
    cost, wait = costs[side]
    return Plan(bodies, wait, cost, _cost(sweeps, 0, len(sweeps) * worlds, device))


def _cost(pieces: list[list[cells.Pass]], places: int, count: int, device: wp.Device) -> float:
    """The estimated microseconds of the passes of `count` blocks, of which the largest are among `pieces`, and of what
    they do for so many places besides."""
    rounds = -(-count // (device.sm_count if device.is_cuda else 1))
    longest = max(sum(_LEAST + _THOUSAND_CELLS * len(one.particles) / 1024 for one in piece) for piece in pieces)
    return rounds * (longest + _THOUSAND_PLACES * places / 1024)


def width_of(chosen: Plan, device: wp.Device) -> int:
    """How many cells a block projects at a time."""
    sweep = sum((patch.passes for patch in sum(chosen.bodies, [])), [])
    return LANES if device.is_cpu else cells.width_of(sweep, CELL_THREADS)


def staged_records(patches: Patches, capacity: int, device: wp.Device) -> int:
    """The records of cells that a block holds beside `capacity` places in shared memory; 0 where they do not fit."""
    most = int(np.diff(patches.cells.numpy()).max())
    return most if capacity * _BYTES_A_MEMBER + 16 * most <= piece_memory(device) else 0


def upload(chosen: Plan, worlds: list[Arrays], width: int, device: wp.Device) -> Patches:
    """The patches of all bodies on the device, and what they exchange in all worlds."""
    arrays, count = worlds[0], len(worlds)
    bodies = [dict(zip(Body.vars, row, strict=True)) for row in arrays.model.bodies.numpy().tolist()]
    body, members, records, springs = [], [], [], []
    for b, cut in enumerate(chosen.bodies):
        margins = np.concatenate([patch.members[~patch.own] for patch in cut])
        needed = np.bincount(margins, minlength=bodies[b]["count"]) > 0
        for patch in cut:
            mine = patch.members + bodies[b]["particles"]
            row = np.full(chosen.capacity, NOBODY)
            row[: len(mine)] = np.where(patch.own, mine + SENT * needed[patch.members], -2 - mine)
            found = np.concatenate([one.records(n % 2 == 1, width) for n, one in enumerate(patch.passes)])
            pairs = cells.springs_of(found)
            right = (pairs[..., 0] >= 0) & patch.own[pairs].any(axis=-1)  # others are not solved to their end
            body.append(b)
            members.append(row)
            records.append(found)
            springs.append(np.where(right[..., None], mine[pairs], -1))
    sizes = [len(rows) for rows in records]
    told, of = _told(arrays.model.cells.numpy(), bodies, np.concatenate(springs, axis=1), sizes)
    first = np.searchsorted(body, body)
    found = Patches()
    found.model = Model()
    found.model.cells = wp.array(np.concatenate(records), dtype=wp.vec4i, device=device)
    found.body = wp.array(np.array(body, np.int32), dtype=int, device=device)
    found.members = wp.array(np.concatenate(members).astype(np.int32), dtype=int, device=device)
    for name, pairs in (
        ("cells", _spans(sizes)),
        ("peers", np.column_stack([first, np.searchsorted(body, body, side="right")])),
        ("told", told),
        ("tells", _spans(np.bincount(of, minlength=len(members)))),
    ):
        setattr(found, name, wp.array(pairs.astype(np.int32), dtype=wp.vec2i, device=device))
    found.multipliers = wp.zeros((count, 6 * sum(sizes)), dtype=float, device=device)
    particles, second = arrays.state.positions.shape[0], arrays.state.last_displacements.shape[0]
    places = len(members) * chosen.capacity * (second > 0)
    for name, size, dtype in (
        ("positions", particles, wp.vec4),
        ("low", particles, wp.vec4),
        ("velocities", particles, wp.vec4),
        ("messages", (6 * particles + len(members)) * chosen.waits, wp.vec4),
        ("sent", len(bodies), int),
        ("last_velocities", second, wp.vec3),
        ("last_displacements", second, wp.vec3),
        ("here", places, wp.vec4),
        ("last_here", places, wp.vec3),
        ("moved_here", places, wp.vec3),
        ("rough", 2 * len(bodies) * (second > 0), int),
        ("sweeps", len(members) * arrays.colliders.shape[0], Sweep),
    ):
        setattr(found, name, wp.zeros(count * size, dtype=dtype, device=device))
    return found


def _spans(sizes: list[int] | np.ndarray) -> np.ndarray:
    """(T, 2) first and end of what lies behind one another."""
    ends = np.cumsum(sizes)
    return np.column_stack([ends - sizes, ends])


def _told(
    records: np.ndarray, bodies: list[dict], springs: np.ndarray, sizes: list[int]
) -> tuple[np.ndarray, np.ndarray]:
    """Where springs of the cells `records` (Q, 4) of all bodies lie among `springs` (6, R, 2) of patches of `sizes`
    records, by their particles: (S, 2) places among 6 R and 6 Q numbers, and the patch (S,), in order of patches."""
    start = np.zeros(len(records), np.int64)
    for body in bodies:
        start[body["cells"] : body["cells_end"]] = body["particles"]
    wanted = cells.springs_of(records)
    wanted = np.where(wanted >= 0, wanted + start[:, None], -1)
    keys, others = ((each.min(-1) * (1 << 31) + each.max(-1)).ravel() for each in (springs, wanted))
    order = np.argsort(keys, kind="stable")
    targets = np.flatnonzero(others >= 0)
    sources = order[np.searchsorted(keys, others[targets], sorter=order)]
    patch = np.repeat(np.arange(len(sizes)), sizes)[sources % sum(sizes)]
    by_patch = np.argsort(patch, kind="stable")
    return np.column_stack([sources, targets])[by_patch], patch[by_patch]
