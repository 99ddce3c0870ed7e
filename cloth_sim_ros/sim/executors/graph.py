# SPDX-License-Identifier: Apache-2.0
"""One launch a stage, for bodies that touch one another or are too large for a block.

The same program as the block executor, on plain device arrays: both give the same state but for the rounding of the
compiler's choices.
"""

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Protocol

import warp as wp

from cloth_sim_ros.sim.compiled import compiled
from cloth_sim_ros.sim.meeting.apart import Apart
from cloth_sim_ros.sim.meeting.bound import Bound
from cloth_sim_ros.sim.meeting.flat import Flat
from cloth_sim_ros.sim.meeting.search import Search
from cloth_sim_ros.sim.methods.program import Program, make_begin, make_enter, make_program
from cloth_sim_ros.sim.methods.stage import Stage
from cloth_sim_ros.sim.model import Body, Features
from cloth_sim_ros.sim.state import Arrays, gathered, given_type

_KEPT = 4  # frames kept at a time, for as many triples of substeps, iterations and outer steps


class Launch(Protocol):
    """What a frame is made of."""

    def launch(self) -> None: ...


class Member:
    """The stages of a batch as launches, recorded once."""

    def __init__(self, features: Features, worlds: list[Arrays], device: wp.Device) -> None:
        self.features, self._device = features, device
        self.program, self._kernels = make_kernels(features, device.is_cpu)
        self._worlds, self._given = len(worlds), gathered(worlds, device)
        self._colliders = worlds[0].colliders.shape[0]
        bodies = worlds[0].model.bodies.numpy().tolist()
        self._bodies = [dict(zip(Body.vars, body, strict=True)) for body in bodies]
        self._groups = worlds[0].model.groups.numpy().tolist()
        self._recorded: dict[tuple, wp.Launch] = {}
        for kernel in self._kernels.values():  # as none may have to be loaded while a frame is captured
            kernel.module.load(device)

    def begin(self, substep: int, begins_outer: bool) -> list[Launch]:
        """What begins a substep."""
        found = self.run(self.program.outer, substep) if begins_outer else []
        for stage in self.program.before:
            if substep % stage.every == 0:
                found += self.run([stage], substep if stage.every > 1 else self._at(substep))
        return found

    def iterate(self, stages: Sequence[Stage], substep: int, iteration: int, most: tuple[int, int]) -> list[Launch]:
        """Stages of an iteration; most: substeps and iterations."""
        substeps, iterations = most
        store, last = iterations > 1 or substep == substeps - 1, iteration + 1 == iterations
        return self.run(stages, self._at(substep), min(iteration, 1), int(store), int(last))

    def finish(self, stages: Sequence[Stage], substep: int, iterations: int) -> list[Launch]:
        """Stages behind the iterations."""
        return self.run(stages, self._at(substep), min(iterations - 1, 1))

    def end(self, substeps: int) -> list[Launch]:
        """What ends a frame."""
        return self.run((*self.program.outer, *self.program.ending), substeps)

    def _at(self, substep: int) -> int:
        # What looks at no substep is one launch, packed once.
        looks = self.features.looks_back or self.features.lines or self.features.handles or self._colliders
        return substep if looks else 0

    def run(
        self, stages: Sequence[Stage], substep: int, iteration: int = 0, store: int = 0, last: int = 1
    ) -> list[Launch]:
        """The launches of stages, for each body; those that are alike are one."""
        found = []
        for b, body in enumerate(self._bodies):
            for stage in stages:
                for g in range(body["groups"], body["groups_end"]) if stage.rounds else (0,):
                    size = self._groups[g][2] - self._groups[g][1] if stage.rounds else body
                    numbers = (stage.threads(size, self._colliders), b, substep, iteration, store, last, g)
                    found.append(self._record(stage.name, numbers))
        return found

    def _record(self, name: str, numbers: tuple) -> wp.Launch:
        key = (name, *numbers)
        if key not in self._recorded:
            inputs, dim = [self._given, *numbers], self._worlds * numbers[0]
            self._recorded[key] = wp.launch(
                self._kernels[name], dim=dim, inputs=inputs, device=self._device, record_cmd=True
            )
        return self._recorded[key]


