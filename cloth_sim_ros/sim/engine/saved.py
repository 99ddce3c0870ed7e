# SPDX-License-Identifier: Apache-2.0
"""A copy of the state of a batch, for frames that are computed more than once."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import warp as wp

from cloth_sim_ros.sim.arrays.writing import view_of
from cloth_sim_ros.sim.features.collider_contact.arrays import BY_COLLIDER, words_of

_MANY = 0.25  # share of colliders from which on it is faster to copy all than those listed alone


class Saved:
    """A copy of the buffer `state`, which holds the arrays `parts` by name.

    colliders: their number if bodies list those near them (see broad_phase.py), else 0. A CPU then copies what the
    listed ones did alone, as most of a state is of colliders, and clears what others did in a frame that is undone.
    """

    def __init__(self, state: wp.array, parts: Mapping[str, wp.array], colliders: int = 0) -> None:
        self.device = state.device
        self._state, self._copy, self._parts = state, wp.empty_like(state), parts
        self._colliders = colliders if state.device.is_cpu else 0
        self._kept = np.ones(self._colliders, dtype=bool)  # colliders whose part was copied
        self._plain, self._tables = self._views() if self._colliders else ([], [])

    def save(self) -> None:
        """Copy the state."""
        if self._colliders:
            self._kept = self._listed()
        if self._kept.all():
            wp.copy(self._copy, self._state)
            return
        for state, copy in self._plain:
            copy[:] = state
        for state, copy in self._tables:
            for c in np.flatnonzero(self._kept):
                copy[:, c] = state[:, c]

    def restore(self) -> None:
        """Go back to the copied state."""
        if self._kept.all():
            wp.copy(self._state, self._copy)
            return
        met = self._listed() & ~self._kept
        for state, copy in self._plain:
            state[:] = copy
        for state, copy in self._tables:
            for c in np.flatnonzero(self._kept):
                state[:, c] = copy[:, c]
            for c in np.flatnonzero(met):
                state[:, c] = np.zeros((), state.dtype)

    def part(self, name: str) -> wp.array:
        """The copy of an array of the state."""
        array = self._parts[name]
        place = self._copy.ptr + array.ptr - self._state.ptr
        return view_of(self._copy, place, array.shape, array.dtype)

    def _listed(self) -> np.ndarray:
        """(K,) bool: colliders that any body lists; all of them where they are many."""
        words = self._parts["near"].numpy().reshape(-1, words_of(self._colliders))
        bits = np.unpackbits(np.bitwise_or.reduce(words, axis=0).view(np.uint8), bitorder="little")
        listed = bits[: self._colliders].astype(bool)
        return listed if listed.mean() < _MANY else np.ones_like(listed)

    def _views(self) -> tuple[list, list]:
        """State and copy of the tables with a column a collider, and of the bytes between them."""
        whole = self._state.numpy(), self._copy.numpy()
        plain, tables, end = [], [], 0
        for array in sorted((self._parts[name] for name in BY_COLLIDER), key=lambda array: array.ptr):
            begin, size = array.ptr - self._state.ptr, array.size * wp.types.type_size_in_bytes(array.dtype)
            if size:
                row = f"V{wp.types.type_size_in_bytes(array.dtype)}"
                plain.append([each[end:begin] for each in whole])
                tables.append([each[begin : begin + size].view(row).reshape(-1, self._colliders) for each in whole])
                end = begin + size
        return [*plain, [each[end:] for each in whole]], tables
