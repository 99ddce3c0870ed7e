# SPDX-License-Identifier: Apache-2.0
"""The device to compute on: find it, allocate memory there, and run what was recorded for it."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import warp as wp


def find_device(name: str) -> wp.Device:
    """The device called `name`; "auto" is the first GPU, or the CPU. Raises ValueError if there is none."""
    if name == "auto":
        name = "cuda:0" if wp.is_cuda_available() else "cpu"
    try:
        return wp.get_device(name)
    except Exception:
        known = ", ".join(device.alias for device in wp.get_devices())
        raise ValueError(f"device is {name!r}; allowed is auto or one of {known}") from None


def allocated(kind: Any, device: wp.Device, **shapes: int | tuple[int, ...]) -> Any:
    """A Warp struct of a kind, whose arrays of these names and shapes hold zeros."""
    struct = kind()
    for name, shape in shapes.items():
        setattr(struct, name, wp.zeros(shape, dtype=kind.vars[name].type.dtype, device=device))
    return struct


def call_all(calls: Iterable[Callable[[], None]]) -> None:
    """Call one after the other, such as `launch` of launches that were recorded."""
    for call in calls:
        call()
