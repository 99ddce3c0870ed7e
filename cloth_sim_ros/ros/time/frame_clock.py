# SPDX-License-Identifier: Apache-2.0
"""Deadlines of frames, and the pace of the simulation against real time."""

from __future__ import annotations

import statistics
import threading
import time
from dataclasses import dataclass


@dataclass(frozen=True)
class Pace:
    """Pace of the simulation.

    real_time_factor: simulated per real second while not paused. ms_per_frame: median time spent on one frame [ms].
    ms_waiting: median time in it that the thread waited for the device [ms].
    """

    real_time_factor: float
    ms_per_frame: float
    ms_waiting: float
    frames: int


class FrameClock:
    """Absolute deadlines every `period` [s], so that lateness of one frame does not delay the ones after it.

    Late frames are caught up with, such as after other work has taken the processor for a moment. Time beyond
    MOST_BEHIND is dropped: the simulation falls behind real time, and `pace` says so.
    """

    MOST_BEHIND = 0.25  # [s]

    def __init__(self, period: float):
        self.period = period
        self._deadline = time.monotonic()
        self._since = self._deadline
        self._works: list[float] = []
        self._waits: list[float] = []
        self._simulated = 0.0

    def restart(self, period: float) -> None:
        """Restart counts and deadlines from now."""
        self.__init__(period)

    def worked(self, seconds: float, waited: float, simulated: float) -> None:
        """Note a frame that took `seconds` to compute and to hand over for sending, and covers `simulated` seconds.

        waited [s]: the part of it that the thread waited for the device.
        """
        self._works.append(seconds)
        self._waits.append(waited)
        self._simulated += simulated

    def wait(self, stop: threading.Event) -> None:
        """Sleep until the next frame is due, or until `stop` is set."""
        now = time.monotonic()
        self._deadline = max(self._deadline + self.period, now - self.MOST_BEHIND)
        if self._deadline > now:
            stop.wait(self._deadline - now)

    def pace(self) -> Pace:
        """Return the pace since the last call."""
        now = time.monotonic()
        elapsed, work, wait = max(now - self._since, 1e-9), _median_ms(self._works), _median_ms(self._waits)
        pace = Pace(self._simulated / elapsed, work, wait, len(self._works))
        self._since, self._works, self._waits, self._simulated = now, [], [], 0.0
        return pace


def _median_ms(seconds: list[float]) -> float:
    return 1e3 * statistics.median(seconds) if seconds else 0.0
