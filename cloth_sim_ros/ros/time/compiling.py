# SPDX-License-Identifier: Apache-2.0
"""Compilation of the kernels of rare frames beside the simulation, so that no frame waits for them."""

from __future__ import annotations

import threading
from typing import Any

from cloth_sim_ros.sim import Simulation
from cloth_sim_ros.sim.kernels.compiled import watched_compiler


class Compiling:
    """Compiles in a thread of its own, and says in the log when it is done.

    compiler: watches Warp's compilation in any thread.
    """

    def __init__(self, log: Any):
        self._log = log
        self.compiler = watched_compiler()
        self._thread: threading.Thread | None = None

    def start(self, sim: Simulation) -> None:
        """Compile all kernels that `sim` has not compiled so far."""
        self._thread = threading.Thread(target=self._compile, args=(sim,), name="compiling", daemon=True)
        self._thread.start()

    @property
    def is_running(self) -> bool:
        """True if kernels are still being compiled."""
        return self._thread is not None and self._thread.is_alive()

    def _compile(self, sim: Simulation) -> None:
        sim.make_ready()
        self._log.info("all kernels are compiled")