class Graph:
    """The launches of batches that advance together. `advance()` simulates a frame of every body in every world.

    meeting: what tells whether parts of bodies may touch at all, what finds them, what keeps them apart, and what lets
    none through.
    """

    def __init__(self, members: Sequence[Member], meeting: tuple[Flat, Search, Apart, Bound] | None = None) -> None:
        self._members, self._meeting = members, meeting
        self._frames: dict[tuple[int, int, int], list[Launch]] = {}

    def advance(self, substeps: int, iterations: int, outer: int) -> None:
        """Launch one frame; what new numbers launch is recorded, and a few are kept."""
        settings = (substeps, iterations, outer)
        if settings not in self._frames:
            if len(self._frames) == _KEPT:
                self._frames.pop(next(iter(self._frames)))
            self._frames[settings] = self._launches(*settings)
        _run(self._frames[settings])

    def _launches(self, substeps: int, iterations: int, outer: int) -> list[Launch]:
        frame, members = [], self._members
        if self._meeting is not None:
            flat, search, apart, bound = self._meeting
            frame += [Call(bound.begin), Call(flat.begin), Call(partial(search.look, ends=False))]
        outer_ends = {j * substeps // outer for j in range(outer + 1)}
        for substep in range(substeps):
            for member in members:
                frame += member.begin(substep, substep in outer_ends)
            for iteration in range(iterations):
                now = (substep, iteration, (substeps, iterations))
                for member in members:
                    frame += member.iterate(member.program.solved, *now)
                if self._meeting is not None:
                    frame.append(apart)
                for member in members:
                    frame += member.iterate(member.program.touched, *now)
            for member in members:
                frame += member.finish(member.program.kept, substep, iterations)
            if self._meeting is not None:
                frame += [Call(partial(search.look, ends=True)), bound]
            for member in members:
                frame += member.finish(member.program.after, substep, iterations)
        for member in members:
            frame += member.end(substeps)
        return frame


def _run(launches: Sequence[Launch]) -> None:
    for each in launches:
        each.launch()


@dataclass(frozen=True)
class Call:
    """A launch like others, of several kernels."""

    launch: Callable[[], None]


@lru_cache
def make_kernels(features: Features, on_cpu: bool) -> tuple[Program, dict[str, wp.Kernel]]:
    """The program for `features` and the kernel of each of its stages, in one module of their own."""
    program = make_program(features, on_cpu)
    module = wp.get_module(f"cloth_sim_ros.graph.{features.key()}.{'cpu' if on_cpu else 'cuda'}")
    begin, enter = make_begin(features), make_enter(features)
    each = (program.outer, program.before, program.solved, program.touched)
    stages = itertools.chain(*each, program.kept, program.after, program.ending)
    return program, {stage.name: _make_kernel(stage, features, begin, enter, module) for stage in stages}


def _make_kernel(stage: Stage, features: Features, begin, enter, module: wp.Module) -> wp.Kernel:
    """The kernel that runs a stage of body b in the substep and iteration of a launch, with `size` threads a world."""
    run, argument = stage.run, given_type(features)

    def launched(given: argument, size: int, b: int, substep: int, iteration: int, store: int, last: int, g: int):
        t = wp.tid()
        if wp.static(features.worlds):
            w = t // size
            t -= w * size
            home = begin(given[w], b)
        else:
            home = begin(given, b)
        if wp.static(features.redoes):
            if home.state.rejected[b] == 0:
                return
        here = enter(home, substep)
        here.step.first = iteration == 0
        here.step.store = store != 0
        here.last = last != 0
        here.step.repeats = here.frame.iterations > 1
        here.group = g
        run(t, size, here)

    launched.__qualname__ = f"launch_{stage.name}"
    return compiled(launched, module=module)
