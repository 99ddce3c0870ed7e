"""Grids on a whole GPU by xpbd: a body is cut into patches, and a block makes the substeps of its patch.

A block loads its patch with the margin that one sweep reaches into shared memory, predicts, projects all passes,
touches colliders, and hands its own particles to its neighbours: what they need of each other in between is computed
twice instead of waited for. Every particle's arithmetic is the same, in the same order, as in the other schedules.
Where all patches are on the GPU at once, a frame is one launch, in which patches wait for what their neighbours send
(exchange.py); elsewhere a substep is a launch, between two buffers. Frames of several iterations are those of the
coloured schedule. The launches of a frame are captured in one CUDA graph.
"""

import warp as wp

from cloth_sim_ros.sim.model import Features
from cloth_sim_ros.sim.schedules.buffers import Frames
from cloth_sim_ros.sim.schedules.coloured import Coloured
from cloth_sim_ros.sim.schedules.patch_kernels import make_kernels
from cloth_sim_ros.sim.schedules.patches import Plan, staged_records, upload, width_of
from cloth_sim_ros.sim.schedules.resident_kernel import CELL_THREADS
from cloth_sim_ros.sim.state import Arrays, gathered


class Patched:
    """The launches of one batch. `advance()` simulates one frame of every body in every world of it."""

    def __init__(self, features: Features, worlds: list[Arrays], chosen: Plan, device: wp.Device):
        width = width_of(chosen, device)
        self.waits = chosen.waits
        self._device, self._given = device, gathered(worlds, device)
        self._several = Coloured(features, worlds, device)
        self._block = 1 if device.is_cpu else min(CELL_THREADS, chosen.capacity)
        self._patches = upload(chosen, worlds, width, device)
        self._count, self._bodies = len(worlds) * self._patches.body.shape[0], len(worlds) * len(chosen.bodies)
        staged = staged_records(self._patches, chosen.capacity, device)
        self._kernels = make_kernels(features, chosen.capacity, self._block, width, chosen.waits, staged)
        self._looks_back = features.looks_back
        self._frames = Frames(self._launch_frame, device)

    def advance(self, substeps: int, iterations: int) -> None:
        """Launch one frame."""
        if iterations > 1 or substeps < 2:
            self._several.advance(substeps, iterations)
            return
        self._frames.run(substeps)

    def _launch_frame(self, substeps: int) -> None:
        if self.waits:
            self._launch("advance", 0, 0, substeps)
            return
        if self._looks_back:
            self._patches.rough.zero_()
        for substep in range(substeps - 1):
            self._launch("advance", substep % 2, substep, 1)
        self._launch("finish", (substeps - 1) % 2, substeps - 1, 1)
        self._launch("settle", substeps % 2)
        inputs = [self._given, self._patches, substeps]
        wp.launch(self._kernels["count_faults"], dim=self._bodies, inputs=inputs, device=self._device)

    def _launch(self, name: str, *numbers: int) -> None:
        wp.launch(
            self._kernels[name],
            dim=self._count * self._block,
            inputs=[self._given, self._patches, *numbers],
            device=self._device,
            block_dim=self._block,
        )
