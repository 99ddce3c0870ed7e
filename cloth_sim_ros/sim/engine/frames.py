# SPDX-License-Identifier: Apache-2.0
"""Frames of all objects, one after another; a GPU runs equal frames as one CUDA graph."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence

import warp as wp

from cloth_sim_ros.sim.engine.batch import Batch
from cloth_sim_ros.sim.engine.coupled_bodies import CoupledBodies

LONGEST = 10  # largest number of frames in a graph
_KEPT = 8  # largest number of graphs kept


class Frames:
    """Frames of batches, some of which may be `coupled`. captures: True if frames run as CUDA graphs."""

    def __init__(self, batches: Sequence[Batch], coupled: CoupledBodies | None, device: wp.Device) -> None:
        self._batches, self._together, self._device = batches, coupled, device
        self._graphs: dict[tuple[Hashable, ...], wp.Graph] = {}
        self.captures = device.is_cuda

    def advance(self, finer: int, frames: int = 1, ending: Callable[[], None] | None = None) -> None:
        """Simulate at most LONGEST frames, each in `finer` times the set substeps, without work on the host between.

        ending: launched after each frame. Before they are captured, frames run launch by launch once, which loads
        their kernels.
        """
        if not self.captures:
            self._launch(finer, frames, ending)
            return
        key = (finer, frames, ending, *(batch.frame.written for batch in self._batches))
        if key in self._graphs:
            wp.capture_launch(self._graphs[key])
            return
        self._launch(finer, frames, ending)
        with wp.ScopedCapture(device=self._device) as capture:
            self._launch(finer, frames, ending)
        if len(self._graphs) == _KEPT:
            self._graphs.pop(next(iter(self._graphs)))
        self._graphs[key] = capture.graph

    def _launch(self, finer: int, frames: int, ending: Callable[[], None] | None) -> None:
        for _ in range(frames):
            for batch in self._batches:
                if not batch.features.coupled:
                    batch.advance(finer)
            if self._together is not None:
                self._together.advance(finer)
            if ending is not None:
                ending()
