# SPDX-License-Identifier: Apache-2.0
"""Constraints between any two particles of an object, such as a tether, a strut or a spring.

A constraint is a class of named numbers with a Warp function, its law. Other packages add theirs to `CONSTRAINTS`
(docs/how-to/extending.md).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np
import warp as wp

from cloth_sim_ros.parameters import shown
from cloth_sim_ros.sim.input.numbers import Described, Numbers


class Constraint(Described):
    """A constraint on the distance of particles of `object`, for each pair of `between` (n, 2), or 2 n numbers.

    law: takes the distance [m], that at rest [m] and its Numbers. It returns the nearest distance that is allowed [m],
    and the compliance [m/N] (vec2), 0 for rigid. Raises ValueError for a value that is not allowed.
    """

    law: ClassVar[wp.Function]

    def __init__(self, object: str, between: Sequence[Any], **values: Any) -> None:
        super().__init__(**values)
        pairs = np.array(between).reshape(-1, 2) if np.size(between) % 2 == 0 else np.zeros((0, 2))
        if not len(pairs) or pairs.dtype.kind not in "iu" or pairs.min() < 0 or (pairs[:, 0] == pairs[:, 1]).any():
            given = f"{type(self).__name__}.between is {shown(between)}"
            raise ValueError(f"{given}; allowed are pairs of two particles each")
        self.object, self.between = object, tuple(map(tuple, pairs.tolist()))


CONSTRAINTS: dict[str, type[Constraint]] = {}


def make_law(names: Sequence[str]):
    """Make a Warp function (kind, distance, rest, numbers) -> the law's vec2; kind: an index in `names`."""
    law = _free
    for kind, name in enumerate(names):
        law = _or(law, kind, name)
    return law


@wp.func
def _free(kind: int, distance: float, rest: float, numbers: Numbers) -> wp.vec2:
    return wp.vec2(distance, 0.0)


def _or(others, index: int, name: str):
    of_kind = CONSTRAINTS[name].law

    def law(kind: int, distance: float, rest: float, numbers: Numbers) -> wp.vec2:
        if kind == wp.static(index):
            return of_kind(distance, rest, numbers)
        return others(kind, distance, rest, numbers)

    return wp.func(law, name=f"law_{index}_{name}")
