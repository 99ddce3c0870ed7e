# SPDX-License-Identifier: Apache-2.0
"""Springs and other elements of one kind."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

KINDS = ("structural", "shear", "bending")


@dataclass(frozen=True)
class Elements:
    """Constraints of one kind: particles (E, k), rest (E,), scale (E,) of the compliance."""

    particles: np.ndarray
    rest: np.ndarray
    scale: np.ndarray


def numbers_of(pairs: np.ndarray, wanted: np.ndarray, count: int) -> np.ndarray:
    """Numbers (...) of those of `pairs` (E, 2) that join `wanted` (..., 2) of `count` particles, -1 for none."""
    known, keys = (each.min(axis=-1).astype(np.int64) * count + each.max(axis=-1) for each in (pairs, wanted))
    order = np.argsort(known)
    found = order[np.minimum(np.searchsorted(known[order], keys), len(known) - 1)]
    return np.where(known[found] == keys, found, -1)
