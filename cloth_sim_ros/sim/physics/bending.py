# SPDX-License-Identifier: Apache-2.0
"""Bending of ropes: the turn between two segments."""

import warp as wp


@wp.func
def wrap_angle(angle: float) -> float:
    """The angle in (-pi, pi]: a fold through pi is followed the short way."""
    return angle - 2.0 * wp.pi * wp.round(angle / (2.0 * wp.pi))
