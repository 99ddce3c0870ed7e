# SPDX-License-Identifier: Apache-2.0
"""Poses of colliders and handles: a pose wanted at the end of the next frame becomes a motion through that frame.

Wanted poses are points of a smooth path. A frame begins with the velocity v at which the one before ended, so that none
jumps. It ends with the mean of two estimates: 2 d - v by its own displacement d, and (3 d - d_b) / 2 by that of the
frame before, d_b. Both are exact under constant acceleration. The first alone would swing for ever after a change of
acceleration, and the second sees it late. From rest it is 2 d. A frame ends where it is wanted, so no pose is late.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import warp as wp

from cloth_sim_ros import parameters as table
from cloth_sim_ros.sim.arrays.live_array import LiveArray
from cloth_sim_ros.sim.input.checks import WorldSelection, check_worlds, worlds_of
from cloth_sim_ros.sim.physics.quaternion import quaternion_product, unit_quaternion, unit_quaternions

# Accelerations [m/s^2], [rad/s^2] beyond which velocities jump: nothing follows such a collider by friction anyway.
_STEEPEST = np.array([20.0, 100.0])[:, None, None]
_ENDS = ("start_position", "end_position", "start_orientation", "end_orientation")


class Motions(LiveArray):
    """Motions of `rows` colliders or handles in each of `worlds` worlds, in rows of `struct`, and their wanted poses.

    are_still: True if all rest in this frame, and no motion is wanted.
    """

    def __init__(self, struct, rows: int, worlds: int, device: wp.Device) -> None:
        super().__init__(struct, rows, worlds, device)
        self._moving, self._wanted = (np.zeros((worlds, rows), dtype=bool) for _ in range(2))
        self._position, self._orientation = np.zeros((worlds, rows, 3)), np.zeros((worlds, rows, 4))
        # Offset in a row [bytes] of the pose at the end of the frame: x y z, then x y z w.
        self.pose_offset = np.dtype(struct.numpy_dtype()).fields["end_position"][1]
        self.are_still = True  # a flag, as it is read every frame and NumPy would take longer

    def reach(self, row: int, world: WorldSelection, name: str, pose: tuple[Any, Any], sweep: bool) -> None:
        """Check a pose, or one per world, and apply it: by `move` with `sweep`, else by `place`.

        name: used in messages. Raises ValueError.
        """
        worlds, orientation = len(self._wanted), pose[1]
        place = check_worlds(table.row(table.HANDLE, "position"), pose[0], f"{name}.position", worlds, world)
        if np.ndim(orientation) == 2:
            orientation = unit_quaternions(orientation, f"{name}.orientation", worlds)[worlds_of(world)]
        else:
            orientation = unit_quaternion(orientation, f"{name}.orientation")
        (self.move if sweep else self.place)(row, world, place, orientation)

    def move(self, row: int, world: WorldSelection, position: Sequence[float], orientation: Sequence[float]) -> None:
        """Let a row reach a pose [m], x y z w, at the end of the next frame, in some worlds."""
        worlds = worlds_of(world)
        self._position[worlds, row], self._orientation[worlds, row] = position, orientation
        self._wanted[worlds, row] = True
        self.are_still = False

    def place(self, row: int, world: WorldSelection, position: Sequence[float], orientation: Sequence[float]) -> None:
        """Put a row at a pose at once, without a motion."""
        worlds = worlds_of(world)
        self._wanted[worlds, row] = self._moving[worlds, row] = False
        pose = {"position": position, "orientation": orientation}
        self.write(row, world, **{f"{end}_{part}": value for end in ("start", "end") for part, value in pose.items()})
        self.write(row, world, bends=0)

    def mirrors(self) -> dict[str, np.ndarray]:
        """The rows, flags of those that move in this frame, and the poses wanted at the end of the next."""
        wanted = {"moving": self._moving, "wanted": self._wanted}
        return {**super().mirrors(), **wanted, "positions": self._position, "orientations": self._orientation}

    def moves(self) -> np.ndarray:
        """(worlds,) bool: True in worlds where any row moves in this frame."""
        return self._moving.any(axis=1)

    def touch(self) -> None:
        """See LiveArray; any row may move afterwards."""
        super().touch()
        self.are_still = False

    def advance(self, frame_dt: float) -> None:
        """Begin a frame of `frame_dt` [s]: rows with a new wanted pose start to move, and rows that arrived rest."""
        if self.are_still:
            return
        moved = self._moving | self._wanted
        motion, wanted = self.edit(), self._wanted
        last, bends = [motion[field][wanted] for field in _ENDS], motion["bends"][wanted]
        motion["bends"][moved] = 0
        for part in ("position", "orientation"):
            motion[f"start_{part}"][moved] = motion[f"end_{part}"][moved]
        goal = self._orientation[wanted]
        backward = (goal * motion["start_orientation"][wanted]).sum(1, keepdims=True) < 0.0
        motion["end_orientation"][wanted] = np.where(backward, -goal, goal)
        motion["end_position"][wanted] = self._position[wanted]
        # All in few calls, as NumPy takes longer to be called than to compute so few rows.
        coming = [motion[field][wanted] for field in _ENDS]
        found = _displacements(*(np.concatenate(each, dtype=np.float64) for each in zip(last, coming, strict=True)))
        before, now = found[:, : len(bends)], found[:, len(bends) :]
        left = before - np.stack([bends["end"], bends["end_turn"]])
        starts, ends = _bends(now, before, left, _STEEPEST * frame_dt**2)
        for part, start, end in zip(("", "_turn"), starts, ends, strict=True):
            motion["bends"][f"start{part}"][wanted], motion["bends"][f"end{part}"][wanted] = start, end
        self._moving, self._wanted = self._wanted, self._moving
        self._wanted[:] = False
        self.are_still = not self._moving.any()


def _displacements(start: np.ndarray, end: np.ndarray, start_turn: np.ndarray, end_turn: np.ndarray) -> np.ndarray:
    """Displacements [m], then rotation vectors [rad], (2, k, 3) of k rows in their frame, in world axes.

    start, end: positions (k, 3) [m]. start_turn, end_turn: quaternions (k, 4) x y z w.
    """
    turn = quaternion_product(end_turn, start_turn * (-1.0, -1.0, -1.0, 1.0))
    turn *= np.where(turn[:, 3:] < 0.0, -1.0, 1.0)
    sine = np.linalg.norm(turn[:, :3], axis=1, keepdims=True)
    angle = 2.0 * np.arctan2(sine, turn[:, 3:])
    turned = turn[:, :3] * np.divide(angle, sine, out=np.full_like(sine, 2.0), where=sine > 0.0)
    turned[(start_turn == end_turn).all(axis=1)] = 0.0
    return np.stack([end - start, turned])


def _bends(now: np.ndarray, before: np.ndarray, left: np.ndarray, most: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Bends (2, k, 3) at the start and the end of a frame, see physics/path.py; 0 for rows that rest, or jump.

    now, before: displacements of this frame and of the one before. left: velocity in which that ended, in displacements
    a frame. most: change of displacement beyond which velocities jump.
    """
    rested = (before == 0.0).all(axis=-1, keepdims=True)
    arrived = np.where(rested, 2.0 * now, 0.5 * (2.0 * now - left) + 0.25 * (3.0 * now - before))
    change = np.linalg.norm(np.where(rested, 2.0 * now, now - before), axis=-1, keepdims=True)
    smooth = (change <= most) & (now != 0.0).any(axis=-1, keepdims=True)
    return np.where(smooth, left - now, 0.0), np.where(smooth, now - arrived, 0.0)


def checked_poses(poses: np.ndarray, name: str) -> np.ndarray:
    """Check poses (worlds, 7), x y z [m] then x y z w, and normalize their quaternions.

    name: used in messages. Raises ValueError.
    """
    worlds = len(poses)
    places = check_worlds(table.row(table.HANDLE, "position"), poses[:, :3], f"{name}.position", worlds, None)
    return np.column_stack([places, unit_quaternions(poses[:, 3:], f"{name}.orientation", worlds)])
