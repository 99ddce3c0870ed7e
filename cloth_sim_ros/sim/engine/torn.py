# SPDX-License-Identifier: Apache-2.0
"""Failed springs of a batch's sheets, read and written by the host."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import warp as wp

from cloth_sim_ros.sim.arrays import writing
from cloth_sim_ros.sim.arrays.model import Features, Model
from cloth_sim_ros.sim.arrays.model_arrays import ModelArrays
from cloth_sim_ros.sim.arrays.state import Arrays
from cloth_sim_ros.sim.features.tearing.arrays import LEFT
from cloth_sim_ros.sim.features.tearing.tear import GONE, followers
from cloth_sim_ros.sim.input.checks import WorldSelection, worlds_of
from cloth_sim_ros.sim.kernels.compiled import compiled
from cloth_sim_ros.sim.program import make_begin

_THREADS = 4096  # threads per world of a launch over the elements that may fail with a spring, on a GPU


@lru_cache
def _make_follow(features: Features, number: int):
    """Make the kernel of one stage in which triangles and bending fail after their springs."""
    begin, stage = make_begin(features), followers(features)[number]

    @compiled(module="unique")
    def follow(worlds: wp.array(dtype=Arrays), b: int, width: int):
        w = wp.tid() / width
        stage(wp.tid() - w * width, width, begin(worlds[w], b))

    return follow


class Torn:
    """Springs of the bodies of a batch, by kind and number as in Topology.springs; bodies by their number b.

    given: the Arrays of each world.
    """

    def __init__(
        self,
        features: Features,
        states: dict[str, wp.array],
        given: wp.array,
        model: Model,
        arrays: ModelArrays,
        device: wp.Device,
    ) -> None:
        self._features, self._states, self._slots, self._device = features, states, arrays.spring_slots, device
        self._whole = {name: getattr(model, name).numpy() for name in LEFT}
        self._given = given
        self.mend(wp.array(np.arange(len(given)), dtype=int, device=device))

    def mend(self, chosen: wp.array) -> None:
        """Make all bodies whole in the worlds of these numbers."""
        for name, values in self._whole.items():
            if len(values):
                writing.put(self._states[name], 0, values, chosen)

    def read(self, b: int, world: WorldSelection = None) -> dict[str, np.ndarray]:
        """Kind -> (worlds, S) bool, True for each failed spring of a body, in one world or all."""
        rests = self._states["line_rests"][worlds_of(world)].numpy()
        return {kind: rests[:, slots] < 0.0 for kind, slots in self._slots[b].items()}

    def write(self, b: int, torn: dict[str, np.ndarray]) -> None:
        """Let these springs fail too; (worlds, S) or (1, S) bool per kind."""
        rests = self._states["line_rests"].numpy().copy()
        for kind, failed in torn.items():
            slots = self._slots[b][kind]
            rests[:, slots] = np.where(failed, GONE, rests[:, slots])
        self._states["line_rests"].assign(rests)
        marks = self._states["tearing"].numpy().copy()
        marks[:, b] = 1
        self._states["tearing"].assign(marks)
        for number in range(len(followers(self._features))):
            threads = 1 if self._device.is_cpu else _THREADS
            kernel, inputs = _make_follow(self._features, number), [self._given, b, threads]
            wp.launch(kernel, dim=len(rests) * threads, inputs=inputs, device=self._device)

    def count(self, b: int, world: int) -> int:
        """Number of failed structural and shear springs of a body in a world."""
        return sum(int(failed.sum()) for kind, failed in self.read(b, world).items() if kind != "bending")
