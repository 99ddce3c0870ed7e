# SPDX-License-Identifier: Apache-2.0
"""All worlds at once: views of the state on the device, and writing it, with the world as first axis."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import warp as wp

from cloth_sim_ros.sim.access.loads import Loads
from cloth_sim_ros.sim.access.rope_queries import Ropes
from cloth_sim_ros.sim.arrays.poses import Motions, checked_poses
from cloth_sim_ros.sim.arrays.writing import are_bad, view_of
from cloth_sim_ros.sim.input.checks import names_of, on_host
from cloth_sim_ros.sim.kernels.compiled import compiled
from cloth_sim_ros.sim.scene.objects import Rope

MOST = {"positions": 1e6, "velocities": 1e6}  # largest number that can be written [m], [m/s]
_OF_OBJECTS, _OF_POSES = (*MOST, "contact_forces", "recoveries"), ("pose", "wrench")
_OF_TWIST = ("rest_turns", "lags")


@compiled
def add_contacts(pushes: wp.array2d(dtype=wp.vec4), first: int, colliders: int, out: wp.array3d(dtype=float)):
    """Sum the contact forces of all colliders on each particle from `first` on."""
    w, i = wp.tid()
    total = wp.vec4(0.0)
    for k in range(colliders):
        total += pushes[w, (first + i) * colliders + k]
    for c in range(3):
        out[w, i, c] = total[c]


class Tensors(Ropes):
    """The tensors of a simulation. Raises ValueError for a name, a quantity or an array that is not allowed."""

    _pushes: dict[str, wp.array]  # contact forces (worlds, N, 3) [N], summed over several colliders

    def tensor(self, name: str, what: str) -> wp.array:
        """Return a view of one quantity of an object, collider or handle in all worlds, on the device.

        Objects have:
            "positions": (worlds, N, 3) float32 [m].
            "velocities": (worlds, N, 3) float32 [m/s].
            "contact_forces": (worlds, N, 3) [N], the sum over colliders on each particle, mean over the last frame.
            "recoveries": (worlds,) int32, the number of times the object was put back.
            "tensions": (worlds, S) float32 [N], ropes only, see `tensions`.

        Colliders and handles have:
            "pose": (worlds, 7) float32, position x y z [m], then orientation x y z w.
            "wrench": (worlds, 6) float32, force [N], then torque [N m] about the origin.

        The view shows the state after the last launched frame, on Warp's stream of the device. Tensions, wrenches, and
        contact forces of several colliders are computed by this call and change only with the next one. A tensor goes
        to torch, JAX and CuPy by DLPack; treat it as read-only. It is valid until `builds` changes. Method auto may
        rebuild the arrays when live parameters or positions are set.
        """
        if name in self._bodies.scene.objects:
            rope = isinstance(self._bodies.scene.objects[name], Rope)
            _check_word(name, what, (*_OF_OBJECTS, "tensions") if rope else _OF_OBJECTS)
            if what == "tensions":
                return self._tensions_of_all(name)
            if what == "contact_forces":
                return self._contact_forces(name)
            batch = self._bodies.batch[name]
            if what == "recoveries":
                return _view(batch.states[what], 4 * batch.index[name], (), wp.int32)
            rows, span = batch.states[what], batch.span(name)
            return _view(rows, span.start * rows.strides[1], (span.stop - span.start, 3), wp.float32, rows.strides[1])
        motions, row, loads = self._mover(name)
        _check_word(name, what, _OF_POSES)
        if what == "wrench":
            rows = loads.measure()
            return _view(rows, row * rows.strides[1], (6,), wp.float32)
        motions.upload()
        rows = motions.array
        return _view(rows, row * rows.strides[1] + motions.pose_offset, (7,), wp.float32)

    def _contact_forces(self, name: str) -> wp.array:
        """A view of the contact forces of the only collider, or else the sum over all colliders."""
        batch = self._bodies.batch[name]
        rows, span, colliders = batch.states["contact_forces"], batch.span(name), self._bodies.colliders.array.shape[1]
        count = span.stop - span.start
        if colliders == 1:
            return _view(rows, span.start * rows.strides[1], (count, 3), wp.float32, rows.strides[1])
        if name not in self._pushes:
            shape = (self._bodies.worlds, count, 3)
            self._pushes[name] = wp.zeros(shape, dtype=float, device=self._bodies.warp_device)
        if colliders:
            inputs = [rows, span.start, colliders, self._pushes[name]]
            dim = (self._bodies.worlds, count)
            wp.launch(add_contacts, dim=dim, inputs=inputs, device=self._bodies.warp_device)
        return self._pushes[name]

    def write(self, name: str, what: str, array: Any, mask: Any = None, sweep: bool = True) -> None:
        """Write one quantity of an object, collider or handle in many worlds.

        Pinned particles move and stay at rest. History and multipliers of the object are cleared. The call waits for
        the device to check all numbers.

        Args:
            name: The object, collider or handle.
            what: "positions" [m] or "velocities" [m/s] (worlds, N, 3) of an object, or "pose" (worlds, 7) of any. The
                "pose" of an object places its rest shape there, at rest. "rest_turns" [-] (worlds, N - 2, 2) of a rope
                that resists twist: the turn of each joint at rest, along its two directors. "lags" [rad] (worlds,
                N - 1) of one, after positions and velocities: by what its segments are turned about themselves beyond
                their balance as the motion begins, if clamps hold both ends.
            array: An array of NumPy or Warp, or any that DLPack takes; its first axis is all worlds.
            mask: (worlds,) of bool, the worlds to write; None writes all.
            sweep: If True, a collider or handle reaches the pose at the end of the next frame. If False, it is there
                at once.

        Raises:
            ValueError: A name, shape or number is not allowed; nothing changes then.
        """
        some = self._bodies.some(mask)
        if name not in self._bodies.scene.objects:
            motions, row, _ = self._mover(name)
            _check_word(name, what, _OF_POSES[:1])
            poses = self._shaped(_numbers, array, name, what, (7,))
            motions.reach(row, some, name, (poses[:, :3], poses[:, 3:]), sweep)
            return
        if what in _OF_TWIST and getattr(self._bodies.scene.objects[name], "twist_compliance", None) is not None:
            joints = len(self._bodies.topology(name).rest_turns)
            shape = (joints, 2) if what == "rest_turns" else (joints + 1,)
            self._write_turns(name, what, self._shaped(_numbers, array, name, what, shape), mask)
            return
        _check_word(name, what, (*MOST, "pose"))
        if what == "pose":
            poses = checked_poses(self._shaped(_numbers, array, name, what, (7,)), name)
            self._bodies.batch[name].write_pose(name, poses, self._bodies.chosen(some))
            return
        values = self._shaped(self._on_device, array, name, what, (len(self._bodies.topology(name).masses), 3))
        chosen = self._bodies.chosen(some)
        if not len(chosen):
            return
        if are_bad(values, MOST[what], chosen):
            raise ValueError(
                f"{name} {what} hold a number that is not finite or too large; allowed is up to {MOST[what]:g}"
            )
        batch = self._bodies.batch[name]
        (batch.write_positions if what == "positions" else batch.write_velocities)(name, values, chosen)

    def recovered(self) -> np.ndarray:
        """(worlds,) bool: True where an object was put back at the end of the last frame, see `report`."""
        found = np.zeros(self._bodies.worlds, dtype=bool)
        for batch in self._bodies.batches:
            found |= (batch.states["relapses"].numpy() > 0).any(axis=1)
        return found

    def _mover(self, name: str) -> tuple[Motions, int, Loads]:
        """The Motions that hold a collider or handle, its row in them, and their Loads."""
        bodies = self._bodies
        for kind, motions, rows in (
            ("colliders", bodies.colliders, bodies.collider_row),
            ("handles", bodies.handles, bodies.handle_row),
        ):
            if name in rows:
                return motions, rows[name], self._loads[kind]
        known = [*bodies.scene.objects, *bodies.collider_row, *bodies.handle_row]
        raise ValueError(f"there is no object {name!r}, nor a collider or handle; allowed is {names_of(known)}")

    def _on_device(self, array: Any) -> wp.array:
        """Return `array` as float32 or float64 on the simulation's device, without a copy if it is there."""
        device = self._bodies.warp_device
        if not isinstance(array, wp.array):
            array = wp.from_dlpack(array) if _is_foreign(array) else np.asarray(array, dtype=np.float64)
        if isinstance(array, np.ndarray):
            return wp.array(array, dtype=wp.float64, device=device)
        if array.dtype not in (wp.float32, wp.float64):
            array = wp.array(array.numpy(), dtype=wp.float64, device=device)
        return array.to(device)

    def _shaped(self, convert: Callable, array: Any, name: str, what: str, shape: tuple[int, ...]) -> Any:
        wanted = (self._bodies.worlds, *shape)
        try:
            array = convert(array)
        except (TypeError, ValueError):
            raise ValueError(
                f"{name} {what} are {str(array)[:60]!r}; allowed is an array of numbers of shape {wanted}"
            ) from None
        if tuple(array.shape) != wanted:
            raise ValueError(f"{name} {what} have shape {tuple(array.shape)}; allowed is {wanted}, a row a world")
        return array


def _numbers(array: Any) -> np.ndarray:
    return np.asarray(on_host(array), dtype=np.float64)


def _is_foreign(array: Any) -> bool:
    """True if an array is of another library than NumPy and supports DLPack."""
    return hasattr(array, "__dlpack__") and not isinstance(array, np.ndarray)


def _check_word(name: str, what: Any, allowed: tuple[str, ...]) -> None:
    if what not in allowed:
        raise ValueError(f"what is {what!r}; allowed of {name} is {' or '.join(allowed)}")


def _view(rows: wp.array, offset: int, shape: tuple[int, ...], dtype: type, inner: int = 0) -> wp.array:
    """View (worlds, *shape) of `dtype`, from `offset` bytes on in each row of an array.

    inner: stride in bytes of the first axis of a two-dimensional `shape`.
    """
    number = wp.types.type_size_in_bytes(dtype)
    strides = {0: (), 1: (number,), 2: (inner, number)}[len(shape)]
    return view_of(rows, rows.ptr + offset, (rows.shape[0], *shape), dtype, (rows.strides[0], *strides))
