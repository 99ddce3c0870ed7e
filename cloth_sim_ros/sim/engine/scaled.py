# SPDX-License-Identifier: Apache-2.0
"""An object whose rest shape has another scale in each world: the arrays that follow from it, one row a world."""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

from cloth_sim_ros.sim.arrays.live_array import LiveArray
from cloth_sim_ros.sim.arrays.model import Body, Model
from cloth_sim_ros.sim.arrays.model_arrays import ModelArrays
from cloth_sim_ros.sim.kernels.compiled import compiled
from cloth_sim_ros.sim.topology import Topology

# Marker in place of a power: the relative rounding error of float32 in the number three columns before.
LOST = wp.constant(9)
# Name in Model -> power of a length in each column. A rope segment's compliance grows with its length. A sheet spring's
# compliance depends only on the shape around it.
_POWERS = {
    "rest": (1, 1, 1), "constraint_rests": (1,), "line_rests": (1,), "line_scales": (0,), "line_bases": (1, 0),
    "segment_length": (1,), "joints": (0, 1, -1, -1),
    "spring_types": (1, 0, 0, LOST), "plate_weights": (-2,), "curve_stencil_gradients": (-1,), "curve_gradients": (-1,),
}  # fmt: skip
_OF_ROPES = {**_POWERS, "line_scales": (1,), "spring_types": (1, -1, 0, LOST)}


@compiled
def scale_rows(
    base: wp.array(dtype=wp.float64),
    powers: wp.array(dtype=int),
    origin: wp.array(dtype=wp.float64),
    scales: wp.array(dtype=wp.float64),
    chosen: wp.array(dtype=int),
    out: wp.array2d(dtype=Any),
):
    """Scale number i of a rest shape in world chosen[k]. origin: fixed point of the scaling, per column."""
    k, i = wp.tid()
    w = chosen[k]
    column = i % powers.shape[0]
    away = base[i] - origin[column]
    if powers[column] == LOST:
        rest = base[i - 3] * scales[w]
        away = wp.where(rest == wp.float64(0.0), rest, wp.float64(1.0) - wp.float64(float(rest)) / rest)
    else:
        away *= wp.pow(scales[w], wp.float64(powers[column]))
    out[w, i] = out.dtype(origin[column] + away)


for _number in (wp.float32, wp.float64):  # both at once, so that the module is compiled once
    wp.overload(scale_rows, {"out": wp.array2d(dtype=_number)})


class Scaled:
    """Arrays of Model that differ between worlds, for the one body of `arrays`, and its rest shape in each world.

    own: name in Model -> arrays with a row per world. rest, layout: (worlds, N, 3) float64 [m], as in Topology.
    """

    def __init__(self, topology: Topology, arrays: ModelArrays, device: wp.Device) -> None:
        self._scales, self._body, self._device, self._parts = topology.world_scales, arrays.bodies[0], device, []
        self._bodies = LiveArray(Body, 1, len(self._scales), device)
        self._bodies.write(0, None, **self._body)
        is_rope, ctx = self._body["is_rope"], np.zeros(3)
        self.rest = self._add(topology.rest, (1, 1, 1), topology.origin, wp.float64)
        self.layout = self._add(topology.layout, (1, 1, 1), topology.layout[0] if is_rope else ctx, wp.float64)
        self.own = {"bodies": self._bodies.array}
        for name, powers in (_OF_ROPES if is_rope else _POWERS).items():
            rows = arrays.joined(name)
            if len(rows):
                origin = topology.origin if name == "rest" else np.zeros(len(powers))
                self.own[name] = self._add(rows, powers, origin, Model.vars[name].type.dtype)
        self.write(wp.array(np.arange(len(self._scales)), dtype=int, device=device))

    def _add(self, base: np.ndarray, powers: tuple[int, ...], origin: np.ndarray, dtype: type) -> wp.array:
        """Allocate an array of `dtype` for the scaled `base` of each world."""
        number = wp.float64 if dtype == wp.float64 else wp.float32
        shape = (len(self._scales), *(base.shape if dtype == number else base.shape[:1]))
        out = wp.zeros(shape, dtype=dtype, device=self._device)
        flat = wp.array(ptr=out.ptr, shape=(len(out), base.size), dtype=number, device=self._device)
        given = ((base.ravel(), wp.float64), (powers, int), (origin, wp.float64))
        self._parts.append((*(wp.array(rows, dtype=each, device=self._device) for rows, each in given), flat, out))
        return out

    def write(self, chosen: wp.array) -> None:
        """Apply Topology.world_scales on the device, in worlds of these numbers."""
        lengths = {name: self._body[name] * self._scales for name in ("spacing", "gap")}
        self._bodies.write(0, None, plate_rate=self._body["plate_rate"] / self._scales**2, **lengths)
        self._bodies.upload()
        scales = wp.array(self._scales, dtype=wp.float64, device=self._device)
        for *given, flat, _ in self._parts:
            dim = (len(chosen), flat.shape[1])
            wp.launch(scale_rows, dim=dim, inputs=[*given, scales, chosen, flat], device=self._device)


def at_scales(topology: Topology, rows: np.ndarray, scales: np.ndarray) -> np.ndarray:
    """Return rows (k,) of Material with which the unscaled `topology` has the frequencies it has at `scales`."""
    rows = rows.copy()
    if topology.plate is not None:
        rows["compliance"][:, 2] *= scales**2
    elif not len(topology.triangles):
        rows["compliance"][:, 0] *= scales
    return rows
