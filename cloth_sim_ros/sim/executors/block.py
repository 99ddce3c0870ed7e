# SPDX-License-Identifier: Apache-2.0
"""One launch a frame: a block (on the CPU, one thread) keeps a body of a world and runs all its substeps.

On a GPU positions and displacements stay in the block's shared memory for the whole frame. This limits a body to
`capacity(device)` particles; on the CPU there is no limit. Blocks of different bodies never wait for one
another. A large body may have several blocks, which wait for one another and use plain arrays.
"""

from functools import lru_cache

import warp as wp

from cloth_sim_ros.sim.arrays.context import Context
from cloth_sim_ros.sim.arrays.model import Features
from cloth_sim_ros.sim.arrays.state import Arrays, gathered, given_type, rests
from cloth_sim_ros.sim.executors.shared_history import copy_history, scratch_at, with_history_at
from cloth_sim_ros.sim.features.stage import in_sequence, wait_in_block, wait_in_group
from cloth_sim_ros.sim.kernels.compiled import compiled
from cloth_sim_ros.sim.kernels.cooperative import CooperativeGroup, cooperative_groups_of, number_of
from cloth_sim_ros.sim.kernels.intrinsics import (
    BYTES_A_PARTICLE,
    beside,
    flush_denormals,
    load_row,
    make_tile_address,
    restore_mode,
    store4,
    sync,
)
from cloth_sim_ros.sim.program import Program, make_begin, make_enter, make_program
from cloth_sim_ros.sim.ropes.arrays import NUMBERS

_ROPE = 256  # largest number of threads of a rope, of which two eliminate
_LEAST, _MOST = 64, 512  # threads of each of several blocks of a body; contact needs too many registers for more
RESERVED = 2048  # bytes of a block's shared memory that Warp and the driver keep


def capacity(device: wp.Device) -> int:
    """Return the largest number of particles of a body that one block can hold."""
    if device.is_cpu:
        return 1 << 30
    return shared_memory(device) // BYTES_A_PARTICLE


def shared_memory(device: wp.Device) -> int:
    """Return the bytes of shared memory that a block has to itself."""
    return 0 if device.is_cpu else device.max_shared_memory_per_block - RESERVED


class Block:
    """The launch of one batch. `advance()` simulates one frame of every body in all its worlds.

    largest: number of particles of the largest body. blocks, block: number of blocks a body, and of threads a block.
    """

    def __init__(
        self, features: Features, worlds: list[Arrays], device: wp.Device, largest: int, blocks: int, block: int
    ):
        bodies = len(worlds) * worlds[0].model.bodies.shape[0]
        inputs, threads = [gathered(worlds, device)], bodies * block
        if blocks == 1:
            fits = not device.is_cpu and largest <= capacity(device)
            kernel = make_frame(features, _room_for(features, largest) if fits else 0, block, shared_memory(device))
        else:
            kernel, group = (make_spread_frame(features, block), cooperative_groups_of(bodies, blocks, block, device))
            inputs, threads = [*inputs, bodies, group], group.teams * group.width
        self._launch = wp.launch(kernel, dim=threads, inputs=inputs, device=device, block_dim=block, record_cmd=True)

    def advance(self) -> None:
        """Launch one frame; the kernel reads the numbers of substeps and iterations on the device."""
        self._launch.launch()


