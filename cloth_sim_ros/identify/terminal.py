# SPDX-License-Identifier: Apache-2.0
"""Terminal output of this folder's commands: progress of a search, and errors."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from typing import Any

import warp as wp

from cloth_sim_ros.identify.fit import MOST_STEPS
from cloth_sim_ros.options import missing
from cloth_sim_ros.status_line import show


def exit_status(run: Callable[[argparse.Namespace], Any], arguments: argparse.Namespace) -> int:
    """Run a command and return its exit status: 2 if it raises ValueError, whose one sentence is printed."""
    wp.config.log_level = wp.LOG_WARNING
    try:
        if lack := missing("matplotlib"):
            raise ValueError(lack)
        run(arguments)
    except ValueError as problem:
        print(f"error: {problem}", file=sys.stderr)
        return 2
    return 0


class Progress:
    """Shows on a terminal the number of frames done, and the longest time that is left."""

    def __init__(self, candidates: Any) -> None:
        self._began, self._told = time.monotonic(), 0.0
        self._most = candidates.frames + MOST_STEPS * candidates.length

    def __call__(self, frames: int) -> None:
        now = time.monotonic()
        if now - self._told > 0.5:
            self._told = now
            left = (now - self._began) * max(self._most / frames - 1.0, 0.0)
            show(f"{frames} frames, at most {left:.0f} s left")
