# SPDX-License-Identifier: Apache-2.0
"""Report the work of the simulation's thread while it takes so long that the thread cannot report itself."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from cloth_sim_ros.ros.time.loop import SimulationLoop
from cloth_sim_ros.sim.kernels.compiled import Compiler

LONG = {"": math.inf, "frame": 5.0, "building": 60.0}  # [s] without the compiler, after which there is advice
WORTH_TELLING = 2.0  # [s] of a build, or of a frame that waits for the compiler
WORTH_LOGGING = 5.0  # [s] of any work before it is logged; then after twice the time each


class LongWaits:
    """`look` is called once a second, in another thread than the loop's. say(sentence) reports to present listeners."""

    def __init__(self, loop: SimulationLoop, compiler: Compiler, log: Any, say: Callable[[str], None]):
        self._loop, self._compiler, self._log, self._say = loop, compiler, log, say
        self._seconds = math.inf  # of what the loop is at, when it was looked at last
        self._compiling_before = 0.0  # [s] of the compiler, when that began
        self._logged = 0.0  # [s] of it when it was last logged

    def look(self) -> None:
        """Report work that takes long, and log it now and then."""
        what, seconds = self._loop.busy or ("", 0.0)
        if seconds < self._seconds:  # it has begun since
            self._compiling_before, self._logged = self._compiler.seconds, 0.0
        self._seconds = seconds
        without = seconds - (self._compiler.seconds - self._compiling_before)
        if without >= LONG[what]:
            advice = "fewer substeps or iterations, or coarser objects, take less"
            sentence = f"{what} has taken {without:.0f} s so far; {advice}"
            if self._is_worth_logging():
                self._log.warning(sentence)
            self._say(sentence)
        elif what and seconds >= WORTH_TELLING and self._compiler.at_work:
            done = self._compiler.modules
            count = f"{done} module{'' if done == 1 else 's'} done, {seconds:.0f} s so far"
            sentence = f"compiling kernels, which later starts find ready: {count}"
            if self._is_worth_logging():
                self._log.info(sentence)
            self._say(sentence)
        elif what == "building" and seconds >= WORTH_TELLING:
            self._say(f"building the simulation, for {seconds:.0f} s so far")

    def _is_worth_logging(self) -> bool:
        if self._seconds < max(WORTH_LOGGING, 2.0 * self._logged):
            return False
        self._logged = self._seconds
        return True
