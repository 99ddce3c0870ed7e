# SPDX-License-Identifier: Apache-2.0
"""Measured frames: trials with fewer substeps from the same state, then the frame itself (see substeps/control.py)."""

from __future__ import annotations

from collections.abc import Callable

import warp as wp

from cloth_sim_ros.sim.engine.saved import Saved
from cloth_sim_ros.sim.substeps.control import (
    OF_ROPES,
    begin_better,
    begin_trial,
    change_substeps,
    control,
    end_trial,
    watch,
)

TRIALS = (4, 2)  # divisors of the number of substeps, in the order that `control` compares their results
_MOST_THREADS = 256


class Measurement:
    """Launches that measure the error of the bodies of a batch.

    given: the Arrays of each world.
    saved: copy of the state, to which trials go back. particles: number of them. second: True for order 2. alone: each
    body takes the substeps that its own error asks for. ropes: True for ropes. block: threads a body.

    most: substeps (worlds, bodies) that the budget paid when they were last chosen; 0 if its limits changed since.
    """

    def __init__(
        self, given: wp.array, saved: Saved, particles: int, second: bool, alone: bool, ropes: bool, block: int
    ) -> None:
        device, shape = saved.device, saved.part("substeps").shape
        bodies = shape[0] * shape[1]
        growth = OF_ROPES if ropes else 1.0
        self._saved = saved
        remembered = [wp.zeros((shape[0], particles), dtype=wp.vec3, device=device) for _ in range(2)]
        differences = wp.zeros(bodies, dtype=float, device=device)
        tests = wp.zeros((2, bodies), dtype=int, device=device)  # before a trial, and in it
        self._wanted = wp.zeros(bodies, dtype=int, device=device)
        self._far = wp.zeros(1, dtype=int, device=device)
        self.most = wp.zeros(shape, dtype=int, device=device)

        def launch(kernel: wp.Kernel, *inputs) -> wp.Launch:
            inputs = [given, *inputs, block]
            return wp.launch(kernel, bodies * block, inputs, device=device, block_dim=block, record_cmd=True)

        self._begin = {divisor: launch(begin_trial, tests, int(second), divisor) for divisor in TRIALS}
        self._end = launch(end_trial, *remembered, differences, tests)
        watched = second and alone
        chosen = (self._wanted, self.most.flatten(), int(second), int(alone), int(watched), growth, self._far)
        self._control = launch(control, *remembered, differences, tests, *chosen)
        self._watch = launch(watch, growth, self._wanted, self._far) if watched else None
        self._begin_better = launch(begin_better, self._wanted, self._far, int(second))
        self._alone, self._ropes = alone, ropes
        self._change = launch(change_substeps, 0, int(second))

    def begin(self, divisor: int) -> None:
        """Let the next frame be a trial of 1 / divisor of the substeps."""
        self._begin[divisor].launch()

    def end(self) -> None:
        """Keep the result of a trial, and go back to the copied state."""
        self._end.launch()
        self._saved.restore()

    def control(self) -> None:
        """Estimate the error of the frame, and the substeps that the next should take."""
        self._control.launch()

    def improve(self, frame: Callable[[], None], measured: bool) -> None:
        """Compute the frame again by `frame`, as long as its error is far beyond the wanted one and more is paid.

        measured: True for a frame with trials. Others are computed again of ropes alone.
        """
        if self._alone and (measured or self._ropes):
            wp.capture_while(self._far, self._again, frame=frame)

    def _again(self, frame: Callable[[], None]) -> None:
        self._saved.restore()
        self._begin_better.launch()
        frame()

    def watch(self) -> None:
        """See from its last substep how much the error of a frame without trials grew; more substeps follow."""
        if self._watch is not None:
            self._watch.launch()

    def wanted(self) -> int:
        """Most substeps that a body should take; waits for the device."""
        return int(self._wanted.numpy().max())

    def change(self, substeps: int) -> None:
        """Let all bodies take as many substeps from now on; 0 brings those of each within its limits."""
        if substeps == 0:
            self.most.zero_()
        self._change.set_param_at_index(1, substeps)
        self._change.launch()


def threads_of(largest: int, device: wp.Device) -> int:
    """Threads that measure a body, for one of `largest` particles."""
    return 1 if device.is_cpu else min(_MOST_THREADS, -(-largest // 32) * 32)
