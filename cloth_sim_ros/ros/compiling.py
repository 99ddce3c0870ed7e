# SPDX-License-Identifier: Apache-2.0
"""What rare frames of a simulation need is compiled beside it, so that none of them waits."""

from __future__ import annotations

import threading
from typing import Any

from cloth_sim_ros.sim import Simulation


class Compiling:
    """Compiles in a thread of its own, and says in the log when it is done."""

    def __init__(self, log: Any):
        self._log = log
        self._thread: threading.Thread | None = None

    def start(self, sim: Simulation) -> None:
        """Compiles what `sim` has not compiled so far."""
        self._thread = threading.Thread(target=self._compile, args=(sim,), name="compiling", daemon=True)
        self._thread.start()

    @property
    def is_running(self) -> bool:
        """Whether kernels are still being compiled."""
        return self._thread is not None and self._thread.is_alive()

    def _compile(self, sim: Simulation) -> None:
        sim.make_ready()
        self._log.info("all kernels are compiled")
