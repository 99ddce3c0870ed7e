# SPDX-License-Identifier: Apache-2.0
"""The device to compute on."""

from __future__ import annotations

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
