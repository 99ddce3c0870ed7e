# SPDX-License-Identifier: Apache-2.0
"""Frames of all objects, one after another; a GPU runs equal frames as one CUDA graph."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence

import warp as wp

from cloth_sim_ros.sim.engine.batch import Batch
from cloth_sim_ros.sim.engine.in_step import InStep
from cloth_sim_ros.sim.substeps.control import PERIOD

LONGEST = 10  # largest number of frames in a graph
_KEPT = 8  # largest number of graphs kept


class Frames:
    """Frames of batches, of which `groups` advance in step. captures: True if frames run as CUDA graphs."""

    def __init__(self, batches: Sequence[Batch], groups: Sequence[InStep], device: wp.Device) -> None:
        together = [id(batch) for group in groups for batch in group.batches]
        self._alone, self.groups = [batch for batch in batches if id(batch) not in together], groups
        self._device = device
        self._graphs: dict[tuple[Hashable, ...], wp.Graph] = {}
        self.captures = device.is_cuda and not groups

    def advance(self, first: int, frames: int = 1, ending: Callable[[], None] | None = None) -> None:
        """Simulate at most LONGEST frames without work on the host between; the error of every PERIOD-th is measured.

        first: number of frames before. ending: launched after each frame. Before they are captured, frames run launch
        by launch once, which loads their kernels.
        """
        measured = tuple((first + k) % PERIOD == 0 for k in range(frames))
        if not self.captures:
            self._launch(measured, ending)
            return
        key = (measured, ending)
        if key in self._graphs:
            wp.capture_launch(self._graphs[key])
            return
        self._launch(measured, ending)
        with wp.ScopedCapture(device=self._device) as capture:
            self._launch(measured, ending)
        if len(self._graphs) == _KEPT:
            self._graphs.pop(next(iter(self._graphs)))
        self._graphs[key] = capture.graph

    def _launch(self, measured: Sequence[bool], ending: Callable[[], None] | None) -> None:
        for each in measured:
            for part in (*self._alone, *self.groups):
                part.advance(each)
            if ending is not None:
                ending()
