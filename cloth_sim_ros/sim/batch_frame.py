# SPDX-License-Identifier: Apache-2.0
"""What the kernels of a batch read about a frame: its substeps, and what all objects share."""

from __future__ import annotations

import numpy as np
import warp as wp

from cloth_sim_ros.sim.live_array import LiveArray
from cloth_sim_ros.sim.methods.limits import outer_steps
from cloth_sim_ros.sim.state import Frame


class BatchFrame:
    """The rows of Frame of one batch: `rows`, and `safe_rows` of a frame that is done again.

    shared: the row of all objects. plate_rates: of each body that has slow forces, see Topology. written: the length of
    a frame [s], its substeps, iterations and steps of slow forces, and substeps done again, as they were written last.
    """

    def __init__(
        self, shared: LiveArray, materials: LiveArray, plate_rates: list[float], worlds: int, device: wp.Device
    ) -> None:
        self.rows, self.safe_rows = LiveArray(Frame, 1, worlds, device), LiveArray(Frame, 1, worlds, device)
        self.substeps = self.iterations = self.safe_substeps = self.outer = 1
        self._shared, self._materials, self._plate_rates = shared, materials, plate_rates
        self.written: tuple[float, int, int, int, int] | None = None

    def write(self, frame_dt: float, finer: int = 1) -> None:
        """What all objects share, and a frame of `frame_dt` [s] in `finer` times as many substeps."""
        self.written = self._lengths(frame_dt, finer)
        (substeps, iterations, self.outer), safe = self.written[1:4], self.written[4]
        self.rows.edit()[:] = self._shared.read(0, None)[:, None]
        numbers = {"substeps": substeps, "iterations": iterations, "outer": self.outer}
        self.rows.write(0, None, dt=frame_dt / substeps, **numbers)
        self.safe_rows.edit()[:] = self._shared.read(0, None)[:, None]
        self.safe_rows.write(0, None, dt=frame_dt / safe, substeps=safe, iterations=1)

    def refresh(self, frame_dt: float) -> None:
        """The same where a number of the batch's own changed; what all objects share is left to the next frame."""
        if self.written != self._lengths(frame_dt, 1):
            self.write(frame_dt)

    def upload(self) -> None:
        """Bring changed numbers to the device."""
        self.rows.upload()
        self.safe_rows.upload()

    def _lengths(self, frame_dt: float, finer: int) -> tuple[float, int, int, int, int]:
        """The length of a frame [s], its substeps, iterations and steps of slow forces, and substeps done again."""
        substeps = finer * self.substeps
        needs = [self._outer_steps(b, rate, frame_dt, substeps) for b, rate in enumerate(self._plate_rates)]
        outer = max(needs, default=1)
        return frame_dt, substeps, self.iterations, outer, finer * self.safe_substeps

    def _outer_steps(self, b: int, rate: float, frame_dt: float, substeps: int) -> int:
        """The steps of slow forces that body b needs in a frame, in the world that needs most."""
        rows = self._materials.read(b, None)
        softness = rows["compliance"][:, 2].astype(np.float64)
        rate = rate * rows["largest_inverse_mass"].astype(np.float64)
        rates = np.divide(rate, softness, out=np.zeros(len(rows)), where=(softness > 0.0) & (rate > 0.0))
        drag = float(self.rows.read(0, 0)["global_damping"][0])
        return outer_steps(substeps, frame_dt / substeps, rates, rows["damping"].astype(np.float64), drag)
