"""Grids on a whole GPU by xpbd: a body is cut into patches, and a block makes one substep of its patch a launch.

A block loads its patch with the margin that one sweep reaches into shared memory, predicts, projects all passes,
touches colliders, and writes its own particles into the other of two buffers: what neighbours need is computed twice
instead of waited for. Every particle's arithmetic is the same, in the same order, as in the other schedules. The last
substeps of a frame, which store what reports read, and frames of several iterations are those of the coloured
schedule. The launches of a frame are captured in one CUDA graph.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import warp as wp

from cloth_sim_ros.sim import cells, patches
from cloth_sim_ros.sim.constraints.cell_lanes import LANES
from cloth_sim_ros.sim.model import Features, Model
from cloth_sim_ros.sim.physics.integrate import make_step
from cloth_sim_ros.sim.schedules import native
from cloth_sim_ros.sim.schedules.buffers import Frames, make_buffer_of, piece_memory
from cloth_sim_ros.sim.schedules.coloured import Coloured
from cloth_sim_ros.sim.schedules.contact import make_contact
from cloth_sim_ros.sim.schedules.native import load4, store4, sync, xyz
from cloth_sim_ros.sim.schedules.resident import CELL_THREADS
from cloth_sim_ros.sim.schedules.stages import Moving, make_finish, make_predict, pack, sweep_collider
from cloth_sim_ros.sim.schedules.sweeps import make_sweep_cells, make_sweep_lanes
from cloth_sim_ros.sim.schedules.symmetry import parts_of_motion
from cloth_sim_ros.sim.schedules.tiles import Unfit
from cloth_sim_ros.sim.state import Arrays, Sweep, gathered, given_type
from cloth_sim_ros.sim.topology import Topology

_BYTES_A_MEMBER = 48  # position, low part and displacement
_SIZES = (6, 8, 12, 16, 24, 32, 48)  # particles along a side that a patch owns
_NOBODY = -1  # in place of a member
# Microseconds on an H200: a launch with its loads and stores, a pass however small, and 1024 cells of a pass.
_LAUNCH, _LEAST, _THOUSAND_CELLS = 5.0, 0.4, 2.3


@wp.struct
class Patches:
    """All T patches of a batch, each of `capacity` C places, and the second buffer of what they exchange."""

    body: wp.array(dtype=int)  # (T,)
    members: wp.array(dtype=int)  # (T C,) particles counted in the batch, those of the margin as -2 - particle
    cells: wp.array(dtype=wp.vec2i)  # (T,) where a patch's records begin and end in those of `model`
    model: Model  # cells as in the Model of the batch, with places for particles
    positions: wp.array(dtype=wp.vec4)  # (worlds N,)
    low: wp.array(dtype=wp.vec4)  # (worlds N,)
    velocities: wp.array(dtype=wp.vec4)  # (worlds N,)
    last_velocities: wp.array(dtype=wp.vec3)  # (worlds N,) order 2 alone, as all below
    last_displacements: wp.array(dtype=wp.vec3)  # (worlds N,)
    here: wp.array(dtype=wp.vec4)  # (worlds T C,) velocities of the places of all patches
    last_here: wp.array(dtype=wp.vec3)  # (worlds T C,) their last velocities
    moved_here: wp.array(dtype=wp.vec3)  # (worlds T C,) their last displacements
    rough: wp.array(dtype=int)  # (2 worlds B,) 1 + the even and the odd substep whose motion was last not smooth
    sweeps: wp.array(dtype=Sweep)  # (worlds T K,)


@dataclass(frozen=True)
class Plan:
    """Patches of every body; the estimated microseconds of a substep in them, and with a block for each whole body."""

    bodies: list[list[patches.Patch]]
    cost: float
    whole: float

    @property
    def capacity(self) -> int:
        """Places of a patch."""
        return -(-max(len(patch.members) for patch in sum(self.bodies, [])) // 32) * 32


def plan_patches(
    features: Features, topologies: list[Topology], worlds: int, device: wp.Device, size: int | None = None
) -> Plan:
    """The patches that own `size` x `size` particles, or those estimated to be fastest. Raises Unfit where there are
    none."""
    if features.constraints != ("cell",):
        raise Unfit("xpbd of other than the springs of a grid", "method verlet or grids that bend by springs or not")
    if features.panels:
        raise Unfit("wind", "a scene without wind, method verlet")
    sweeps = [cells.passes(topology) for topology in topologies]
    grids = [topology.grid for topology in topologies]
    shared = piece_memory(device)
    costs = {}
    for side in _SIZES if size is None else (size,):
        pieces = [patches.largest(grid, sweep, side) for grid, sweep in zip(grids, sweeps, strict=True)]
        if max(len(patch.members) for patch, _ in pieces) * _BYTES_A_MEMBER > shared:
            break
        count = sum(number for _, number in pieces)
        costs[side] = _LAUNCH + _cost([patch.passes for patch, _ in pieces], count * worlds, device)
    if not costs:
        raise Unfit("sweeps that reach too far", "fewer passes")
    side = min(costs, key=costs.get)
    bodies = [patches.cut(grid, sweep, side) for grid, sweep in zip(grids, sweeps, strict=True)]
    return Plan(bodies, costs[side], _cost(sweeps, len(sweeps) * worlds, device))


def _cost(pieces: list[list[cells.Pass]], count: int, device: wp.Device) -> float:
    """The estimated microseconds of the passes of `count` blocks, of which the largest are among `pieces`."""
    rounds = -(-count // (device.sm_count if device.is_cuda else 1))
    return rounds * max(sum(_LEAST + _THOUSAND_CELLS * len(one.particles) / 1024 for one in piece) for piece in pieces)


class Patched:
    """The launches of one batch. `advance()` simulates one frame of every body in every world of it."""

    def __init__(self, features: Features, worlds: list[Arrays], chosen: Plan, device: wp.Device):
        self._device, self._given = device, gathered(worlds, device)
        self._whole = Coloured(features, worlds, device)
        width = cells.width_of(sum((patch.passes for patch in sum(chosen.bodies, [])), []), CELL_THREADS)
        width = LANES if device.is_cpu else width
        self._block = 1 if device.is_cpu else min(CELL_THREADS, chosen.capacity)
        self._patches = _upload(chosen, worlds, width, device)
        self._count = len(worlds) * self._patches.body.shape[0]
        self._kernel, self._hand_over = make_kernels(features, chosen.capacity, self._block, width)
        self._looks_back, self._bodies = features.looks_back, len(worlds) * len(chosen.bodies)
        self._frames = Frames(self._launch_frame, device)

    def advance(self, substeps: int, iterations: int) -> None:
        """Launch one frame."""
        if iterations > 1 or substeps < 3:
            self._whole.advance(substeps, iterations)
            return
        self._frames.run(substeps)

    def _launch_frame(self, substeps: int) -> None:
        alone = 2 * ((substeps - 1) // 2)  # an even number of turns ends in the first buffer
        if self._looks_back:
            self._patches.rough.zero_()
        for substep in range(alone):
            wp.launch(
                self._kernel,
                dim=(self._count, self._block),
                inputs=[self._given, self._patches, substep],
                device=self._device,
                block_dim=self._block,
            )
        if self._looks_back:
            wp.launch(
                self._hand_over, dim=self._bodies, inputs=[self._given, self._patches, alone], device=self._device
            )
        for launch in self._whole.launches(alone, substeps):
            launch.launch()


def _upload(chosen: Plan, worlds: list[Arrays], width: int, device: wp.Device) -> Patches:
    arrays = worlds[0]
    starts = [body[2] for body in arrays.model.bodies.numpy().tolist()]
    body, members, records = [], [], []
    for b, cut in enumerate(chosen.bodies):
        for patch in cut:
            body.append(b)
            row = np.full(chosen.capacity, _NOBODY)
            mine = patch.members + starts[b]
            row[: len(mine)] = np.where(patch.own, mine, -2 - mine)
            members.append(row)
            records.append(np.concatenate([one.records(n % 2 == 1, width) for n, one in enumerate(patch.passes)]))
    ends = np.cumsum([len(rows) for rows in records])
    spans = np.column_stack([np.concatenate([[0], ends[:-1]]), ends])
    found = Patches()
    found.model = Model()
    found.model.cells = wp.array(np.concatenate(records), dtype=wp.vec4i, device=device)
    found.body = wp.array(np.array(body, np.int32), dtype=int, device=device)
    found.members = wp.array(np.concatenate(members).astype(np.int32), dtype=int, device=device)
    found.cells = wp.array(spans.astype(np.int32), dtype=wp.vec2i, device=device)
    for name in ("positions", "low", "velocities"):
        size = len(worlds) * getattr(arrays.state, name).shape[0]
        setattr(found, name, wp.zeros(size, dtype=wp.vec4, device=device))
    particles, places, bodies = arrays.state.last_displacements.shape[0], found.members.shape[0], len(chosen.bodies)
    second = len(worlds) * (particles > 0)
    found.last_velocities = wp.zeros(second * particles, dtype=wp.vec3, device=device)
    found.last_displacements = wp.zeros(second * particles, dtype=wp.vec3, device=device)
    found.here = wp.zeros(second * places, dtype=wp.vec4, device=device)
    found.last_here = wp.zeros(second * places, dtype=wp.vec3, device=device)
    found.moved_here = wp.zeros(second * places, dtype=wp.vec3, device=device)
    found.rough = wp.zeros(2 * second * bodies, dtype=int, device=device)
    found.sweeps = wp.zeros(len(worlds) * len(body) * arrays.colliders.shape[0], dtype=Sweep, device=device)
    return found


@lru_cache
def make_kernels(features: Features, capacity: int, block: int, width: int) -> tuple[wp.Kernel, wp.Kernel]:
    """The kernel of a substep of patches of `capacity` places, and that which says what was smooth to the substep after
    the last of them; `width` cells are projected at a time."""
    predict, finish = make_predict(features), make_finish(features)
    contact = make_contact(features) if features.shapes else None
    x_address, d_address, low_address = (native.make_tile_address(3 * capacity, part * capacity) for part in range(3))
    project = make_sweep_lanes(features.order) if block == 1 else make_sweep_cells(features.order, stores=False)
    buffer_of = make_buffer_of(Patches)
    argument = given_type(features)
    options = {"enable_backward": False, "module": "unique", "module_options": native.CPU_FLAGS}

    @wp.kernel(launch_bounds=block, **options)
    def advance(given: argument, patches: Patches, substep: int):
        q, t = wp.tid()
        w = q / patches.body.shape[0]
        n = q - w * patches.body.shape[0]
        b = patches.body[n]
        # Each part by itself, so that the arrays of a single world stay in the kernel's constant arguments.
        if wp.static(features.worlds):
            s = given[w].state
            body = given[w].model.bodies[b]
            frame = given[w].frames[0]
            material = given[w].materials[b]
            colliders = given[w].colliders
        else:
            s = given.state
            body = given.model.bodies[b]
            frame = given.frames[0]
            material = given.materials[b]
            colliders = given.colliders
        m = patches.model
        smooth = bool(False)
        rough = 2 * (w * s.history.shape[0] + b)
        if wp.static(features.order == 2):
            smooth = s.history[b] > 0
            if substep > 0:
                smooth = patches.rough[rough + (substep - 1) % 2] != substep
        step = make_step(frame.dt, smooth, wp.static(features.order), parts_of_motion(body, material, frame))
        step.first = True
        body.cells = patches.cells[n][0]
        body.cells_end = patches.cells[n][1]
        body.cell_width = wp.static(width)
        before = buffer_of(s, patches, substep % 2, w)
        after = buffer_of(s, patches, 1 - substep % 2, w)
        tile = wp.tile_empty(shape=(wp.static(3 * capacity),), dtype=wp.vec4, storage="shared")
        x = x_address(tile)
        d = d_address(tile)
        low = low_address(tile)
        # What the stages look up by particle they find by place: order 2 needs more than fits the shared memory.
        here = s
        if wp.static(features.order == 2):
            body.particles = q * wp.static(capacity)
            here.velocities = patches.here
            here.last_velocities = patches.last_here
            here.last_displacements = patches.moved_here
        for i in range(t, wp.static(capacity), wp.static(block)):
            member = patches.members[n * wp.static(capacity) + i]
            if member != wp.static(_NOBODY):
                g = wp.where(member < 0, -2 - member, member)
                moving = Moving()
                moving.velocity = xyz(load4(before.velocities, g))
                moving.low = xyz(load4(before.low, g))
                store4(x, i, load4(before.positions, g))
                store4(low, i, pack(moving.low, 0.0))
                if wp.static(features.order == 2):
                    place = body.particles + i
                    here.velocities[place] = pack(moving.velocity, 0.0)
                    if substep % 2 == 0:
                        here.last_velocities[place] = s.last_velocities[g]
                        here.last_displacements[place] = s.last_displacements[g]
                    else:
                        second = w * s.positions.shape[0] + g
                        here.last_velocities[place] = patches.last_velocities[second]
                        here.last_displacements[place] = patches.last_displacements[second]
                predict(i, moving, m, here, body, material, frame, step, x, low, d)
        records = native.record_address(m.cells, body.cells)
        if wp.static(bool(features.shapes)):
            for c in range(t, colliders.shape[0], wp.static(block)):
                count = float(frame.substeps)
                patches.sweeps[q * colliders.shape[0] + c] = sweep_collider(
                    colliders[c], float(substep) / count, float(substep + 1) / count
                )
        sync()
        project(t, wp.static(block), m, here, body, material, step, records, x, low, d)
        for i in range(t, wp.static(capacity), wp.static(block)):
            g = patches.members[n * wp.static(capacity) + i]
            if g >= 0:
                place = body.particles + i
                if wp.static(bool(features.shapes)):
                    contact(
                        i,
                        q * colliders.shape[0],
                        place,
                        material,
                        colliders,
                        patches.sweeps,
                        s.contacts,
                        here.velocities,
                        here.last_displacements,
                        step,
                        x,
                        low,
                        d,
                    )
                velocity = wp.vec3(0.0)
                if load4(x, i)[3] != 0.0:
                    moving = finish(i, substep, False, here, body, step, x, low, d)
                    velocity = moving.velocity
                    if moving.rough > 0:
                        patches.rough[rough + substep % 2] = substep + 1
                store4(after.positions, g, load4(x, i))
                store4(after.low, g, load4(low, i))
                store4(after.velocities, g, pack(velocity, 0.0))
                if wp.static(features.order == 2):
                    if substep % 2 == 0:
                        second = w * s.positions.shape[0] + g
                        patches.last_velocities[second] = here.last_velocities[place]
                        patches.last_displacements[second] = here.last_displacements[place]
                    else:
                        s.last_velocities[g] = here.last_velocities[place]
                        s.last_displacements[g] = here.last_displacements[place]

    @wp.kernel(**options)
    def hand_over(given: argument, patches: Patches, substeps: int):
        i = wp.tid()
        if wp.static(features.worlds):
            s = given[i / given[0].state.history.shape[0]].state
        else:
            s = given.state
        b = i % s.history.shape[0]
        s.history[b] = wp.where(patches.rough[2 * i + (substeps - 1) % 2] == substeps, 0, 1)

    return advance, hand_over
