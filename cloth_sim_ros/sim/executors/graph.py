# SPDX-License-Identifier: Apache-2.0
"""Bodies that touch one another advance together: a launch for each part of the program, and contact between parts.

The program is that of the block executor, on plain device arrays. Both give the same state up to rounding differences
of the compiled code.
"""

from collections.abc import Callable, Sequence
from functools import lru_cache, partial
from typing import NamedTuple

import warp as wp

from cloth_sim_ros.sim.arrays.model import Features
from cloth_sim_ros.sim.arrays.state import Arrays, gathered, given_type
from cloth_sim_ros.sim.executors.block import blocks_for, make_home, threads_for
from cloth_sim_ros.sim.features.seams.sew import Sewing
from cloth_sim_ros.sim.features.stage import in_sequence, wait_in_group
from cloth_sim_ros.sim.kernels.compiled import compiled
from cloth_sim_ros.sim.kernels.cooperative import CooperativeGroup, cooperative_groups_of, number_of
from cloth_sim_ros.sim.kernels.device import call_all
from cloth_sim_ros.sim.kernels.intrinsics import flush_denormals, restore_mode
from cloth_sim_ros.sim.program import make_enter, make_program

_KEPT = 8  # number of recorded frames, each for one pair of substeps and iterations
Call = Callable[[], None]  # an element of a frame


class Meeting(NamedTuple):
    """Contact between bodies as calls.

    begin: those before a frame. look: finds parts that may touch, in a substep that ends, or that begins now. solve:
    keeps them apart. clamp: lets none pass through another.
    """

    begin: Sequence[Call]
    look: Callable[..., None]
    solve: Call
    clamp: Call


class Member:
    """The parts of a batch's program as launches, recorded once."""

    def __init__(self, features: Features, worlds: list[Arrays], device: wp.Device) -> None:
        self.device, self.is_rope = device, features.chain
        counts = worlds[0].model.bodies.numpy()["count"]
        bodies = len(worlds) * len(counts)
        if device.is_cpu or features.chain:  # a chain is solved by the threads of one block
            blocks, block = 1, threads_for(features, int(counts.max()), device)
        else:
            blocks, block = blocks_for(int(counts.max()), bodies, device)
        group = cooperative_groups_of(bodies, blocks, block, device)
        self._kernels = make_kernels(features, block)
        self._given = [gathered(worlds, device), bodies, group]
        self._dims = {"dim": group.teams * group.width, "block_dim": block, "device": device}
        self._recorded: dict[tuple, Call] = {}
        for kernel in self._kernels.values():  # none may be loaded while a frame is captured
            kernel.module.load(device, block)

    def run(self, part: str, substep: int, iteration: int = 0, last: int = 1) -> list[Call]:
        """Return what launches a part of the program, for all bodies in all worlds; none for a part without stages."""
        if part not in self._kernels:
            return []
        key = (part, substep, iteration, last)
        if key not in self._recorded:
            inputs = [*self._given, substep, iteration, last]
            self._recorded[key] = wp.launch(self._kernels[part], inputs=inputs, record_cmd=True, **self._dims).launch
        return [self._recorded[key]]


class Graph:
    """The launches of batches that advance together. `advance()` simulates a frame of every body in every world.

    meeting: contact between bodies. sewing: seams between them.
    """

    def __init__(self, members: Sequence[Member], meeting: Meeting | None = None, sewing: Sewing | None = None) -> None:
        self._members, self._meeting, self._sewing = members, meeting, sewing
        self._frames: dict[tuple[int, int], list[Call]] = {}

    def advance(self, substeps: int, iterations: int) -> None:
        """Launch one frame; record it first for new numbers, as a CUDA graph on a GPU, and keep the last few."""
        settings = (substeps, iterations)
        if settings in self._frames:
            call_all(self._frames[settings])
            return
        if len(self._frames) == _KEPT:
            self._frames.pop(next(iter(self._frames)))
        frame, device = self._launches(*settings), self._members[0].device
        call_all(frame)
        if device.is_cuda:  # a capture of a CPU would take what other threads launch meanwhile
            with wp.ScopedCapture(device=device) as capture:
                call_all(frame)
            frame = [partial(wp.capture_launch, capture.graph)]
        self._frames[settings] = frame

    def _launches(self, substeps: int, iterations: int) -> list[Call]:
        frame: list[Call] = []

        def run(part: str, *numbers: int, members: Sequence[Member] = self._members) -> None:
            for member in members:
                frame.extend(member.run(part, *numbers))

        held = [each for each in self._members if each.is_rope and self._sewing is not None and self._sewing.is_held]
        others = [each for each in self._members if each not in held]

        if self._meeting is not None:
            frame += [*self._meeting.begin, partial(self._meeting.look, ends=False)]
        for substep in range(substeps):
            if self._sewing is not None:
                frame.append(self._sewing.agree(substep).launch)
            run("before", substep)
            for iteration in range(iterations):
                now = (substep, min(iteration, 1), int(iteration + 1 == iterations))
                run("solved", *now, members=others)
                if held:
                    frame.append(self._sewing.open(substep, iteration == 0).launch)
                    run("solved", *now, members=held)
                if self._meeting is not None:
                    frame.append(self._meeting.solve)
                if self._sewing is not None:
                    frame.append(self._sewing.sew(substep, iteration == 0, False).launch)
                run("touched", *now)
            run("kept", substep, min(iterations - 1, 1))
            if self._sewing is not None:
                frame.append(self._sewing.sew(substep, False, True).launch)
            if self._meeting is not None:
                frame += [partial(self._meeting.look, ends=True), self._meeting.clamp]
            run("after", substep, min(iterations - 1, 1))
        run("ending", substeps)
        return frame


@lru_cache
def make_kernels(features: Features, block: int) -> dict[str, wp.Kernel]:
    """Return the kernel of each part of the program, in one module.

    block: threads of each block of a body; 1 means a CPU.
    """
    program = make_program(features, block == 1, block if features.chain else 1)
    module = wp.get_module(f"cloth_sim_ros.graph.{features.key()}.{block}")
    called = block == 1 and bool(features.shapes)
    each = {part: in_sequence(stages, part, called, wait_in_group) for part, stages in vars(program).items()}
    return {part: _make_kernel(part, run, features, block, module) for part, run in each.items() if run is not None}


def _make_kernel(part: str, run, features: Features, block: int, module: wp.Module) -> wp.Kernel:
    """Return the kernel that runs a part in the substep and iteration of a launch."""
    home_of, enter, argument = make_home(features), make_enter(features), given_type(features)

    def launched(given: argument, bodies: int, group: CooperativeGroup, substep: int, iteration: int, last: int):
        t = number_of(wp.tid(), group)
        mode = flush_denormals()
        for b in range(wp.tid() / group.width, bodies, group.teams):
            home = home_of(given, b, group)
            if wp.static(features.redoes):
                if home.state.trial.rejected[home.body.index] == 0:
                    continue
            if wp.static(part != "ending"):
                if substep >= home.frame.substeps:  # another body takes more
                    continue
            ctx = enter(home, substep)
            ctx.step.first = iteration == 0
            ctx.last = last != 0
            ctx.step.repeats = ctx.frame.iterations > 1
            ctx.step.store = wp.static(features.sewn) or ctx.step.repeats or substep == ctx.frame.substeps - 1
            run(t, group.width, ctx)
        restore_mode(mode)

    launched.__qualname__ = f"launch_{part}"
    return compiled(launched, module=module, launch_bounds=block)
