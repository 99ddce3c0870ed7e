# SPDX-License-Identifier: Apache-2.0
"""Sliders made from a node's parameter descriptors."""

from __future__ import annotations

from typing import Any

import viser
from rcl_interfaces.msg import ParameterDescriptor

from cloth_sim_ros.viewer.scale import PowerSlider, Scale, Told

WIND = 15.0  # [m/s] at most by slider, as a descriptor of a list has no range
_WIDE = 1e3  # a range whose ends are further apart is shown by powers of ten
_SMALLEST = 1e-8  # smallest value of such a range that begins at 0; the leftmost place is 0 itself


def scale_of(descriptor: ParameterDescriptor, value: Any) -> Scale | None:
    """Return the scale of a number with this descriptor and the value `value`; None if the descriptor has no range."""
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
    """Slider of one number of a parameter.

    `wanted` is the value set in the browser since the slider was last shown or read. `told` gets a sentence if it was
    typed and is beyond the scale.
    """

    def __init__(self, gui: viser.GuiApi, label: str, scale: Scale, value: float, hint: str, told: Told):
        self._scale, self._told, unit = scale, told, _unit(hint)
        if scale.powers:
            self._slider = PowerSlider(gui, label, scale, value, unit, hint, told)
        else:
            self._slider = gui.add_slider(f"{label}{unit}", *scale.ends, scale.place(value), hint=hint)
        self._seen = self._slider.value

    def wanted(self) -> float | None:
        """Return the value chosen in the browser since the last call, or None."""
        found = self._slider.value
        if found == self._seen:
            return None
        self._seen = found
        return found if self._scale.powers else self._scale.value(self._scale.nearest(found, self._told))

    def show(self, value: float) -> None:
        """Show the node's value."""
        self._slider.value = value if self._scale.powers else self._scale.place(value)
        self._seen = self._slider.value

    def slide(self, value: float) -> None:
        """Move the slider to a value, as a browser does."""
        if self._scale.powers:
            self._slider.slide(value)
        else:
            self._slider.value = self._scale.place(value)


def _unit(text: str) -> str:
    """Return the unit in brackets in a description, after a space; "" if there is none or a choice of two."""
    start, end = text.rfind("["), text.rfind("]")
    return f" {text[start + 1 : end]}" if 0 <= start < end and " or " not in text[start:end] else ""
