# SPDX-License-Identifier: Apache-2.0
"""The numbers of a frame that a batch's kernels read: its substeps, and numbers that all objects share."""

from __future__ import annotations

import warp as wp

from cloth_sim_ros.sim.arrays.live_array import LiveArray
from cloth_sim_ros.sim.arrays.state import Frame


class BatchFrame:
    """The rows of Frame of one batch: `rows`, and `safe_rows` for a repeated frame.

    shared: the row of all objects. written: the last written length of a frame [s], its substeps and iterations, and
    the substeps of a repeated frame.
    """

    def __init__(self, shared: LiveArray, worlds: int, device: wp.Device) -> None:
        self.rows, self.safe_rows = LiveArray(Frame, 1, worlds, device), LiveArray(Frame, 1, worlds, device)
        self.substeps = self.iterations = self.safe_substeps = 1
        self._shared = shared
        self.written: tuple[float, int, int, int] | None = None

    def write(self, frame_dt: float, finer: int = 1) -> None:
        """Write the shared numbers, and a frame of `frame_dt` [s] in `finer` times as many substeps."""
        self.written = self._lengths(frame_dt, finer)
        _, substeps, iterations, safe = self.written
        for rows, count, sweeps in ((self.rows, substeps, iterations), (self.safe_rows, safe, 1)):
            rows.edit()[:] = self._shared.read(0, None)[:, None]
            rows.write(0, None, dt=frame_dt / count, substeps=count, iterations=sweeps)

    def refresh(self, frame_dt: float) -> None:
        """Write the batch's own numbers where they changed; the next frame brings the shared ones."""
        if self.written != self._lengths(frame_dt, 1):
            self.write(frame_dt)

    def upload(self) -> None:
        """Copy changed numbers to the device."""
        self.rows.upload()
        self.safe_rows.upload()

    def _lengths(self, frame_dt: float, finer: int) -> tuple[float, int, int, int]:
        return frame_dt, finer * self.substeps, self.iterations, finer * self.safe_substeps
