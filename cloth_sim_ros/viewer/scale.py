# SPDX-License-Identifier: Apache-2.0
"""Mapping of a number to a slider, linear or by powers of ten; and a slider by powers of ten."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass

import viser

Told = Callable[[str], None]  # takes a sentence for the page

_STEP = 0.05  # of a power of ten
_TYPING = 45  # looks, of 60 a second, after the last key before what was typed counts


@dataclass(frozen=True)
class Scale:
    """Mapping of values from `low` to `high` to a slider, linear or, with `powers`, by powers of ten.

    floor: the smallest power that has a place of its own; smaller values become `low`, at the left end.
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
        """Texts below the slider at some of its places."""
        if not self.powers:
            return None
        left, right, _ = self.ends
        end = ((left, f"{self.low:g}"),) if self.low < self.floor else ()
        apart = next(each for each in (1, 2, 4) if right - left <= 4 * each or each == 4)
        first = left + 1 if end else left  # so that no word lies on another
        powers = range(math.ceil(first / apart) * apart, math.floor(right) + 1, apart)
        return (*end, *((power, f"1e{power}" if abs(power) > 2 else f"{10.0**power:g}") for power in powers))

    def place(self, value: float) -> float:
        """Return the place of `value` on the slider."""
        left, right, _ = self.ends
        if self.powers:
            value = math.log10(value) if value >= self.floor else left
        return min(max(value, left), right)

    def value(self, place: float) -> float:
        """Return the value at `place`."""
        if self.whole:
            return round(place)
        if not self.powers:
            return self.nearest(place)
        if self.low < self.floor and place < math.log10(self.floor) - 0.5 * _STEP:
            return self.low
        return self.nearest(float(f"{10.0**place:.3g}"))

    def nearest(self, value: float, told: Told = lambda sentence: None) -> float:
        """Return the value of the range next to one that was typed; `told` gets a sentence if that is another one."""
        near = min(max(value, self.low), self.high)
        if near != value:
            told(f"{value:g} is typed; allowed is {self.low:g} to {self.high:g}, and {near:g} is taken.")
        return near


def powers(low: float, high: float) -> Scale:
    """Return a scale from `low`, above 0, to `high` by powers of ten."""
    return Scale(low, high, powers=True, floor=low)


class PowerSlider:
    """A number on a slider by powers of ten. A box above it shows the number with its unit, and takes another one.

    told: gets a sentence if what is typed is beyond the scale.
    """

    def __init__(self, gui: viser.GuiApi, label: str, scale: Scale, value: float, unit: str, hint: str, told: Told):
        self._scale, self._unit, self._told = scale, unit, told
        self._box = gui.add_text(label, self._words(value), hint=hint)
        place = scale.place(value)
        # The slider of one number has a box of its own, which would show the exponent.
        self._slider = gui.add_multi_slider("", *scale.ends, (place,), marks=scale.marks)
        self._value, self._place = value, place
        self._typed, self._looks = "", 0

    @property
    def value(self) -> float:
        """The number. Read it in every frame: typed text counts once no key is pressed for a while."""
        (place,) = self._slider.value
        if place != self._place:  # which stays where the mouse holds it
            self._value, self._place, self._looks = self._scale.value(place), place, 0
            self._box.value = self._words(self._value)
        elif self._box.value != self._words(self._value):
            self._looks = self._looks + 1 if self._box.value == self._typed else 0
            self._typed = self._box.value
            if self._looks > _TYPING:
                self.value = self._read(self._typed)
        return self._value

    @value.setter
    def value(self, value: float) -> None:
        self._value, self._place, self._looks = value, self._scale.place(value), 0
        self._slider.value, self._box.value = (self._place,), self._words(value)

    def slide(self, value: float) -> None:
        """Move the slider to a value, as a browser does."""
        self._slider.value = (self._scale.place(value),)

    def type(self, text: str) -> None:
        """Put text into the box, as a browser does."""
        self._box.value = text

    def _read(self, text: str) -> float:
        """Return the number at the start of the text, clipped to the range; the current value if there is none."""
        found = re.match(r"\s*[-+]?(\d+\.?\d*|\.\d+)(e[-+]?\d+)?", text, flags=re.IGNORECASE)
        return self._scale.nearest(float(found[0]), self._told) if found else self._value

    def _words(self, value: float) -> str:
        number = float(f"{value:.3g}")
        plain = f"{number:.0f}" if 1e3 <= number < 1e7 else f"{number:g}".replace("e+", "e")
        return f"{plain}{self._unit}"
