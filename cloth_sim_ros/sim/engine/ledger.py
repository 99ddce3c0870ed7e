# SPDX-License-Identifier: Apache-2.0
"""Frames whose energy is judged: a frame that gains energy is computed again from its start, with more substeps."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import warp as wp

from cloth_sim_ros.sim.engine.saved import Saved
from cloth_sim_ros.sim.kernels.device import call_all
from cloth_sim_ros.sim.substeps.energy import Energies, begin_again, end_again, find_energies, judge_frames, open_frames

_PARTICLES = 1024  # number of particles of a block


class Ledger:
    """Launches that judge the energy of the bodies of a batch, see substeps/energy.py.

    given: the Arrays of each world.
    saved: copy of the state, to which a rejected frame goes back. lines: of each body, (kind, first, end) of the slots
    of its lines. second: True for order 2. block: threads a block. largest: number of particles of the largest body.
    """

    def __init__(
        self,
        given: wp.array,
        saved: Saved,
        lines: Sequence[Sequence[tuple[int, int, int]]],
        second: bool,
        block: int,
        largest: int,
    ) -> None:
        device, bodies = saved.device, len(given) * len(lines)
        rows = [(b, *family) for b, families in enumerate(lines) for family in families]
        families = wp.array(np.array(rows, dtype=np.int32), dtype=wp.vec4i, device=device)
        factors, best = (wp.zeros(bodies, dtype=kind, device=device) for kind in (int, wp.vec2d))
        blocks = 1 if device.is_cpu else -(-largest // _PARTICLES)
        parts = wp.zeros((bodies, blocks), dtype=Energies, device=device)
        self._saved, self._rejects = saved, wp.zeros(1, dtype=int, device=device)
        before = [saved.part(name) for name in ("positions", "velocities", "twists", "recoveries")]

        def launch(kernel: wp.Kernel, *inputs, dim: int = bodies, **more) -> Callable[[], None]:
            return wp.launch(kernel, dim, inputs=[given, *inputs], device=device, record_cmd=True, **more).launch

        wide = {"dim": bodies * blocks * block, "block_dim": block}
        energies = [families, *before[:3]]
        self._open = [
            launch(find_energies, *energies, 1, int(second), block, parts, **wide),
            launch(open_frames, parts, factors, best),
        ]
        self._judge = [
            launch(find_energies, *energies, 0, int(second), block, parts, **wide),
            launch(judge_frames, families, parts, before[3], factors, best, self._rejects),
        ]
        wide = {"dim": bodies * block, "block_dim": block}
        self._begin_again = launch(begin_again, factors, self._rejects, block, **wide)
        self._end_again = launch(end_again, factors, block, **wide)

    def open(self) -> None:
        """Find the energies at the start of a frame, before the state is saved."""
        call_all(self._open)

    def judge(self, frame: Callable[[], None]) -> None:
        """Judge the frame that ended, and compute it again by `frame` as long as it is rejected."""
        call_all(self._judge)
        wp.capture_while(self._rejects, self._again, frame=frame)

    def _again(self, frame: Callable[[], None]) -> None:
        self._saved.restore()
        self._begin_again()
        frame()
        call_all([*self._judge, self._end_again])
