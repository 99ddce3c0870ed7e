# SPDX-License-Identifier: Apache-2.0
"""The speed of a device beside that on which prices.py was measured: timed once, and kept beside Warp's kernels.

So the budget means the same share of real time on every machine, and a second start computes the same bits.
"""

import functools
import json
import math
import os
import time
from contextlib import suppress
from pathlib import Path

import numpy as np
import warp as wp

from cloth_sim_ros import parameters as table
from cloth_sim_ros.sim.kernels.compiled import compiled

VARIABLE = "CLOTH_SIM_SPEED"  # environment variable whose value is taken instead
_ROW = table.row(table.SOLVER, "speed")
_FILE = "cloth_sim_ros_speeds.json"  # device name -> speed
_PARTICLES, _RUNS = 1024, 400
# Sweeps of a run, so short that other processes seldom interrupt it, and its time where the speed is 1 [s].
_SWEEPS = {"cpu": (4, 5.3e-5), "cuda": (1, 3.05e-4)}
_STEPS = 2  # measured speeds are rounded to so many values between one and its double


@compiled
def sweep_chain(chain: wp.array(dtype=wp.vec4), sweeps: int):
    """Move the particles of a chain to a distance of 1 from their neighbours, one after another."""
    for _ in range(sweeps):
        for i in range(1, chain.shape[0]):
            apart = chain[i] - chain[i - 1]
            chain[i] -= (0.5 - 0.5 / wp.length(apart)) * apart


def speed_of(device: wp.Device) -> float:
    """Speed of a device: that of VARIABLE if it is set, else the kept one, else the measured one. Raises ValueError."""
    given = os.environ.get(VARIABLE)
    if given is None:
        return _kept(device.alias)
    try:
        speed = float(given)
    except ValueError:
        speed = 0.0
    if not is_allowed(speed):
        raise ValueError(f"{VARIABLE} is {given!r}; allowed is a number above 0, at most {_ROW.high:g}")
    return speed


def is_allowed(speed: object) -> bool:
    """True for a number that the speed of a device may be."""
    return isinstance(speed, float) and 0.0 < speed <= _ROW.high


@functools.cache
def _kept(alias: str) -> float:
    """Speed of the device of this alias as the file keeps it; measured if it does not."""
    device, path, known = wp.get_device(alias), Path(wp.config.kernel_cache_dir) / _FILE, {}
    with suppress(OSError, RecursionError, TypeError, ValueError):
        known = dict(json.loads(path.read_text()))
    speed = known.get(device.name)
    if is_allowed(speed):
        return speed
    known[device.name] = _measured(device)
    part = path.with_suffix(f".{os.getpid()}")
    with suppress(OSError):  # else it is measured anew at the next start
        part.write_text(json.dumps(known))
        part.replace(path)
    with suppress(OSError):
        part.unlink(missing_ok=True)
    return known[device.name]


def _measured(device: wp.Device) -> float:
    """Measure the speed of a device, and round it coarsely."""
    rows = np.zeros((_PARTICLES, 4), np.float32)
    rows[:, 0] = 1.5 * np.arange(_PARTICLES)
    chain, seconds = wp.array(rows, dtype=wp.vec4, device=device), math.inf
    sweeps, reference = _SWEEPS["cpu" if device.is_cpu else "cuda"]
    for _ in range(_RUNS):
        wp.synchronize_device(device)
        begin = time.perf_counter()
        wp.launch(sweep_chain, 1, inputs=[chain, sweeps], device=device)
        wp.synchronize_device(device)
        seconds = min(seconds, time.perf_counter() - begin)
    return 2.0 ** (round(_STEPS * math.log2(reference / seconds)) / _STEPS)
