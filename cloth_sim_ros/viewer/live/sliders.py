# SPDX-License-Identifier: Apache-2.0
"""Sliders made of a node's parameter descriptors."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import viser
from rcl_interfaces.msg import ParameterDescriptor

WIND = 15.0  # [m/s] at most by slider, as a descriptor of a list has no range
_WIDE = 1e3  # a range whose ends are further apart is shown by powers of ten
_SMALLEST = 1e-8  # of such a range that begins at 0: the leftmost place is 0 itself
_STEP = 0.05  # of a power of ten


@dataclass(frozen=True)
class Scale:
    """Where on a slider a value lies: from `low` to `high`, straight or, with `powers`, by powers of ten.

    floor: the smallest power that has a place of its own; what is below it is `low`, at the left end.
    """

    low: float
    high: float
    whole: bool = False
    powers: bool = False
    floor: float = 0.0

    @property
    def ends(self) -> tuple[float, float, float]:
        """Ends of the slider, and its step."""
        if self.powers:
            return math.log10(self.floor) - (_STEP if self.low < self.floor else 0.0), math.log10(self.high), _STEP
        if self.whole:
            return int(self.low), int(self.high), 1
        return self.low, self.high, (self.high - self.low) / 200.0

    @property
    def marks(self) -> tuple[tuple[float, str], ...] | None:
        """Words below the slider at some of its places."""
        if not self.powers:
            return None
        left, right, _ = self.ends
        powers = range(math.ceil((left + 1) / 4) * 4, math.floor(right) + 1, 4)
        end = ((left, f"{self.low:g}"),) if self.low < self.floor else ()
        return (*end, *((power, f"1e{power}" if abs(power) > 2 else f"{10.0**power:g}") for power in powers))

    def place(self, value: float) -> float:
        """Where `value` lies on the slider."""
        left, right, _ = self.ends
        if self.powers:
            value = math.log10(value) if value >= self.floor else left
        return min(max(value, left), right)

    def value(self, place: float) -> float:
        """The value that lies there."""
        if self.whole:
            return round(place)
        if not self.powers:
            return min(max(place, self.low), self.high)
        if self.low < self.floor and place < math.log10(self.floor) - 0.5 * _STEP:
            return self.low
        return min(max(float(f"{10.0**place:.3g}"), self.low), self.high)


def scale_of(descriptor: ParameterDescriptor, value: Any) -> Scale | None:
    """The scale of a number with this descriptor, which is `value` now; None where the descriptor has no range."""
    if descriptor.integer_range:
        found = descriptor.integer_range[0]
        return Scale(found.from_value, found.to_value, whole=True)
    if not descriptor.floating_point_range:
        return None
    low, high = descriptor.floating_point_range[0].from_value, descriptor.floating_point_range[0].to_value
    if low < 0.0 or high <= (_WIDE if low == 0.0 else _WIDE * low) and high <= 100.0:
        return Scale(low, high)
    smallest = min(_SMALLEST, value / 100.0) if value > 0.0 else _SMALLEST
    return Scale(low, high, powers=True, floor=max(low, smallest))


class ParameterSlider:
    """One number of the parameter `name`; of a list that at `index`.

    `wanted` is what somebody has set in the browser since it was last shown or asked for.
    """

    def __init__(self, gui: viser.GuiApi, label: str, scale: Scale, value: float, hint: str):
        self._label, self._scale, self._unit = label, scale, _unit(hint)
        low, high, step = scale.ends
        self._slider = gui.add_slider(
            self._words(value), low, high, step, scale.place(value), hint=hint, marks=scale.marks
        )
        self._seen = self._slider.value

    def wanted(self) -> float | None:
        """The value that somebody has chosen since, or None."""
        place = self._slider.value
        if place == self._seen:
            return None
        self._seen = place
        value = self._scale.value(place)
        self._slider.label = self._words(value)
        return value

    def show(self, value: float) -> None:
        """The node has this value."""
        self._slider.value = self._scale.place(value)
        self._seen = self._slider.value
        self._slider.label = self._words(value)

    def slide(self, value: float) -> None:
        """Puts the slider to a value, as a browser does."""
        self._slider.value = self._scale.place(value)

    def _words(self, value: float) -> str:
        return f"{self._label}  {value:.3g}{self._unit}" if self._scale.powers else f"{self._label}{self._unit}"


def _unit(text: str) -> str:
    """The unit in brackets in a description, with a space before it; "" where it has two."""
    start, end = text.rfind("["), text.rfind("]")
    return f" {text[start + 1 : end]}" if 0 <= start < end and " or " not in text[start:end] else ""
