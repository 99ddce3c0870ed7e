# SPDX-License-Identifier: Apache-2.0
"""Numbers of a description in the order of its rows in a table: one after another, of an array element by element.

`Described` is the base of forces and constraints, whose numbers kernels read as `Numbers`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np
import warp as wp

from cloth_sim_ros import parameters as table
from cloth_sim_ros.parameters import Parameter

MOST_NUMBERS = 16
Numbers = wp.types.vector(length=MOST_NUMBERS, dtype=float)


@wp.struct
class NumbersRow:
    """The numbers of one force or constraint in one world."""

    values: Numbers


def places(rows: Sequence[Parameter]) -> dict[str, int | slice]:
    """Name of each row -> index or slice of its numbers."""
    found, first = {}, 0
    for row in rows:
        found[row.name] = slice(first, first + row.length) if row.length else first
        first += row.length or 1
    return found


def numbers_of(thing: Any, rows: Sequence[Parameter]) -> list[float]:
    """The fields of `thing` that have `rows`, as numbers."""
    return [float(number) for row in rows for number in np.atleast_1d(getattr(thing, row.name))]


def fields_of(rows: Sequence[Parameter], numbers: Sequence[Any]) -> dict[str, Any]:
    """Name of each row -> its number, or tuple of numbers."""
    each = places(rows).items()
    return {name: tuple(numbers[place]) if isinstance(place, slice) else numbers[place] for name, place in each}


class Described:
    """A description by named numbers, live and different in each world; `rows` are their parameters.

    A Warp function gets them in one vector `Numbers`, in the order of `rows`. Raises ValueError for a name or a value
    that is not allowed.
    """

    rows: ClassVar[tuple[Parameter, ...]] = ()

    def __init_subclass__(cls) -> None:
        cls.rows = tuple(replace(row, live=True) for row in cls.rows)

    def __init__(self, **values: Any) -> None:
        kind, names = type(self).__name__, [row.name for row in self.rows]
        for name in values.keys() - set(names):
            raise ValueError(f"{kind} is given {name}; allowed is {', '.join(names) or 'nothing'}")
        for row in self.rows:
            setattr(self, row.name, table.check(row, values.get(row.name, row.default), f"{kind}.{row.name}"))
        if len(numbers_of(self, self.rows)) > MOST_NUMBERS:
            raise ValueError(f"{kind} has {len(numbers_of(self, self.rows))} numbers; allowed are {MOST_NUMBERS}")

    def numbers(self) -> np.ndarray:
        """Its numbers (MOST_NUMBERS,), 0 behind the last."""
        found = np.zeros(MOST_NUMBERS)
        given = numbers_of(self, self.rows)
        found[: len(given)] = given
        return found

    def __repr__(self) -> str:
        return f"{type(self).__name__}({', '.join(f'{name}={value!r}' for name, value in vars(self).items())})"
