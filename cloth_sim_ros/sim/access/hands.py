# SPDX-License-Identifier: Apache-2.0
"""Handles between frames: grasp, release and measure loads. grasp/hold.py handles them within a frame."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import warp as wp

from cloth_sim_ros import parameters as table
from cloth_sim_ros.sim.access.loads import Loads
from cloth_sim_ros.sim.arrays.state import Arrays, HandleMotion
from cloth_sim_ros.sim.arrays.writing import clear
from cloth_sim_ros.sim.engine.bodies import Bodies
from cloth_sim_ros.sim.input.checks import WorldSelection, check_worlds, named, names_of, worlds_of
from cloth_sim_ros.sim.kernels.compiled import compiled
from cloth_sim_ros.sim.kernels.intrinsics import load_row, store_row, xyz
from cloth_sim_ros.sim.scene.handles import checked_reach, extents


@compiled
def grasp(given: wp.array(dtype=Arrays), b: int, h: int, chosen: wp.array(dtype=int), count: int):
    arrays = given[chosen[wp.tid() / count]]
    s = arrays.state
    g = arrays.model.bodies[b].particles + wp.tid() % count
    position = load_row(s.positions, g)
    if position[3] == 0.0 or load_row(s.grasp.grips, g)[3] > 0.0:
        return
    handle = arrays.handles[h]
    offset = (xyz(position) - handle.end_position) + xyz(load_row(s.position_lo, g))
    place = wp.quat_rotate_inv(handle.end_orientation, offset)
    size, far = wp.abs(place), wp.length(place)
    if size[0] <= handle.reach[0] and size[1] <= handle.reach[1] and size[2] <= handle.reach[2]:
        if far <= handle.reach[3]:
            store_row(s.grasp.grips, g, wp.vec4(place[0], place[1], place[2], float(h + 1)))
            store_row(s.grasp.grip_pulls, g, wp.vec4(0.0))
            store_row(s.grasp.grip_forces, g, wp.vec4(0.0))
            wp.atomic_add(s.grasp.held, b, 1)
            wp.atomic_add(arrays.handle_counts, h, 1)


@compiled
def let_go(given: wp.array(dtype=Arrays), b: int, leaves: wp.array2d(dtype=int), count: int):
    w = wp.tid() / count
    arrays = given[w]
    s = arrays.state
    g = arrays.model.bodies[b].particles + wp.tid() % count
    h = int(load_row(s.grasp.grips, g)[3]) - 1
    if h >= 0:
        if leaves[w, h] > 0:
            store_row(s.grasp.grips, g, wp.vec4(0.0))
            store_row(s.grasp.grip_forces, g, wp.vec4(0.0))
            wp.atomic_sub(s.grasp.held, b, 1)
            wp.atomic_sub(arrays.handle_counts, h, 1)


@compiled
def find_broken(
    handles: wp.array2d(dtype=HandleMotion),
    loads: wp.array2d(dtype=wp.spatial_vector),
    leaves: wp.array2d(dtype=int),
    breaks: wp.array2d(dtype=int),
):
    w, h = wp.tid()
    most = handles[w, h].break_force
    broken = most > 0.0 and wp.length(wp.spatial_top(loads[w, h])) > most
    leaves[w, h] = wp.where(broken, 1, 0)
    breaks[w, h] += leaves[w, h]


class Hands:
    """The handles of a simulation. Raises ValueError for a name, a world or a value that is not allowed."""

    _bodies: Bodies
    _loads: dict[str, Loads]  # forces and torques on "colliders" and "handles"
    _leaves: wp.array  # (worlds, H) int, nonzero for handles that let go now

    def _write_handles(self) -> None:
        """Write all handles as the scene describes them."""
        for name, handle in self._bodies.scene.handles.items():
            self._place_handle(name, None)
            numbers = {"compliance": handle.compliance, "break_force": handle.break_force}
            self._write_handle(name, None, reach=extents(handle.reach), **numbers)

    def _write_handle(self, name: str, world: WorldSelection, **numbers: Any) -> None:
        self._bodies.handles.write(self._handle(name), world, **numbers)

    def _place_handle(self, name: str, world: WorldSelection) -> None:
        """Put a handle at its pose in the scene."""
        handle = self._bodies.scene.handles[name]
        self._bodies.handles.place(self._bodies.handle_row[name], world, handle.position, handle.orientation)

    def set_handle_pose(
        self, name: str, position: Any, orientation: Any = (0.0, 0.0, 0.0, 1.0), sweep: bool = True, world: Any = None
    ) -> None:
        """Move a handle, and the particles it holds, to a pose.

        Args:
            name: The handle.
            position: (3,) [m], or an array whose first axis is all worlds.
            orientation: Quaternion (4,) x y z w, or an array whose first axis is all worlds.
            sweep: If True, the handle reaches the pose at the end of the next frame. If False, it is there at once:
                for placing an empty handle, as a jump would tear along the particles it holds.
            world: The number of a world, a mask (worlds,) of bool, or None for all.

        Raises:
            ValueError: There is no such handle, or the pose is not allowed.
        """
        some = self._bodies.some(world)
        self._bodies.handles.reach(self._handle(name), some, name, (position, orientation), sweep)

    def _set_handle(self, name: str, field: str, value: Any, world: WorldSelection) -> None:
        """Set a live parameter of a handle; `attached` grasps or releases."""
        try:
            row = table.row(table.HANDLE, field)
        except KeyError:
            live = names_of(row.name for row in table.HANDLE if row.live)
            raise ValueError(f"there is no parameter '{name}.{field}'; allowed is one of {live}") from None
        where = f"{name}.{field}"
        if field == "reach":
            self._write_handle(name, world, reach=extents(checked_reach(value, where)))
            return
        value = check_worlds(row, value, where, self._bodies.worlds, world)
        if field == "attached":
            (self._grasp if value else self._let_go)(name, world)
        elif field == "object":
            if value not in ("", *self._bodies.scene.objects):
                raise ValueError(
                    f"{where} is {value!r}; allowed is '' or one of {names_of(self._bodies.scene.objects)}"
                )
            self._bodies.grasps[name] = value
        elif field in ("compliance", "break_force"):
            self._write_handle(name, world, **{field: value})
        else:
            raise ValueError(f"{where} is not set while running; allowed is set_handle_pose")

    def attach(self, name: str, world: Any = None) -> int | np.ndarray:
        """Grasp the free particles within reach of a handle; return how many it holds now, see `held`."""
        self._grasp(name, self._bodies.some(world))
        return self.held(name, world)

    def _grasp(self, name: str, some: WorldSelection) -> None:
        h, chosen = self._handle(name), self._bodies.chosen(some)
        self._bodies.wake()
        self._bodies.handles.upload()
        for body, batch in self._bodies.batch.items():
            if self._bodies.grasps[name] in ("", body) and len(chosen):
                b = batch.index[body]
                inputs, dim = [batch.given, b, h, chosen, batch.counts[b]], len(chosen) * batch.counts[b]
                wp.launch(grasp, dim=dim, inputs=inputs, device=batch.device)

    def release(self, name: str, world: Any = None) -> None:
        """Release all particles that a handle holds; they keep their velocities."""
        self._let_go(name, self._bodies.some(world))

    def _let_go(self, name: str, some: WorldSelection) -> None:
        leaves = np.zeros(self._leaves.shape, dtype=np.int32)
        leaves[worlds_of(some), self._handle(name)] = 1
        self._leaves.assign(leaves)
        self._bodies.wake()
        self._let_chosen_go()

    def held(self, name: str, world: Any = None) -> int | np.ndarray:
        """Number of particles that a handle holds: in one world, or in each of several (None: all)."""
        h, some = self._handle(name), self._bodies.some(world)
        counts = self._bodies.handle_counts.numpy()[worlds_of(some), h]
        return int(counts[0]) if isinstance(some, int) or self._bodies.worlds == 1 else counts.copy()

    def broken(self, name: str, world: int = 0) -> int:
        """Number of times a handle let go because its load exceeded its break_force."""
        return int(self._bodies.handle_breaks.numpy()[self._bodies.one(world), self._handle(name)])

    def handle_position(self, name: str, world: int = 0) -> np.ndarray:
        """Position (3,) [m] of a handle at the end of the last frame."""
        return self._bodies.handles.read(self._handle(name), self._bodies.one(world))["end_position"][0].copy()

    def handle_wrench(self, name: str, world: int = 0) -> tuple[np.ndarray, np.ndarray]:
        """Force (3,) [N] and torque (3,) [N m] on a handle about its origin, in world axes, mean over the last frame.

        The weight of a cloth that hangs from the handle points down.
        """
        load = self.handle_wrenches(world)[self._handle(name)].astype(np.float64)
        return load[:3], load[3:]

    def handle_wrenches(self, world: int = 0) -> np.ndarray:
        """Wrenches of all handles (H, 6) float32: force [N], then torque [N m], see `handle_wrench`."""
        return self._loads["handles"].read(world)

    @property
    def _ending(self) -> Callable[[], None] | None:
        """Function to launch at the end of a frame, which releases overloaded handles; None if none can break."""
        breaks = (self._bodies.handles.mirrors()["rows"]["break_force"] > 0.0).any()
        return self._let_overloaded_go if breaks else None

    def _let_overloaded_go(self) -> None:
        bodies, loads = self._bodies, self._loads["handles"].measure()
        inputs = [bodies.handles.array, loads, self._leaves, bodies.handle_breaks]
        wp.launch(find_broken, dim=self._leaves.shape, inputs=inputs, device=bodies.warp_device)
        self._let_chosen_go()

    def _reset_handles(self, some: WorldSelection) -> None:
        """Put handles back to their poses in the scene; attached ones grasp again.

        The objects must have been reset before, so that nothing holds them.
        """
        if not self._bodies.scene.handles:
            return
        counts = self._bodies.handle_counts
        clear(counts, slice(0, counts.shape[1]), self._bodies.chosen(some))
        for name, handle in self._bodies.scene.handles.items():
            self._place_handle(name, some)
            if handle.attached:
                self._grasp(name, some)

    def _take_over_grasps(self, name: str, other: Hands) -> None:
        """Let handles hold an object, in all worlds, as handles of the same names do in another simulation.

        The first world of the other simulation counts.
        """
        theirs = other._bodies
        renamed = np.zeros(1 + len(theirs.handle_row), dtype=np.float32)
        for handle, row in theirs.handle_row.items():
            renamed[1 + row] = 1 + self._bodies.handle_row.get(handle, -1)
        rows = theirs.batch[name].read_rows("grips", name)[0]
        rows[:, 3] = renamed[rows[:, 3].astype(int)]
        self._bodies.batch[name].write_rows("grips", name, rows)
        self._bodies.wake()
        self._count_held()

    def _count_held(self) -> None:
        """Recount the held particles of each handle and of each body in every world."""
        counts = np.zeros(self._bodies.handle_counts.shape, dtype=np.int32)
        for name, batch in self._bodies.batch.items():
            numbers = batch.read_rows("grips", name)[..., 3].astype(int)
            batch.write_count("held", name, (numbers > 0).sum(axis=1))
            for h in range(counts.shape[1]):
                counts[:, h] += (numbers == h + 1).sum(axis=1)
        self._bodies.handle_counts.assign(counts)

    def _handle(self, name: str) -> int:
        return named(self._bodies.handle_row, name, "handle")

    def _let_chosen_go(self) -> None:
        for name, batch in self._bodies.batch.items():
            b, device = batch.index[name], batch.device
            dim = self._bodies.worlds * batch.counts[b]
            wp.launch(let_go, dim=dim, inputs=[batch.given, b, self._leaves, batch.counts[b]], device=device)
