# SPDX-License-Identifier: Apache-2.0
"""Frames whose energy is judged: a frame that gains energy is computed again from its start, with more substeps."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import warp as wp

from cloth_sim_ros.sim.arrays.state import Arrays
from cloth_sim_ros.sim.engine.saved import Saved
from cloth_sim_ros.sim.substeps.energy import begin_again, judge_frames, open_frames


class Ledger:
    """Launches that judge the energy of the bodies of a batch, see substeps/energy.py.

    saved: copy of the state, to which a rejected frame goes back. lines: of each body, (kind, first, end) of the slots
    of its lines. second: True for order 2. block: threads a body.
    """

    def __init__(
        self,
        worlds: list[Arrays],
        saved: Saved,
        lines: Sequence[Sequence[tuple[int, int, int]]],
        second: bool,
        block: int,
    ) -> None:
        device, bodies = saved.device, len(worlds) * worlds[0].limits.shape[0]
        given = wp.array(worlds, dtype=Arrays, device=device)
        rows = [(b, *family) for b, families in enumerate(lines) for family in families]
        families = wp.array(np.array(rows, dtype=np.int32), dtype=wp.vec4i, device=device)
        factors = wp.zeros(bodies, dtype=int, device=device)
        self._saved, self._rejects = saved, wp.zeros(1, dtype=int, device=device)
        wide = {"dim": bodies * block, "block_dim": block, "device": device, "record_cmd": True}
        before = [saved.part(name) for name in ("positions", "velocities", "recoveries")]
        self._open = wp.launch(open_frames, inputs=[given, families, factors, int(second), block], **wide)
        inputs = [given, families, *before, factors, self._rejects, int(second), block]
        self._judge = wp.launch(judge_frames, inputs=inputs, **wide)
        inputs = [given, factors, self._rejects]
        self._begin_again = wp.launch(begin_again, dim=bodies, inputs=inputs, device=device, record_cmd=True)

    def open(self) -> None:
        """Find the energies at the start of a frame, before the state is saved."""
        self._open.launch()

    def judge(self, frame: Callable[[], None]) -> None:
        """Judge the frame that ended, and compute it again by `frame` as long as it is rejected."""
        self._judge.launch()
        wp.capture_while(self._rejects, self._again, frame=frame)

    def _again(self, frame: Callable[[], None]) -> None:
        self._saved.restore()
        self._begin_again.launch()
        frame()
        self._judge.launch()
