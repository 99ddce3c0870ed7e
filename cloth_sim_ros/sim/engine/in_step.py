# SPDX-License-Identifier: Apache-2.0
"""Batches whose bodies advance in step: all end a substep before any begins the next, so the host counts substeps."""

from __future__ import annotations

from collections.abc import Sequence

from cloth_sim_ros.sim.engine.batch import Batch
from cloth_sim_ros.sim.engine.frame import run_frame
from cloth_sim_ros.sim.executors.graph import Graph
from cloth_sim_ros.sim.substeps.energy import MORE


class InStep:
    """Batches that one Graph advances, all with the most substeps that the error of any of their bodies asks for."""

    def __init__(self, batches: Sequence[Batch], graph: Graph) -> None:
        self.batches, self._graph = batches, graph
        self._measurements = [batch.measurement for batch in batches if batch.measurement is not None]
        self._substeps, self._factor = 0, 1

    def forget(self) -> None:
        """The state was replaced or reset, so the number of substeps has to be read from it."""
        self._substeps = 0

    def advance(self, measured: bool) -> None:
        """Simulate one frame; if it is `measured`, choose the substeps of the next."""
        if not self._substeps:
            self._share(max(batch.substeps() for batch in self.batches))
        self._factor = 1
        run_frame(self.batches, measured, self._frame, self._repeat)
        if measured and self._measurements:
            wanted = max(each.wanted() for each in self._measurements)
            if wanted != self._substeps:
                self._share(wanted)

    def _share(self, substeps: int) -> None:
        self._substeps = substeps
        for each in self._measurements:
            each.change(substeps)

    def _frame(self, divisor: int) -> None:
        self._graph.advance(max(1, self._factor * self._substeps // divisor), self.batches[0].frame.iterations)

    def _repeat(self) -> None:
        self._factor *= MORE
        self._frame(1)
