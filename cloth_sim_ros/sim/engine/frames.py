# SPDX-License-Identifier: Apache-2.0
"""Frames of all objects, one after another; on a GPU those that are alike are one CUDA graph."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence

import warp as wp

from cloth_sim_ros.sim.engine.batch import Batch
from cloth_sim_ros.sim.engine.coupled_bodies import CoupledBodies

LONGEST = 10  # frames in a graph
_KEPT = 8  # graphs at a time


class Frames:
    """The frames of batches, some of which may advance `coupled`. captures: whether they are graphs, as on a GPU."""

    def __init__(self, batches: Sequence[Batch], coupled: CoupledBodies | None, device: wp.Device) -> None:
        self._batches, self._together, self._device = batches, coupled, device
        self._graphs: dict[tuple[Hashable, ...], wp.Graph] = {}
        self.captures = device.is_cuda

    def advance(self, finer: int, frames: int = 1, ending: Callable[[], None] | None = None) -> None:
        """Frames in `finer` times the substeps that are set, at most LONGEST, between which the host has nothing to do.

        ending: what is launched behind each. Those that are captured run launch by launch for the first time, which
        loads what they need.
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
