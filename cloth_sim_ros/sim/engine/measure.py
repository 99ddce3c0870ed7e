# SPDX-License-Identifier: Apache-2.0
"""Measured frames: trials with fewer substeps from the same state, then the frame itself (see substeps/control.py)."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import warp as wp

from cloth_sim_ros.sim.arrays.state import Arrays
from cloth_sim_ros.sim.substeps.control import begin_trial, change_substeps, control, end_trial

_TRIALS = (4, 2)  # divisors of the number of substeps, in the order that `control` compares their results
_MOST_THREADS = 256


class Measurement:
    """Launches that measure the error of the bodies of a batch, whose whole state is the buffer `state`.

    particles, largest: number of particles of all bodies, and of the largest. second: True for order 2. alone: each
    body takes the substeps that its own error asks for.
    """

    def __init__(
        self, worlds: list[Arrays], state: wp.array, particles: int, largest: int, second: bool, alone: bool
    ) -> None:
        device, bodies = state.device, len(worlds) * worlds[0].limits.shape[0]
        self._state, self._saved = state, wp.empty_like(state)
        self._given = wp.array(worlds, dtype=Arrays, device=device)
        remembered = [wp.zeros((len(worlds), particles), dtype=wp.vec3, device=device) for _ in range(2)]
        differences = wp.zeros(bodies, dtype=float, device=device)
        self._wanted = wp.zeros(bodies, dtype=int, device=device)
        block = 1 if device.is_cpu else min(_MOST_THREADS, -(-largest // 32) * 32)

        def launch(kernel: wp.Kernel, *inputs) -> wp.Launch:
            inputs = [self._given, *inputs, block]
            return wp.launch(kernel, bodies * block, inputs, device=device, block_dim=block, record_cmd=True)

        self._begin = {divisor: launch(begin_trial, int(second), divisor) for divisor in _TRIALS}
        self._end = launch(end_trial, *remembered, differences)
        self._control = launch(control, *remembered, differences, self._wanted, int(second), int(alone))
        self._change = launch(change_substeps, 0, int(second))

    def save(self) -> None:
        """Copy the state."""
        wp.copy(self._saved, self._state)

    def begin(self, divisor: int) -> None:
        """Let the next frame be a trial of 1 / divisor of the substeps."""
        self._begin[divisor].launch()

    def end(self) -> None:
        """Keep the result of a trial, and go back to the copied state."""
        self._end.launch()
        wp.copy(self._state, self._saved)

    def control(self) -> None:
        """Estimate the error of the frame, and the substeps that the next should take."""
        self._control.launch()

    def wanted(self) -> int:
        """Most substeps that a body should take; waits for the device."""
        return int(self._wanted.numpy().max())

    def change(self, substeps: int) -> None:
        """Let all bodies take as many substeps from now on; 0 brings those of each within its limits."""
        self._change.set_param_at_index(1, substeps)
        self._change.launch()


def advance_measured(measurements: Sequence[Measurement], frame: Callable[[int], None]) -> None:
    """Simulate a frame of bodies that advance together, after its trials.

    frame(divisor): simulates one in 1 / divisor of the substeps.
    """
    for each in measurements:
        each.save()
    for divisor in _TRIALS:
        for each in measurements:
            each.begin(divisor)
        frame(divisor)
        for each in measurements:
            each.end()
    frame(1)
    for each in measurements:
        each.control()