def threads_for(features: Features, largest: int, device: wp.Device) -> int:
    """Return the number of threads of a block for a body of `largest` particles.

    A thread takes a segment of a rope, a particle of an explicit method, or its slots of a row of lines.
    """
    if device.is_cpu:
        return 1
    work, most = largest, 1024
    if features.chain:
        work, most = largest - 1, _ROPE
    elif features.method == "xpbd":
        work = max(128, largest // features.line_slots)
    return min(most, -(-work // 32) * 32)


def _room_for(features: Features, largest: int) -> int:
    """Number of particles in shared memory for a body of `largest`; few numbers, as each is a kernel of its own."""
    return -(-(largest - 1) // 64) * 64 + 1 if features.chain else -(-largest // 64) * 64


def blocks_for(largest: int, bodies: int, device: wp.Device) -> tuple[int, int]:
    """Return the number of blocks that share a body of `largest` particles, and of threads in each.

    bodies: number of bodies that run at a time. Many small blocks wait no longer for one another than a few large ones,
    and each has a multiprocessor to itself.
    """
    blocks = max(2, min(device.sm_count // bodies, -(-largest // _LEAST)))
    return blocks, max(_LEAST, min(_MOST, -(-largest // blocks // 32) * 32))


@lru_cache
def make_frame(features: Features, shared: int, block: int, most_shared: int = 0):
    """Return the kernel of a whole frame for `features`.

    shared: number of particles in shared memory, 0 for plain arrays. block: threads of a block; the compiler knows it,
    so that their registers fit the multiprocessor. most_shared: bytes of shared memory.
    """
    program = make_program(features, block == 1, block)
    load, unload = _make_memory(features, shared, block, most_shared)
    home_of = make_home(features)
    called = block == 1 and bool(features.shapes)
    simulate, end = _make_substeps(features, program, called), in_sequence(program.ending, "ending", called)
    argument = given_type(features)

    @compiled(module="unique", launch_bounds=block)
    def simulate_frame(given: argument):
        # Use a one-dimensional launch: for two dimensions Warp would divide 64-bit integers.
        b = wp.tid() / wp.static(block)
        t = wp.tid() - b * wp.static(block)
        home = home_of(given, b, CooperativeGroup())
        if wp.static(features.redoes):
            if home.state.trial.rejected[home.body.index] == 0:
                return
        if wp.static(features.measured):
            if rests(home.state.control, home.frame, home.body.index):
                return
        mode = flush_denormals()
        ctx = load(t, home)
        sync()
        simulate(t, wp.block_dim(), ctx)
        end(t, wp.block_dim(), ctx)
        unload(t, ctx, home)
        restore_mode(mode)

    return simulate_frame


@lru_cache
def make_spread_frame(features: Features, block: int):
    """Return the kernel of a frame in which several blocks of `block` threads share a body, in plain arrays.

    A barrier of blocks takes as long as ten barriers of a block, but each block has a whole multiprocessor.
    """
    program, home_of = make_program(features, False), make_home(features)
    simulate = _make_substeps(features, program, False, wait_in_group)
    end = in_sequence(program.ending, "ending", False, wait_in_group)
    argument = given_type(features)

    @compiled(module="unique", launch_bounds=block)
    def simulate_frame(given: argument, bodies: int, group: CooperativeGroup):
        t = number_of(wp.tid(), group)
        for b in range(wp.tid() / group.width, bodies, group.teams):
            ctx = home_of(given, b, group)
            if wp.static(features.redoes):
                if ctx.state.trial.rejected[ctx.body.index] == 0:
                    continue
            if wp.static(features.measured):
                if rests(ctx.state.control, ctx.frame, ctx.body.index):
                    continue
            simulate(t, group.width, ctx)
            end(t, group.width, ctx)

    return simulate_frame


def make_home(features: Features):
    """Return a Warp function: the Context of body b of all worlds in device arrays, for a cooperative group."""
    begin, argument = make_begin(features), given_type(features)

    @wp.func
    def home_of(given: argument, b: int, group: CooperativeGroup) -> Context:
        ctx = Context()
        if wp.static(features.worlds):
            bodies = given[0].model.bodies.shape[0]
            w = b // bodies
            ctx = begin(given[w], b - w * bodies)
        else:
            ctx = begin(given, b)
        ctx.cooperative_group = group
        return ctx

    return home_of


def _make_substeps(features: Features, program: Program, called: bool, wait=wait_in_block):
    """Return a Warp function in which the threads of a body run all substeps of a frame; wait(ctx) is their barrier."""
    enter, before = make_enter(features), in_sequence(program.before, "before", called, wait)
    iterated = in_sequence([*program.solved, *program.touched], "iterated", called, wait)
    after = in_sequence([*program.kept, *program.after], "after", called, wait)

    @wp.func
    def simulate(t: int, width: int, loaded: Context):
        frame = loaded.frame
        ctx = loaded
        for substep in range(frame.substeps):
            ctx = enter(ctx, substep)
            before(t, width, ctx)
            ctx.step.repeats = frame.iterations > 1
            ctx.step.store = frame.iterations > 1 or substep == frame.substeps - 1
            for iteration in range(frame.iterations):
                ctx.step.first = iteration == 0
                ctx.last = iteration + 1 == frame.iterations
                if wp.static(iterated is not None):
                    iterated(t, width, ctx)
            if wp.static(after is not None):
                after(t, width, ctx)

    return simulate


def _make_memory(features: Features, shared: int, block: int, most_shared: int):
    """Return two Warp functions: load a body into shared memory as far as it fits, and store it back."""
    # Data that every particle reads and writes once a substep lies in shared memory too, if there is room.
    keeps_low = features.lines or features.chain
    all_shared = keeps_low and shared > 0 and 16 * 3 * shared <= most_shared
    tile_size = (3 if all_shared else 2) * shared
    tile_address = make_tile_address(tile_size) if shared else None
    # Velocities and the history of order 2 are 10 floats a particle; a rope would fetch them from afar every substep.
    # It would do so with each number of its solve, too.
    history = -(-5 * shared // 2) if all_shared and features.chain and features.order == 2 else 0
    history = history if 16 * (tile_size + history) <= most_shared else 0
    history_address = make_tile_address(history) if history else None
    scratch = -(-NUMBERS * (shared + 3) // 2) if all_shared and features.chain else 0
    scratch = scratch if 16 * (tile_size + history + scratch) <= most_shared else 0
    scratch_address = make_tile_address(scratch) if scratch else None

    @wp.func
    def load(t: int, home: Context) -> Context:
        ctx = home
        if wp.static(shared > 0):
            # Beside x lies the array that neighbours read: displacements or low parts.
            ctx.x = tile_address(wp.tile_empty(shape=(wp.static(tile_size),), dtype=wp.vec4, storage="shared"))
            if wp.static(features.method == "verlet"):
                ctx.position_lo = beside(ctx.x, wp.static(shared))
            else:
                ctx.d = beside(ctx.x, wp.static(shared))
            if wp.static(all_shared):
                ctx.position_lo = beside(ctx.x, wp.static(2 * shared))
            for i in range(t, ctx.body.count, wp.static(block)):
                # Load both before storing one; the compiler cannot know that this is safe.
                position = load_row(ctx.state.positions, ctx.body.particles + i)
                lost = load_row(ctx.state.position_lo, ctx.body.particles + i)
                store4(ctx.x, i, position)
                if wp.static(all_shared or features.method == "verlet"):
                    store4(ctx.position_lo, i, lost)
        if wp.static(history > 0):
            begin = history_address(wp.tile_empty(shape=(wp.static(history),), dtype=wp.vec4, storage="shared"))
            ctx.state = with_history_at(begin, wp.static(shared), ctx.body, home.state)
            for i in range(t, ctx.body.count, wp.static(block)):
                copy_history(ctx.body.particles + i, home.state, ctx.state)
        if wp.static(scratch > 0):
            place = scratch_address(wp.tile_empty(shape=(wp.static(scratch),), dtype=wp.vec4, storage="shared"))
            ctx.state.rope.scratch = scratch_at(place, ctx.body)
        return ctx

    @wp.func
    def unload(t: int, ctx: Context, home: Context):
        if wp.static(history > 0):
            for i in range(t, ctx.body.count, wp.static(block)):
                copy_history(ctx.body.particles + i, ctx.state, home.state)

    return load, unload
