# SPDX-License-Identifier: Apache-2.0
"""What shapes that three numbers do not describe have on a device, and how arrays in their descriptions are kept."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from typing import Any
from weakref import WeakValueDictionary

import numpy as np
import warp as wp


class OnDevice:
    """Arrays whose first has the address `id`; they live as long as this does."""

    def __init__(self, first: wp.array, *others: Any) -> None:
        self.id, self._kept = first.ptr, (first, *others)


_made: WeakValueDictionary[tuple[str, str], OnDevice] = WeakValueDictionary()


def shared(content: str, device: wp.Device, make: Callable[[], OnDevice]) -> OnDevice:
    """What `make` makes, once for all colliders of the same `content` on a device, in however many simulations."""
    found = _made.get((content, device.alias))
    if found is None:
        found = _made[content, device.alias] = make()
    return found


def content_of(*arrays: np.ndarray) -> str:
    """A hash of the numbers in arrays: what two descriptions with the same have in common."""
    found = hashlib.sha256()
    for array in arrays:
        found.update(f"{array.shape} {array.dtype.str};".encode())
        found.update(np.ascontiguousarray(array).tobytes())
    return found.hexdigest()[:16]
