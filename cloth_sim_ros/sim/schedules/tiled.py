"""Method verlet on a whole GPU: a body is cut into tiles, and a block advances its tile by several substeps a launch.

A block loads its tile and a halo of as many rings as it will make substeps into its shared memory, advances what is
still valid, one ring fewer every substep, and writes its own particles into the other of two buffers: what neighbours
need is computed twice instead of waited for (temporal blocking). Every particle's arithmetic is the same, in the same
order, however a body is cut. A body of one tile has no halo and makes all substeps of a frame in one launch. The
launches of a frame are captured in one CUDA graph.
"""

import numpy as np
import warp as wp

from cloth_sim_ros.sim.model import Features
from cloth_sim_ros.sim.schedules.buffers import Frames
from cloth_sim_ros.sim.schedules.tile_kernels import make_kernels
from cloth_sim_ros.sim.schedules.tiles import plan, upload
from cloth_sim_ros.sim.state import Arrays, gathered


class Tiled:
    """The launches of one batch. `advance()` simulates one frame of every body in every world of it.

    layouts: rest positions (N, 3) of every body in local axes; size: particles of a tile; depth: substeps of a launch.
    Raises tiles.Unfit where tiles cannot serve the batch.
    """

    def __init__(
        self,
        features: Features,
        worlds: list[Arrays],
        layouts: list[np.ndarray],
        device: wp.Device,
        size: int | None = None,
        depth: int | None = None,
    ):
        self._device, self._given = device, gathered(worlds, device)
        model = worlds[0].model
        self._bodies = len(worlds) * model.bodies.shape[0]
        chosen = plan(features, model, layouts, len(worlds), device, size, depth)
        self.depth = chosen.depth
        self._tiles = upload(chosen, worlds, features, device)
        self._count = len(worlds) * self._tiles.body.shape[0]
        self._block = 1 if device.is_cpu else chosen.capacity
        widths = chosen.around[0].types.shape[1], chosen.around[0].corners.shape[1]
        self._kernels = make_kernels(features, chosen.capacity, self._block, *widths)
        self._frames = Frames(self._launch_frame, device)

    def advance(self, substeps: int, iterations: int) -> None:
        """Launch one frame."""
        self._frames.run(substeps)

    def _launch_frame(self, substeps: int) -> None:
        turns = range(0, substeps, min(self.depth, substeps))
        for turn, first in enumerate(turns):
            count = min(self.depth, substeps - first)
            self._launch("advance", turn % 2, first, count)
        self._launch("settle", len(turns) % 2)
        wp.launch(self._kernels["count_faults"], dim=self._bodies, inputs=[self._given], device=self._device)

    def _launch(self, name: str, *numbers: int) -> None:
        wp.launch(
            self._kernels[name],
            dim=(self._count, self._block),
            inputs=[self._given, self._tiles, *numbers],
            device=self._device,
            block_dim=self._block,
        )
