# SPDX-License-Identifier: Apache-2.0
"""Frames of all objects, one after another; a GPU runs equal frames as one CUDA graph."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence

import warp as wp

from cloth_sim_ros.sim.engine.batch import Batch
from cloth_sim_ros.sim.engine.in_step import InStep
from cloth_sim_ros.sim.executors.block import Block
from cloth_sim_ros.sim.substeps.control import is_measured

LONGEST = 10  # largest number of frames in a graph
_KEPT = 8  # largest number of graphs kept


class Frames:
    """Frames of batches, of which `groups` advance in step; the errors of some frames are measured.

    frame_dt: length of a frame [s].

    captures: True if frames run as CUDA graphs.
    """

    def __init__(self, batches: Sequence[Batch], groups: Sequence[InStep], frame_dt: float, device: wp.Device) -> None:
        together = [id(batch) for group in groups for batch in group.batches]
        self._alone, self.groups = [batch for batch in batches if id(batch) not in together], groups
        self._frame_dt, self._device = frame_dt, device
        self._graphs: dict[tuple[Hashable, ...], wp.Graph] = {}
        # The graph executor launches graphs of its own, which no other can hold.
        self.captures = device.is_cuda and not groups and all(isinstance(b.executor, Block) for b in self._alone)

    def advance(
        self, first: int, frames: int, ending: Callable[[], None] | None = None, measured: bool = False
    ) -> None:
        """Simulate at most LONGEST frames without work on the host between; the errors of some are measured.

        first: number of frames before. ending: launched after each frame. measured: True to measure each.

        Before they are captured, frames run launch
        by launch once, which loads their kernels.
        """
        numbers = range(first, first + frames)
        each = tuple(measured or is_measured(number, self._frame_dt) for number in numbers)
        if self.groups:
            rarely = [measured or is_measured(number, self._frame_dt, in_step=True) for number in numbers]
            self._launch(each, ending, rarely)
            return
        if not self.captures:
            self._launch(each, ending)
            return
        key = (each, ending)
        if key in self._graphs:
            wp.capture_launch(self._graphs[key])
            return
        self._launch(each, ending)
        with wp.ScopedCapture(device=self._device) as capture:
            self._launch(each, ending)
        if len(self._graphs) == _KEPT:
            self._graphs.pop(next(iter(self._graphs)))
        self._graphs[key] = capture.graph

    def _launch(
        self, measured: Sequence[bool], ending: Callable[[], None] | None, in_step: Sequence[bool] = ()
    ) -> None:
        for k, measures in enumerate(measured):
            for batch in self._alone:
                batch.advance(measures)
            for group in self.groups:
                group.advance(in_step[k])
            if ending is not None:
                ending()
