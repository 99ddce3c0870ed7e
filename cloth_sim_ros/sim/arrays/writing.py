# SPDX-License-Identifier: Apache-2.0
"""Writing state on the device, in chosen worlds only: particles, and clearing of arrays."""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

from cloth_sim_ros.sim.features.winch.arrays import WinchState
from cloth_sim_ros.sim.kernels.compiled import compiled


@compiled
def put_positions(
    values: wp.array3d(dtype=Any),
    inverse_mass: wp.array2d(dtype=float),
    chosen: wp.array(dtype=int),
    winches: wp.array2d(dtype=WinchState),
    b: int,
    positions: wp.array2d(dtype=wp.vec4),
    good_positions: wp.array2d(dtype=wp.vec4),
    lo: wp.array2d(dtype=wp.vec4),
):
    """Write particle i of body b in world chosen[k]; particles on a drum are held at the first particle's position."""
    k, i = wp.tid()
    w = chosen[k]
    source = int(i)
    inverse = float(inverse_mass[w, i])
    if winches.shape[1] > 0:
        if i <= winches[w, b].index:
            source = int(0)
            inverse = float(0.0)
    row = wp.where(values.shape[0] == 1, 0, w)
    high = wp.vec4(0.0, 0.0, 0.0, inverse)
    lost = wp.vec4(0.0)
    for c in range(3):
        value = wp.float64(values[row, source, c])
        high[c] = float(value)
        lost[c] = float(value - wp.float64(high[c]))
    positions[w, i] = high
    good_positions[w, i] = high
    lo[w, i] = lost


@compiled
def place(
    points: wp.array3d(dtype=wp.float64),
    poses: wp.array2d(dtype=wp.float64),
    chosen: wp.array(dtype=int),
    values: wp.array3d(dtype=wp.float64),
):
    """Transform point i from the axes of a pose of world chosen[k] to world axes.

    points: (worlds, N, 3), or (1, N, 3) for all. poses: x y z, then a unit quaternion x y z w.
    """
    k, i = wp.tid()
    w = chosen[k]
    row = wp.where(points.shape[0] == 1, 0, w)
    point = wp.vec3d(points[row, i, 0], points[row, i, 1], points[row, i, 2])
    turned = wp.quat_rotate(wp.quatd(poses[w, 3], poses[w, 4], poses[w, 5], poses[w, 6]), point)
    for c in range(3):
        values[w, i, c] = poses[w, c] + turned[c]


@compiled
def put_velocities(
    values: wp.array3d(dtype=Any),
    inverse_mass: wp.array2d(dtype=float),
    chosen: wp.array(dtype=int),
    velocities: wp.array2d(dtype=wp.vec4),
):
    k, i = wp.tid()
    row = wp.where(values.shape[0] == 1, 0, chosen[k])
    v = wp.vec4(0.0)
    if inverse_mass[chosen[k], i] > 0.0:
        for c in range(3):
            v[c] = float(values[row, i, c])
    velocities[chosen[k], i] = v


@compiled
def put_words(
    words: wp.array2d(dtype=wp.uint32), first: int, values: wp.array(dtype=wp.uint32), chosen: wp.array(dtype=int)
):
    k, i = wp.tid()
    words[chosen[k], first + i] = values[i]


@compiled
def clear_words(words: wp.array2d(dtype=wp.uint32), first: int, chosen: wp.array(dtype=int)):
    k, i = wp.tid()
    words[chosen[k], first + i] = wp.uint32(0)


@compiled
def find_bad(values: wp.array3d(dtype=Any), limit: float, chosen: wp.array(dtype=int), bad: wp.array(dtype=int)):
    """Set `bad` if a number is beyond the limit or not finite; the comparison is written to catch NaN."""
    k, i = wp.tid()
    for c in range(3):
        if not (wp.abs(float(values[chosen[k], i, c])) <= limit):
            bad[0] = 1


for _number in (wp.float32, wp.float64):  # all at once, so that the module is compiled once
    for _kernel in (put_positions, put_velocities, find_bad):
        wp.overload(_kernel, {"values": wp.array3d(dtype=_number)})


def are_bad(values: wp.array, limit: float, chosen: wp.array) -> bool:
    """True if rows (worlds, N, 3) of the chosen worlds hold a number not finite or beyond the limit; waits."""
    bad = wp.zeros(1, dtype=int, device=values.device)
    dim = (len(chosen), values.shape[1])
    wp.launch(find_bad, dim=dim, inputs=[values, limit, chosen, bad], device=values.device)
    return bool(bad.numpy()[0])


def view_of(
    owner: wp.array, place: int, shape: tuple[int, ...], dtype: type, strides: tuple[int, ...] | None = None
) -> wp.array:
    """View of the memory of an array from an address on, which keeps it. strides [bytes]: None is contiguous."""
    view = wp.array(ptr=place, shape=shape, strides=strides, dtype=dtype, device=owner.device)
    view._ref = owner
    return view


def words_of(rows: wp.array) -> wp.array:
    """View (worlds, words) of a contiguous, not empty array (worlds, size) of any type."""
    return view_of(rows, rows.ptr, (rows.shape[0], rows.strides[0] // 4), wp.uint32)


def clear(rows: wp.array, span: slice, chosen: wp.array) -> None:
    """Zero elements `span` of an array (worlds, size) in the chosen worlds."""
    size = wp.types.type_size_in_bytes(rows.dtype) // 4
    dim = (len(chosen), size * (span.stop - span.start))
    if dim[0] and dim[1]:
        inputs = [words_of(rows), size * span.start, chosen]
        wp.launch(clear_words, dim=dim, inputs=inputs, device=rows.device)


def put(rows: wp.array, first: int, values: np.ndarray, chosen: wp.array) -> None:
    """Write `values` (n,) to elements from `first` on of an array (worlds, size), in each of the chosen worlds."""
    size = wp.types.type_size_in_bytes(rows.dtype) // 4
    words = wp.array(np.ascontiguousarray(values).view(np.uint32).ravel(), dtype=wp.uint32, device=rows.device)
    if len(chosen):
        inputs = [words_of(rows), size * first, words, chosen]
        wp.launch(put_words, dim=(len(chosen), len(words)), inputs=inputs, device=rows.device)
