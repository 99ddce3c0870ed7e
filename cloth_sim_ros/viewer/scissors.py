# SPDX-License-Identifier: Apache-2.0
"""Cut an object by two clicks: everything seen between them, in all layers."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from cloth_sim_ros.viewer.drawing import Click

BEHIND = 2.0  # times as far as what was clicked, a cut goes away from the eye


class Scissors:
    """Scissors that two clicks use. cut(polygon (3, 3) [m]) is called with the second click; told(sentence) with
    each."""

    def __init__(self, cut: Callable[[np.ndarray], None], told: Callable[[str], None]):
        self._cut, self._told = cut, told
        self._first: tuple[str, int] | None = None

    def click(self, click: Click, positions: np.ndarray) -> None:
        """Take a click on an object with particles at `positions` (N, 3) [m]; the particle nearest to the ray
        counts."""
        place = np.asarray(positions, dtype=np.float64) - click.origin
        along = place @ click.direction
        vertex = int(np.linalg.norm(place - along[:, None] * click.direction, axis=1).argmin())
        if self._first is None or self._first[0] != click.name or self._first[1] >= len(positions):
            self._first = (click.name, vertex)
            self._told(f"Click where the cut of {click.name} ends.")
        elif self._first[1] == vertex:
            self._told("The cut begins and ends at the same place. Click another one.")
        else:
            rays = place[[self._first[1], vertex]]
            self._first = None
            self._cut(click.origin + np.concatenate([np.zeros((1, 3)), BEHIND * rays]))
            self._told(f"A cut goes through {click.name}.")
