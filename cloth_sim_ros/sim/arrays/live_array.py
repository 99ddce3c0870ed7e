# SPDX-License-Identifier: Apache-2.0
"""Live numbers on the device: structs in arrays of one row a thing, each with a mirror on the host.

A change is one small copy at the start of the next frame and never compiles or captures anything again.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from cloth_sim_ros.sim.input.checks import WorldSelection, worlds_of


class LiveArray:
    """Rows of a struct in every world, on the device and mirrored on the host; `upload()` copies what was changed."""

    def __init__(self, struct, rows: int, worlds: int, device: wp.Device) -> None:
        self._mirror = np.zeros((worlds, rows), dtype=struct.numpy_dtype())
        self._host = wp.array(self._mirror, dtype=struct, device="cpu", copy=False)
        self.array = wp.zeros((worlds, rows), dtype=struct, device=device)
        self._changed = True

    @property
    def is_changed(self) -> bool:
        """Whether something waits to be uploaded."""
        return self._changed

    def read(self, row: int, world: WorldSelection) -> np.ndarray:
        """A copy of a row in some worlds (k,): one, (worlds,) of all for None, or those of some numbers."""
        return self._mirror[worlds_of(world), row].copy()

    def write(self, row: int, world: WorldSelection, **values) -> None:
        """Change fields of a row in some worlds, to one value or a value for each of these; they reach the device with
        the next upload."""
        for name, value in values.items():
            self._mirror[name][worlds_of(world), row] = value
        self._changed = True

    def edit(self) -> np.ndarray:
        """The mirror (worlds, rows) itself, to be changed; it reaches the device with the next upload."""
        self._changed = True
        return self._mirror

    def mirrors(self) -> dict[str, np.ndarray]:
        """Name -> each array (worlds, rows, ...) on the host that says what the rows are; see `touch`."""
        return {"rows": self._mirror}

    def touch(self) -> None:
        """To be called when what `mirrors` gave has been written to: it reaches the device with the next upload."""
        self._changed = True

    def upload(self) -> None:
        """Copy to the device if anything changed; ordered before the launches that follow on the device's stream."""
        if self._changed:
            wp.copy(self.array, self._host)
            self._changed = False
