# SPDX-License-Identifier: Apache-2.0
"""How far a search is, on a terminal."""

from __future__ import annotations

import time
from typing import Any

from cloth_sim_ros.identify.fit import MOST_STEPS
from cloth_sim_ros.status_line import show


class Progress:
    """Says on a terminal how far it is and how long it takes at most, from the frames that are done."""

    def __init__(self, candidates: Any) -> None:
        self._began, self._told = time.monotonic(), 0.0
        self._most = candidates.frames + MOST_STEPS * candidates.length

    def __call__(self, frames: int) -> None:
        now = time.monotonic()
        if now - self._told > 0.5:
            self._told = now
            left = (now - self._began) * max(self._most / frames - 1.0, 0.0)
            show(f"{frames} frames, at most {left:.0f} s left")
