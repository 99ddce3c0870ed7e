# SPDX-License-Identifier: Apache-2.0
"""Frames by /clock, if use_sim_time is set: one for each frame_dt of it, none while it stands."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from typing import Any

from rclpy.clock import ClockChange, JumpThreshold, ROSClock, TimeJump
from rclpy.duration import Duration


class ClockFollower:
    """The thread that simulates calls `due` and `wait`; `clock` ticks in the executor's.

    went_back() is called when the clock has jumped back, so that stored stamps can be dropped.
    """

    MOST_BEHIND = 10.0  # largest lag behind /clock [s] that is caught up with; more is skipped
    SLOW = 0.5  # [s] behind /clock worth a warning
    PATIENCE = 5.0  # [s] without a clock worth a warning, told once until one comes
    OFTEN = 5.0  # [s] at least between two warnings of a clock that jumps the same way
    SLACK = 1000  # [ns] by which a tick may come early, as clocks round

    def __init__(self, clock: ROSClock, went_back: Callable[[], None], log: Any):
        self._clock, self._went_back, self._log = clock, went_back, log
        self._ticked = threading.Event()
        threshold = JumpThreshold(
            min_forward=Duration(nanoseconds=1), min_backward=Duration(nanoseconds=-1), on_clock_change=True
        )
        # The clock keeps no reference to the handle, and forgets a callback whose handle is gone.
        self._handle = clock.create_jump_callback(threshold, post_callback=self._jumped)
        self.active = clock.ros_time_is_active  # True if use_sim_time is set; stored, as it is read twice a frame
        self._start: int | None = None  # [ns] on /clock, where frames are counted from
        self._frames, self._frame_dt = 0, 0.0
        self._newest = 0
        self._asked: float | None = None  # start of the wait for a clock; inf once that was logged
        self._warned: dict[str, float] = {}  # direction of a jump -> time of its last warning

    @property
    def time(self) -> int:
        """Time of the simulation on /clock [ns], at the end of its last frame; never 0 once a frame was due."""
        return (self._start or 0) + round(1e9 * self._frames * self._frame_dt)

    @property
    def trouble(self) -> str:
        """Why the simulation is not where /clock is; "" if it is."""
        behind = 1e-9 * (self._newest - self.time)
        if self._start is None:
            return "use_sim_time is set and no /clock above 0 comes"
        return f"{behind:.1f} s behind /clock" if behind > max(self.SLOW, self._frame_dt) else ""

    def due(self, frame_dt: float) -> bool:
        """Return True if the clock has reached the end of the next frame of `frame_dt` [s]; the frame then counts as
        taken."""
        self._ticked.clear()
        now = self._clock.now().nanoseconds
        if now <= 0:  # none has come, or one that no message can carry as a stamp
            self._warn_of_silence()
            return False
        self._asked = None
        self._count_from(now, frame_dt)
        self._newest = now
        if now + self.SLACK < self.time + 1e9 * frame_dt:
            return False
        self._frames += 1
        self._ticked.set()  # the next one may be due as well
        return True

    def wait(self) -> None:
        """Sleep until the clock may have moved on, or for a moment."""
        self._ticked.wait(0.05)

    def _jumped(self, jump: TimeJump) -> None:
        self.active = jump.clock_change in (ClockChange.ROS_TIME_ACTIVATED, ClockChange.ROS_TIME_NO_CHANGE)
        self._ticked.set()

    def _count_from(self, now: int, frame_dt: float) -> None:
        """Count frames anew if the clock has jumped to `now` [ns], or frame_dt has changed."""
        if self._start is not None and now < self._newest:
            back = 1e-9 * (self._newest - now)
            self._warn("back", f"/clock went back by {back:.6g} s: time starts anew there, objects go on as they are")
            self._went_back()
            self._start = None
        elif self._start is not None and now - self.time > 1e9 * self.MOST_BEHIND:
            ahead = 1e-9 * (now - self.time)
            self._warn("ahead", f"/clock is {ahead:.6g} s ahead of the simulation, which skips that time")
            self._start = None
        if self._start is None:
            self._start, self._frames = now, 0
        elif frame_dt != self._frame_dt:
            self._start, self._frames = self.time, 0
        self._frame_dt = frame_dt

    def _warn_of_silence(self) -> None:
        if self._asked is None:
            self._asked = time.monotonic()
        elif time.monotonic() - self._asked > self.PATIENCE:
            self._asked = math.inf
            self._log.warning("use_sim_time is set and no /clock above 0 comes; the simulation waits for it")

    def _warn(self, way: str, sentence: str) -> None:
        """Warn in the log, but seldom of a clock that jumps all the time."""
        if time.monotonic() - self._warned.get(way, -math.inf) > self.OFTEN:
            self._warned[way] = time.monotonic()
            self._log.warning(sentence)
