# SPDX-License-Identifier: Apache-2.0
"""The numbers of a frame that a batch's kernels read: its length and iterations, and the bounds of its substeps."""

from __future__ import annotations

import numpy as np
import warp as wp

from cloth_sim_ros.sim.arrays.live_array import LiveArray
from cloth_sim_ros.sim.arrays.state import Frame
from cloth_sim_ros.sim.scene.settings import Settings
from cloth_sim_ros.sim.substeps.arrays import StepLimits
from cloth_sim_ros.sim.substeps.choose import Choice


class BatchFrame:
    """The row of Frame of one batch, and a row of StepLimits of each of its `bodies`.

    safe_rows, safe_limits: the same for a repeated frame. shared: the row of all objects.
    """

    def __init__(self, shared: LiveArray, bodies: int, worlds: int, device: wp.Device) -> None:
        self.rows, self.safe_rows = (LiveArray(Frame, 1, worlds, device) for _ in range(2))
        self.limits, self.safe_limits = (LiveArray(StepLimits, bodies, worlds, device) for _ in range(2))
        self.iterations = 1
        self._shared = shared

    def bound(self, b: int, choice: Choice, settings: Settings, sizes: np.ndarray, in_step: bool) -> None:
        """Write the choice for body b of `sizes` (worlds,) [m]; those `in_step` never sleep, as others move them."""
        flags = {"sleeps": int(settings.sleep and not in_step), "is_set": int(settings.substeps > 0)}
        bounds = {name: getattr(choice, name) for name in ("least", "most", "fewest", "test")}
        self.limits.write(b, None, start=choice.substeps, error=settings.error, size=sizes, **flags, **bounds)
        self.safe_limits.write(b, None, start=choice.safe_substeps)

    def write(self, frame_dt: float) -> None:
        """Write the shared numbers, and the length of a frame [s]."""
        for rows, sweeps in ((self.rows, self.iterations), (self.safe_rows, 1)):
            rows.edit()[:] = self._shared.read(0, None)[:, None]
            rows.write(0, None, length=frame_dt, iterations=sweeps)

    def upload(self) -> None:
        """Copy changed numbers to the device."""
        for rows in (self.rows, self.safe_rows, self.limits, self.safe_limits):
            rows.upload()
