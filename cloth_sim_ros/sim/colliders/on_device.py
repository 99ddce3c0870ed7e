# SPDX-License-Identifier: Apache-2.0
"""Device data of shapes that three numbers do not describe, shared between colliders of equal content."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from typing import Any
from weakref import WeakValueDictionary

import numpy as np
import warp as wp


class OnDevice:
    """Device arrays kept alive by this object; `id` is the address of the first."""

    def __init__(self, first: wp.array, *others: Any) -> None:
        self.id, self._kept = first.ptr, (first, *others)


_made: WeakValueDictionary[tuple[str, str], OnDevice] = WeakValueDictionary()


def shared(content: str, device: wp.Device, make: Callable[[], OnDevice]) -> OnDevice:
    """Return the result of `make`, shared by all colliders of equal `content` on a device, across simulations."""
    found = _made.get((content, device.alias))
    if found is None:
        found = _made[content, device.alias] = make()
    return found


def content_of(*arrays: np.ndarray) -> str:
    """A hash of the numbers in arrays, equal for descriptions with equal numbers."""
    found = hashlib.sha256()
    for array in arrays:
        found.update(f"{array.shape} {array.dtype.str};".encode())
        found.update(np.ascontiguousarray(array).tobytes())
    return found.hexdigest()[:16]
