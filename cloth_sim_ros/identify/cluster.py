# SPDX-License-Identifier: Apache-2.0
"""Candidates spread over the GPUs or CPUs of a cluster by Ray, which repeats the work of a worker that died."""

from __future__ import annotations

import logging
import socket
import uuid
from collections.abc import Sequence

import numpy as np
import ray
import warp as wp

from cloth_sim_ros.identify.candidates import Candidates
from cloth_sim_ros.identify.recording import Recording
from cloth_sim_ros.sim import Scene, Settings

_RETRIES = 10  # retries of a batch whose worker died
_PATIENCE = 5.0  # longest wait [s] for a cluster's answer
_ALLOWED = "allowed is 'local' or HOST:PORT"
_built: dict[str, Candidates] = {}  # a worker keeps its candidates for the batches that follow


def run_batch(key: str, given: tuple, how: tuple, units: np.ndarray, keep: bool) -> np.ndarray:
    """Return `Candidates(*given).run` of a batch, judged as `how` says.

    The worker keeps the candidates of the last `key`, and builds them anew for another one.
    """
    if key not in _built:
        wp.config.log_level = wp.LOG_WARNING
        _built.clear()
        _built[key] = Candidates(*given)
    _built[key].how = how
    return _built[key].run(units, keep)


@ray.remote(max_retries=_RETRIES)
def _run(*arguments):
    """Call `run_batch` in a worker, which imports it: Ray copies a function with all globals that it names."""
    from cloth_sim_ros.identify.cluster import run_batch

    return run_batch(*arguments)


class Spread(Candidates):
    """Candidates on a cluster at `address`, `worlds` at a time on each of its GPUs; "local" makes one of this machine.

    Each CPU core takes them instead if there is no GPU or `device` is "cpu". The results do not depend on the number of
    workers, nor on which one computes a batch. Raises ValueError if there is no cluster.
    """

    def __init__(
        self,
        address: str,
        scene: Scene,
        settings: Settings,
        recording: Recording,
        fit: Sequence[str],
        worlds: int,
        device: str,
    ) -> None:
        super().__init__(scene, settings, recording, fit, worlds, device)
        if not ray.is_initialized():
            _join(address)
        gpus = device != "cpu" and ray.cluster_resources().get("GPU", 0) > 0
        self._task = _run.options(num_gpus=1) if gpus else _run.options(num_cpus=1)
        self._fit, self._kind = list(fit), "cuda:0" if gpus else "cpu"
        self._share()

    def _share(self) -> None:
        """Send all workers what they need to build the candidates."""
        given = (self._scene, self.settings, self.recording, self._fit, self.sim.worlds, self._kind)
        self._key, self._given = uuid.uuid4().hex, ray.put(given)

    def narrow(self, worlds: int) -> None:
        super().narrow(worlds)
        self._share()

    def _all(self, parts: list[np.ndarray], keep: bool) -> list[np.ndarray]:
        """Return the result of `run` for each part, in their order."""
        how = ray.put(self.how)
        tasks = [self._task.remote(self._key, self._given, how, part, keep) for part in parts]
        waiting = tasks
        while waiting:
            done, waiting = ray.wait(waiting)
            self.frames += self.length * len(done)
            self.told(self.frames)
        return ray.get(tasks)


def _join(address: str) -> None:
    """Connect to the cluster at an address. Raises ValueError if there is none."""
    if address != "local":
        host, _, port = address.removeprefix("ray://").rpartition(":")
        try:  # Ray itself tries for minutes
            socket.create_connection((host, int(port)), timeout=_PATIENCE).close()
        except (OSError, ValueError, OverflowError) as problem:
            raise ValueError(f"there is no cluster at {address!r}: {problem}; {_ALLOWED}") from None
    try:
        options = {"include_dashboard": False} if address == "local" else {}
        ray.init(address=address, log_to_driver=False, logging_level=logging.ERROR, **options)
    except (ConnectionError, RuntimeError, ValueError) as problem:
        first = str(problem).splitlines()[0]
        raise ValueError(f"there is no cluster at {address!r}: {first}; {_ALLOWED}") from None
