# SPDX-License-Identifier: Apache-2.0
"""Frames of all objects that are alike, as one graph of the device."""

from collections.abc import Callable, Hashable

import warp as wp

LONGEST = 10  # frames in a graph
_KEPT = 8  # graphs at a time


class Frames:
    """Runs frames that are alike: the host has nothing to do in them but to launch the same."""

    def __init__(self, device: wp.Device) -> None:
        self._device = device
        self._graphs: dict[tuple[Hashable, ...], wp.Graph] = {}

    def run(self, frames: int, launch: Callable[[], None], *told: Hashable) -> None:
        """So many frames, at most LONGEST; told: on what it depends what `launch` launches.

        For the first time they run launch by launch, which loads what they need, and are captured for the next time.
        """
        key = (frames, *told)
        if key in self._graphs:
            wp.capture_launch(self._graphs[key])
            return
        for _ in range(frames):
            launch()
        with wp.ScopedCapture(device=self._device) as capture:
            for _ in range(frames):
                launch()
        if len(self._graphs) == _KEPT:
            self._graphs.pop(next(iter(self._graphs)))
        self._graphs[key] = capture.graph
