# SPDX-License-Identifier: Apache-2.0
"""One launch a stage, for bodies too large for a block; on a GPU a frame is captured in one CUDA graph.

The same program as the block executor, on plain device arrays: both give the same state but for the rounding of the
compiler's choices.
"""

from dataclasses import dataclass
from functools import lru_cache

import warp as wp

from cloth_sim_ros.sim.intrinsics import OPTIONS
from cloth_sim_ros.sim.methods.program import Program, Stage, make_begin, make_enter, make_program
from cloth_sim_ros.sim.model import Body, Features
from cloth_sim_ros.sim.pair_search import PairSearch, searches_of
from cloth_sim_ros.sim.state import Arrays, gathered, given_type

GRAPHS = 4  # frames kept at a time, for as many triples of substeps, iterations and outer steps


class Graph:
    """The launches of one batch. `advance()` simulates one frame of every body in every world of it."""

    def __init__(
        self, features: Features, worlds: list[Arrays], device: wp.Device, search: PairSearch | None = None
    ) -> None:
        """search: of the pairs of objects that are kept apart from themselves."""
        self._search = search
        self._features, self._device = features, device
        self._program, self._kernels = make_kernels(features, device.is_cpu)
        self._worlds, self._given = len(worlds), gathered(worlds, device)
        arrays = worlds[0]
        self._colliders = arrays.colliders.shape[0]
        self._bodies = [dict(zip(Body.vars, body, strict=True)) for body in arrays.model.bodies.numpy().tolist()]
        self._groups = arrays.model.groups.numpy().tolist()
        self._recorded: dict[tuple, wp.Launch] = {}
        self._frame: list[wp.Launch | Search] = []
        self._frames: dict[tuple[int, int, int], list[wp.Launch] | wp.Graph] = {}

    def advance(self, substeps: int, iterations: int, outer: int) -> None:
        """Launch one frame; new numbers are recorded, on a GPU in a graph; a few are kept."""
        settings = (substeps, iterations, outer)
        if settings not in self._frames:
            if len(self._frames) == GRAPHS:
                self._frames.pop(next(iter(self._frames)))
            self._frames[settings] = self._record(*settings)
        frame = self._frames[settings]
        if isinstance(frame, wp.Graph):
            wp.capture_launch(frame)
            return
        for launch in frame:
            launch.launch()

    def prepare(self, substeps: int, iterations: int) -> None:
        """Make the launches of such a frame, outside of a capture."""
        self._frame = []
        self._launch_frame(substeps, iterations, 1)
        for kernel in self._kernels.values():
            kernel.module.load(self._device)

    def launches(self, substeps: int, iterations: int) -> list[wp.Launch]:
        """The launches of a frame, which `prepare` has made."""
        return self._frame

    def _record(self, substeps: int, iterations: int, outer: int) -> list[wp.Launch] | wp.Graph:
        self._frame = []
        self._launch_frame(substeps, iterations, outer)
        if not self._device.is_cuda:
            return self._frame
        with wp.ScopedCapture(device=self._device) as capture:
            for launch in self._frame:
                launch.launch()
        return capture.graph

    def _launch_frame(self, substeps: int, iterations: int, outer: int) -> None:
        outer_ends = {j * substeps // outer for j in range(outer + 1)}
        bodies, ahead = (
            list(enumerate(self._bodies)),
            -(-substeps // searches_of(min(body["spacing"] for body in self._bodies))),
        )
        for substep in range(substeps):
            if self._search is not None and substep % ahead == 0:
                self._frame.append(Search(self._search, min(ahead, substeps - substep)))
            for b, body in bodies:
                self._launch_substep(b, body, substep, (substeps, iterations), substep in outer_ends)
        for b, body in bodies:
            for stage in (*self._program.outer, *self._program.ending):
                self._launch(stage, b, body, substeps)

    def _launch_substep(self, b: int, body: dict, substep: int, most: tuple[int, int], begins_outer: bool) -> None:
        substeps, iterations = most
        # What looks at no substep is one launch, packed once.
        at = substep if self._features.looks_back or self._colliders else 0
        for stage in self._program.outer if begins_outer else ():
            self._launch(stage, b, body, substep)
        for stage in self._program.before:
            if substep % stage.every == 0:
                self._launch(stage, b, body, substep if stage.every > 1 else at)
        for iteration in range(iterations):
            store, last = iterations > 1 or substep == substeps - 1, iteration + 1 == iterations
            mode = (min(iteration, 1), int(store), int(last))
            for stage in self._program.iterated:
                self._launch(stage, b, body, at, *mode)
        for stage in self._program.after:
            self._launch(stage, b, body, at, min(iterations - 1, 1))

    def _launch(
        self, stage: Stage, b: int, body: dict, substep: int, iteration: int = 0, store: int = 0, last: int = 1
    ) -> None:
        """Append the launches of a stage to the frame; those that are alike are one."""
        groups = range(body["groups"], body["groups_end"]) if stage.rounds else (0,)
        for g in groups:
            size = self._groups[g][2] - self._groups[g][1] if stage.rounds else body
            numbers = (stage.threads(size, self._colliders), b, substep, iteration, store, last, g)
            key = (stage.name, *numbers)
            if key not in self._recorded:
                inputs, dim = [self._given, *numbers], self._worlds * numbers[0]
                self._recorded[key] = wp.launch(
                    self._kernels[stage.name], dim=dim, inputs=inputs, device=self._device, record_cmd=True
                )
            self._frame.append(self._recorded[key])


@dataclass(frozen=True)
class Search:
    """A launch like others: it looks for the pairs of `ahead` substeps to come."""

    pairs: PairSearch
    ahead: int

    def launch(self) -> None:
        """Look for them."""
        self.pairs.find(self.ahead)


@lru_cache
def make_kernels(features: Features, on_cpu: bool) -> tuple[Program, dict[str, wp.Kernel]]:
    """The program for `features` and the kernel of each of its stages, in one module of their own."""
    program = make_program(features, on_cpu)
    module = wp.get_module(f"cloth_sim_ros.graph.{features.key()}.{'cpu' if on_cpu else 'cuda'}")
    wp.set_module_options(OPTIONS, module)
    begin, enter = make_begin(features), make_enter(features)
    stages = (*program.outer, *program.before, *program.iterated, *program.after, *program.ending)
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
    return wp.kernel(launched, enable_backward=False, module=module)
