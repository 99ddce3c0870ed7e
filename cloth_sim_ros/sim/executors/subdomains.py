# SPDX-License-Identifier: Apache-2.0
"""Method verlet on a whole GPU: a body is cut into subdomains, and a block advances its subdomain by several substeps
at a time.

A block loads its subdomain into its shared memory, with a halo of as many rings as it will make substeps. It advances
what is still valid, one ring fewer every substep, and hands its own particles to its neighbours. What they need in
between is computed twice instead of waited for (temporal blocking). Every particle's arithmetic is the same, in the
same order, however a body is cut. Where all subdomains are on the GPU at once, a frame is one launch. In it subdomains
wait for what their neighbours send (halo_exchange.py). Elsewhere it is a launch every few substeps, between two
buffers. A body of one subdomain has no halo and makes all substeps of a frame in one launch. Slow forces at outer steps
look farther than springs and use up as many rings more.
"""

import numpy as np
import warp as wp

from cloth_sim_ros.sim.executors.subdomain_forces import Widths
from cloth_sim_ros.sim.executors.subdomain_kernels import make_kernels
from cloth_sim_ros.sim.executors.subdomain_plan import plan, upload
from cloth_sim_ros.sim.model import Features
from cloth_sim_ros.sim.state import Arrays, gathered


class Subdomains:
    """The launches of one batch. `advance()` simulates one frame of every body in every world of it.

    layouts: rest positions (N, 3) of every body in local axes. size: particles of a subdomain. depth: substeps for
    which a halo lasts. waits: whether subdomains wait for one another within a launch. What is None is chosen. Raises
    subdomains.Unfit where subdomains cannot serve the batch.
    """

    def __init__(
        self,
        features: Features,
        worlds: list[Arrays],
        layouts: list[np.ndarray],
        device: wp.Device,
        size: int | None = None,
        depth: int | None = None,
        waits: bool | None = None,
    ):
        self._device, self._given = device, gathered(worlds, device)
        model = worlds[0].model
        self._bodies = len(worlds) * model.bodies.shape[0]
        chosen = plan(features, model, layouts, len(worlds), device, size, depth, waits)
        self.depth, self.waits = chosen.depth, chosen.waits
        self._subdomains = upload(chosen, worlds, features, device)
        self._count = len(worlds) * self._subdomains.body.shape[0]
        self._block = 1 if device.is_cpu else chosen.threads
        first = chosen.around[0]
        self._reach = max(each.reach for each in chosen.around)
        widths = Widths(first.types.shape[1], first.corners.shape[1], first.plate.shape[1], self._reach)
        self._kernels = make_kernels(features, chosen.capacity, self._block, widths, chosen.waits)

    def advance(self, substeps: int, iterations: int, outer: int) -> None:
        """Launch one frame."""
        turns = [(0, substeps)] if self.waits else launches(substeps, outer, self.depth, self._reach)
        for turn, (first, count) in enumerate(turns):
            self._launch("advance", turn % 2, first, count, self.depth)
        self._launch("settle", len(turns) % 2, substeps)
        wp.launch(self._kernels["count_faults"], dim=self._bodies, inputs=[self._given], device=self._device)

    def _launch(self, name: str, *numbers: int) -> None:
        wp.launch(
            self._kernels[name],
            dim=self._count * self._block,
            inputs=[self._given, self._subdomains, *numbers],
            device=self._device,
            block_dim=self._block,
        )


def launches(substeps: int, outer: int, depth: int, reach: int) -> list[tuple[int, int]]:
    """The first substep of every launch of a frame and how many it makes, where `depth` rings last for each.

    A substep uses up one of them, and slow forces `reach`, which act before each of `outer` steps and at the end.
    """
    slow = {j * substeps // outer for j in range(outer + 1)} if reach else set()
    found, left = [(0, 0)], depth
    for k in range(substeps + 1):
        rings = (reach if k in slow else 0) + (1 if k < substeps else 0)
        if rings > left:
            found.append((k, 0))
            left = depth
        left -= rings
        if k < substeps:
            found[-1] = found[-1][0], found[-1][1] + 1
    return found
