"""One launch a stage and a colour, for bodies too large for a block; on a GPU a frame is captured in one CUDA graph.

The same stages as the resident schedule, on plain device arrays, in the same order: both give the same state but for
the rounding of the compiler's choices.
"""

import warp as wp

from cloth_sim_ros.sim.lines.layout import WARP
from cloth_sim_ros.sim.model import Body, Features
from cloth_sim_ros.sim.schedules.coloured_kernels import make_kernels
from cloth_sim_ros.sim.schedules.stages import SWEPT
from cloth_sim_ros.sim.state import Arrays, gathered

GRAPHS = 4  # frames kept at a time, for as many pairs of substeps and iterations


class Coloured:
    """The launches of one batch. `advance()` simulates one frame of every body in every world of it."""

    def __init__(self, features: Features, worlds: list[Arrays], device: wp.Device):
        self._features, self._device = features, device
        self._kernels = make_kernels(features, 1 if device.is_cpu else WARP)
        self._threads_a_row = 1 if device.is_cpu else WARP
        self._worlds, self._given = len(worlds), gathered(worlds, device)
        arrays = worlds[0]
        self._colliders = arrays.colliders.shape[0]
        self._bodies = [dict(zip(Body.vars, body, strict=True)) for body in arrays.model.bodies.numpy().tolist()]
        self._groups = arrays.model.groups.numpy().tolist()
        self._recorded: dict[tuple, wp.Launch] = {}
        self._frame: list[wp.Launch] = []
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

    def _launch(
        self, stage: str, size: int, b: int = 0, substep: int = 0, iteration: int = 0, store: int = 0, g: int = 0
    ) -> None:
        """Append a launch to the frame; those that are alike are one, packed once."""
        numbers = (size, b, substep, iteration, store, g)
        key = (stage, *numbers)
        if key not in self._recorded:
            inputs, dim = [self._given, *numbers], self._worlds * size
            kernel, device = self._kernels[stage], self._device
            self._recorded[key] = wp.launch(kernel, dim=dim, inputs=inputs, device=device, record_cmd=True)
        self._frame.append(self._recorded[key])

    def _launch_frame(self, substeps: int, iterations: int, outer: int) -> None:
        outer_ends = {j * substeps // outer for j in range(outer + 1)}
        for substep in range(substeps):
            for b, body in enumerate(self._bodies):
                if self._features.has_outer and substep in outer_ends:
                    self._launch_kick(b, body, substep)
                self._launch_substep(b, body, substep, substeps, iterations)
        for b, body in enumerate(self._bodies):
            if self._features.has_outer:
                self._launch_kick(b, body, substeps)
            self._launch("find_faults", body["count"], b)
            self._launch("settle", body["count"], b)
        self._launch("count_faults", len(self._bodies))

    def _launch_kick(self, b: int, body: dict, substep: int) -> None:
        """Slow forces at the end of an outer step."""
        if self._features.panels:
            self._launch_panels(b, body, substep)
        if self._features.curved:
            self._launch("curve", body["curves_end"] - body["curves"], b, substep)
        self._launch("kick", body["count"], b, substep)
        self._launch("take_kick", body["count"], b, substep)

    def _launch_panels(self, b: int, body: dict, substep: int) -> None:
        threads = 1 if self._device.is_cpu else -(-(body["panels_end"] - body["panels"]) // 2)
        self._launch("panels", threads, b, substep, g=threads)

    def _launch_substep(self, b: int, body: dict, substep: int, substeps: int, iterations: int) -> None:
        has, implicit = self._features, self._features.method == "xpbd"
        turn = substep if has.looks_back or self._colliders else 0  # what does not ask is one launch, packed once
        if self._colliders and substep % SWEPT == 0:
            self._launch("sweep", self._colliders * min(SWEPT, substeps - substep), b, substep)
        if has.winch:
            self._launch("reel", 1, b)
        if has.panels and implicit:
            self._launch_panels(b, body, turn)
        self._launch("predict", body["count"], b, turn)
        if has.curved and implicit:
            self._launch("curve", body["curves_end"] - body["curves"], b, turn)
        if has.plate and implicit:
            self._launch("bend", body["count"], b, turn)
        for iteration in range(iterations):
            store = int(iterations > 1 or substep == substeps - 1)
            first, last = min(iteration, 1), iteration + 1 == iterations
            self._launch_iteration(b, body, turn, first, store)
            if self._colliders and not last:
                self._launch("contact", body["count"], b, turn, iteration=first)
        self._launch("finish", body["count"], b, substep, iteration=min(iterations - 1, 1))

    def _launch_iteration(self, b: int, body: dict, substep: int, iteration: int, store: int) -> None:
        """The constraints of one iteration; of those after the first, `iteration` is 1."""
        if self._features.chain:
            self._launch("chain", 1, b, substep, iteration, store)
        lines = range(body["groups"], body["groups_end"]) if "line" in self._features.constraints else ()
        for g in lines:
            size = self._threads_a_row * (self._groups[g][3] - self._groups[g][2])
            self._launch("lines", size, b, substep, iteration, store, g)
        if "edge" in self._features.constraints:
            for g in range(body["groups_end"], body["edge_groups_end"]):
                self._launch("edges", self._groups[g][3] - self._groups[g][2], b, substep, iteration, g=g)
