# SPDX-License-Identifier: Apache-2.0
"""Time per frame, measured the same way everywhere, and the machine it was measured on."""

from __future__ import annotations

import platform
import time
from collections.abc import Callable, Sequence

import numpy as np
import warp as wp

from cloth_sim_ros.sim import Simulation


def milliseconds(step: Callable[[], None], device: wp.Device) -> float:
    """Return the milliseconds of a step: on a GPU by CUDA events on its stream, on the CPU by the wall clock."""
    if not device.is_cuda:
        begin = time.perf_counter()
        step()
        return 1e3 * (time.perf_counter() - begin)
    stream = wp.get_stream(device)
    start, end = (wp.Event(device, enable_timing=True) for _ in range(2))
    stream.record_event(start)
    step()
    stream.record_event(end)
    return wp.get_event_elapsed_time(start, end)  # waits for the device


def frame_times(sim: Simulation, frames: int, after: Callable[[], None]) -> np.ndarray:
    """Return the milliseconds (frames,) of each of `frames` frames; `after` is called after each, untimed.

    Each starts on an idle device, so that the launch from the host counts. `frame_time` has frames that follow one
    another.
    """
    device, found = wp.get_device(sim.device), []
    for _ in range(frames):
        found.append(milliseconds(sim.step, device))
        after()
    return np.array(found)


def frame_time(sim: Simulation, frames: int) -> float:
    """Return the milliseconds a frame of `frames` in a row, each by a call of its own.

    On a GPU it is their mean between two CUDA events, as one after each of them would add 2 us of its own. On the CPU
    it is the median.
    """
    device = wp.get_device(sim.device)
    if not device.is_cuda:
        return float(np.median(frame_times(sim, frames, lambda: None)))

    def run() -> None:
        for _ in range(frames):
            sim.step()

    return milliseconds(run, device) / frames


def quartiles(numbers: Sequence[float]) -> dict[str, float]:
    """Return low, median and high: the quartiles of `numbers`."""
    return dict(zip(("low", "median", "high"), np.percentile(numbers, (25, 50, 75)), strict=True))


def spread(times: Sequence[float]) -> str:
    """Return median and quartiles [ms] in a few characters."""
    numbers = quartiles(times)
    return f"{numbers['median']:.3g} ({numbers['low']:.3g}-{numbers['high']:.3g})"


def machine(device: str) -> dict[str, str]:
    """Return the device, its name and the versions that the times were measured with, for tables and JSON."""
    chosen = wp.get_device(device)
    name = chosen.name if chosen.is_cuda else _processor()
    return {"device": chosen.alias, "name": name, "warp": wp.__version__, "python": platform.python_version()}


def _processor() -> str:
    try:
        with open("/proc/cpuinfo") as info:
            return next(line.split(":", 1)[1].strip() for line in info if line.startswith("model name"))
    except (OSError, StopIteration):
        return platform.processor() or platform.machine()
