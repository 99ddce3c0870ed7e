# SPDX-License-Identifier: Apache-2.0
"""Where colliders and handles are and will be: a pose wanted by the end of the next frame is a motion through it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import warp as wp

from cloth_sim_ros import parameters as table
from cloth_sim_ros.sim.arrays.live_array import LiveArray
from cloth_sim_ros.sim.input.checks import WorldSelection, check_worlds, worlds_of
from cloth_sim_ros.sim.physics.quaternion import unit_quaternion, unit_quaternions


class Motions(LiveArray):
    """The motions of `rows` things in each of `worlds` worlds, in rows of `struct`, and the poses wanted of them.

    are_still: whether all rest in this frame, and in those to come while nothing is moved.
    """

    def __init__(self, struct, rows: int, worlds: int, device: wp.Device) -> None:
        super().__init__(struct, rows, worlds, device)
        self._moving, self._wanted = (np.zeros((worlds, rows), dtype=bool) for _ in range(2))
        self._position, self._orientation = np.zeros((worlds, rows, 3)), np.zeros((worlds, rows, 4))
        # Bytes in a row to x y z, and then x y z w, at the end of the frame.
        self.pose_offset = np.dtype(struct.numpy_dtype()).fields["end_position"][1]
        self.are_still = True  # all of them: asked every frame, for less than NumPy takes to look

    def reach(self, row: int, world: WorldSelection, name: str, pose: tuple[Any, Any], sweep: bool) -> None:
        """What is called `name` goes to a pose, or to the one of each world: by `move` with `sweep`, else by `place`.
        Raises ValueError."""
        worlds, orientation = len(self._wanted), pose[1]
        place = check_worlds(table.row(table.HANDLE, "position"), pose[0], f"{name}.position", worlds, world)
        if np.ndim(orientation) == 2:
            orientation = unit_quaternions(orientation, f"{name}.orientation", worlds)[worlds_of(world)]
        else:
            orientation = unit_quaternion(orientation, f"{name}.orientation")
        (self.move if sweep else self.place)(row, world, place, orientation)

    def move(self, row: int, world: WorldSelection, position: Sequence[float], orientation: Sequence[float]) -> None:
        """A thing reaches a pose [m], x y z w, at the end of the next frame, in some worlds."""
        worlds = worlds_of(world)
        self._position[worlds, row], self._orientation[worlds, row] = position, orientation
        self._wanted[worlds, row] = True
        self.are_still = False

    def place(self, row: int, world: WorldSelection, position: Sequence[float], orientation: Sequence[float]) -> None:
        """A thing is at a pose at once and was never anywhere else."""
        worlds = worlds_of(world)
        self._wanted[worlds, row] = self._moving[worlds, row] = False
        pose = {"position": position, "orientation": orientation}
        self.write(row, world, **{f"{end}_{part}": value for end in ("start", "end") for part, value in pose.items()})

    def mirrors(self) -> dict[str, np.ndarray]:
        """Beside the rows what moves in this frame, and the poses that are wanted by the end of the next."""
        wanted = {"moving": self._moving, "wanted": self._wanted}
        return {**super().mirrors(), **wanted, "positions": self._position, "orientations": self._orientation}

    def moves(self) -> np.ndarray:
        """Whether any of them moves in this frame, in each world (worlds,)."""
        return self._moving.any(axis=1)

    def touch(self) -> None:
        """See LiveArray; some may move now."""
        super().touch()
        self.are_still = False

    def advance(self) -> None:
        """Begin a frame: what was wanted since the last one begins to move, what has arrived rests."""
        if self.are_still:
            return
        moved = self._moving | self._wanted
        motion, wanted = self.edit(), self._wanted
        for part in ("position", "orientation"):
            motion[f"start_{part}"][moved] = motion[f"end_{part}"][moved]
        goal = self._orientation[wanted]
        backward = (goal * motion["start_orientation"][wanted]).sum(1, keepdims=True) < 0.0
        motion["end_orientation"][wanted] = np.where(backward, -goal, goal)
        motion["end_position"][wanted] = self._position[wanted]
        self._moving, self._wanted = self._wanted, self._moving
        self._wanted[:] = False
        self.are_still = not self._moving.any()


def checked_poses(poses: np.ndarray, name: str) -> np.ndarray:
    """Poses (worlds, 7) of what is called `name`, x y z [m] and a unit x y z w. Raises ValueError."""
    worlds = len(poses)
    places = check_worlds(table.row(table.HANDLE, "position"), poses[:, :3], f"{name}.position", worlds, None)
    return np.column_stack([places, unit_quaternions(poses[:, 3:], f"{name}.orientation", worlds)])
