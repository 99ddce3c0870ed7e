"""One launch a stage and a colour, for bodies too large for a block; on a GPU a frame is captured in one CUDA graph.

The same stages as the resident schedule, on plain device arrays, in the same order: both give the same state but for
the rounding of the compiler's choices.
"""

import warp as wp

from cloth_sim_ros.sim.lines.layout import WARP
from cloth_sim_ros.sim.model import Body, Features
from cloth_sim_ros.sim.schedules.coloured_kernels import make_kernels
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
                if self._colliders:
                    self._launch("sweep", self._colliders, b, substep)
                if self._features.winch:
                    self._launch("reel", 1, b)
                if self._features.has_outer:
                    if substep in outer_ends:
                        self._launch_kick(b, body, substep)
                elif self._features.panels:
                    self._launch_panels(b, body)
                self._launch("predict", body["count"], b)
                if self._features.method == "xpbd":
                    if self._features.curved:
                        self._launch("curve", body["curves_end"] - body["curves"], b)
                    if self._features.plate:
                        self._launch("bend", body["count"], b)
                for iteration in range(iterations):
                    store = int(iterations > 1 or substep == substeps - 1)
                    self._launch_iteration(b, body, iteration, store)
                self._launch("finish", body["count"], b, substep)
            if self._features.looks_back:
                self._launch("age", len(self._bodies), substep=substep)
        for b, body in enumerate(self._bodies):
            if self._features.has_outer:
                self._launch_kick(b, body, substeps)
            self._launch("find_faults", body["count"], b)
            self._launch("settle", body["count"], b)
        self._launch("count_faults", len(self._bodies))

    def _launch_panels(self, b: int, body: dict) -> None:
        threads = 1 if self._device.is_cpu else -(-(body["panels_end"] - body["panels"]) // 2)
        self._launch("panels", threads, b, g=threads)

    def _launch_kick(self, b: int, body: dict, substep: int) -> None:
        """Slow forces at the end of an outer step."""
        if self._features.panels:
            self._launch_panels(b, body)
        if self._features.curved:
            self._launch("curve", body["curves_end"] - body["curves"], b)
        self._launch("kick", body["count"], b, substep)
        self._launch("take_kick", body["count"], b)

    def _launch_iteration(self, b: int, body: dict, iteration: int, store: int) -> None:
        turn = min(iteration, 1)  # whether it is the first
        if self._features.chain:
            self._launch("chain", 1, b, iteration=turn, store=store)
        if "line" in self._features.constraints:
            for g in range(body["groups"], body["groups_end"]):
                size = self._threads_a_row * (self._groups[g][3] - self._groups[g][2])
                self._launch("lines", size, b, iteration=turn, store=store, g=g)
        if "edge" in self._features.constraints:
            for g in range(body["groups_end"], body["edge_groups_end"]):
                self._launch("edges", self._groups[g][3] - self._groups[g][2], b, iteration=turn, g=g)
        if self._colliders:
            self._launch("contact", body["count"], b, iteration=turn)
