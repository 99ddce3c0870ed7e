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
