# SPDX-License-Identifier: Apache-2.0
"""A copy of the state of a batch, for frames that are computed more than once."""

from __future__ import annotations

from collections.abc import Mapping

import warp as wp


class Saved:
    """A copy of the buffer `state`, which holds the arrays `parts` by name."""

    def __init__(self, state: wp.array, parts: Mapping[str, wp.array]) -> None:
        self.device = state.device
        self._state, self._copy, self._parts = state, wp.empty_like(state), parts

    def save(self) -> None:
        """Copy the state."""
        wp.copy(self._copy, self._state)

    def restore(self) -> None:
        """Go back to the copied state."""
        wp.copy(self._state, self._copy)

    def part(self, name: str) -> wp.array:
        """The copy of an array of the state."""
        array = self._parts[name]
        place = self._copy.ptr + array.ptr - self._state.ptr
        found = wp.array(ptr=place, shape=array.shape, dtype=array.dtype, device=self.device)
        found._ref = self._copy
        return found
