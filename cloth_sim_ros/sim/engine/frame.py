# SPDX-License-Identifier: Apache-2.0
"""One frame of batches that advance together: trials that measure its error, the frame, and the judge of its energy."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from cloth_sim_ros.sim.engine.measure import TRIALS


def run_frame(batches: Sequence, measured: bool, frame: Callable[[int], None], repeat: Callable[[], None]) -> None:
    """Simulate one frame; if it is `measured`, let it choose the substeps of the next, which else may only grow.

    batches: one Batch or several. frame(divisor): simulates one in 1 / divisor of the substeps. repeat(): simulates it
    again with more substeps.
    """
    measurements = [each.measurement for each in batches if each.measurement is not None]
    ledgers = [each.ledger for each in batches if each.ledger is not None]

    def compute() -> None:
        for ledger in ledgers:
            ledger.open()
        for batch in batches:
            if batch.ledger is not None or (measured and batch.measurement is not None):
                batch.saved.save()
        for divisor in TRIALS if measured and measurements else ():
            for each in measurements:
                each.begin(divisor)
            frame(divisor)
            for each in measurements:
                each.end()
        frame(1)
        for ledger in ledgers:
            ledger.judge(repeat)
        for each in measurements:
            if measured:
                each.control()
            else:
                each.watch()

    compute()
    for each in measurements:
        each.improve(compute, measured)
