# SPDX-License-Identifier: Apache-2.0
"""Live numbers on the device: arrays of structs, one row per object, each with a mirror on the host.

A change costs one small copy at the start of the next frame. It never causes a compilation or a capture.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from cloth_sim_ros.sim.input.checks import WorldSelection, worlds_of


class LiveArray:
    """Rows of a struct in every world, on the device and mirrored on the host; `upload()` copies what was changed.

    is_changed: True if changes wait to be uploaded.
    """

    def __init__(self, struct, rows: int, worlds: int, device: wp.Device) -> None:
        self._mirror = np.zeros((worlds, rows), dtype=struct.numpy_dtype())
        self._host = wp.array(self._mirror, dtype=struct, device="cpu", copy=False)
        self.array = wp.zeros((worlds, rows), dtype=struct, device=device)
        self.is_changed = True

    def read(self, row: int, world: WorldSelection) -> np.ndarray:
        """Copy a row in some worlds (k,): one world, all for None, or those of an array of numbers."""
        return self._mirror[worlds_of(world), row].copy()

    def write(self, row: int, world: WorldSelection, **values) -> None:
        """Set fields of a row in some worlds, to one value or one per world; `upload` brings them to the device."""
        for name, value in values.items():
            self._mirror[name][worlds_of(world), row] = value
        self.is_changed = True

    def edit(self) -> np.ndarray:
        """Return the mirror (worlds, rows) itself for changes; the next upload brings them to the device."""
        self.is_changed = True
        return self._mirror

    def mirrors(self) -> dict[str, np.ndarray]:
        """Name -> each host array (worlds, rows, ...) that determines the rows; call `touch` after writing to one."""
        return {"rows": self._mirror}

    def touch(self) -> None:
        """Mark the arrays of `mirrors` as changed; the next upload brings them to the device."""
        self.is_changed = True

    def upload(self) -> None:
        """Copy to the device if anything changed, ordered before later launches on the device's stream."""
        if self.is_changed:
            wp.copy(self.array, self._host)
            self.is_changed = False
