# SPDX-License-Identifier: Apache-2.0
"""Queries of ropes alone: tension, loads on the supports of their ends, twist and winches."""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

from cloth_sim_ros import parameters as table
from cloth_sim_ros.sim.access.queries import Queries
from cloth_sim_ros.sim.access.tension import Tensions
from cloth_sim_ros.sim.access.wrench import EndWrenches
from cloth_sim_ros.sim.engine.batch import Batch
from cloth_sim_ros.sim.input.checks import WorldSelection, check_worlds
from cloth_sim_ros.sim.scene.objects import Rope, check_lengths
from cloth_sim_ros.sim.topology.rope import directors as carried

_WINCH = tuple(row.name for row in table.WINCH if row.live)


class Ropes(Queries):
    """Reads and writes quantities that only ropes have."""

    # Tensions of all worlds, valid for this number of builds.
    _pulls: dict[str, tuple[Tensions, wp.array]]
    _builds_of_pulls: int

    def _drum(self, name: str, world: int) -> int:
        """Index of a rope's first segment that is off the drum."""
        batch = self._bodies.batch[name]
        return int(batch.read_body("winches", name, world)["index"][0, 0]) if batch.features.winch else 0

    def tensions(self, name: str, world: int = 0) -> np.ndarray:
        """Tensions (S,) float32 [N] of a rope's segments at the end of the last substep in one world.

        Rigid segments have tensions too. A tension is below 0 for a compressed segment, and 0 for a segment on a winch.
        Raises ValueError for a cloth.
        """
        out = wp.zeros((len(self._bodies.topology(name).masses), 1), dtype=float, device=self._bodies.warp_device)
        self.tensions_into(out, 0, name, world).launch()
        return out.numpy()[:-1, 0].copy()

    def tensions_into(self, out: wp.array, column: int, name: str, world: int = 0) -> Tensions:
        """Return an object whose launch() writes the tensions of a rope into a column of a device array.

        Args:
            out: (N, columns) float on the device, one row per particle.
            column: The column to write.
            name: The rope.
            world: The number of the world.

        Returns:
            A Tensions, valid until `builds` changes.

        Raises:
            ValueError: The object is a cloth.
        """
        return Tensions(self._rope_batch(name), name, self._bodies.one(world), out.reshape((1, *out.shape)), column)

    def _tensions_of_all(self, name: str) -> wp.array:
        """Tensions (worlds, S) float [N], on the device. Raises ValueError for a cloth."""
        batch = self._rope_batch(name)
        if self._builds_of_pulls != self._bodies.builds:
            self._pulls, self._builds_of_pulls = {}, self._bodies.builds
        if name not in self._pulls:
            count = len(self._bodies.topology(name).masses)
            out = wp.zeros((self._bodies.worlds, count, 1), dtype=float, device=batch.device)
            self._pulls[name] = Tensions(batch, name, None, out), out
        tensions, out = self._pulls[name]
        tensions.launch()
        return out[:, :-1, 0]

    def directors(self, name: str, world: int | None = 0) -> np.ndarray:
        """Unit vectors (S, 3) float64 across a rope's segments, which turn with its material, in one world.

        They are those of the last substep, (worlds, S, 3) in all worlds for None. Raises ValueError if the object does
        not resist twist.
        """
        if getattr(self._bodies.scene.objects.get(name), "twist_compliance", None) is None:
            raise ValueError(f"{name} does not resist twist; allowed is a rope with twist_compliance")
        batch, world = self._bodies.batch[name], None if world is None else self._bodies.one(world)
        points = self.positions(name, world).astype(np.float64)
        angles = batch.part("twisted", batch.segments(name), world).numpy()["angle"].reshape(*points.shape[:-2], -1)
        start = batch.read_body("twists", name, world)["start"].reshape(*points.shape[:-2], 3)
        return _directors(points, angles[..., : points.shape[-2] - 1].astype(np.float64), start.astype(np.float64))

    def end_wrenches(self, name: str, world: int = 0) -> np.ndarray:
        """Loads (2, 6) float32 of a rope on the supports of its start and its end, in one world.

        Each row is force [N], then torque [N m] about the end particle, in world axes. All particles held from an end
        on count, with their weight. With a clamp of two particles the torque is the clamping moment. A free end has no
        load. Raises ValueError for a cloth.
        """
        out = wp.zeros((2, 6), dtype=float, device=self._bodies.warp_device)
        self.end_wrenches_into(out, name, world).launch()
        return out.numpy().copy()

    def end_wrenches_into(self, out: wp.array, name: str, world: int = 0) -> EndWrenches:
        """Return an object that writes the end wrenches of a rope into a device array (2, 6) float.

        It is valid until `builds` changes. Raises ValueError for a cloth.
        """
        return EndWrenches(self._rope_batch(name), name, self._bodies.one(world), out)

    def _rope_batch(self, name: str) -> Batch:
        """The batch of a rope. Raises ValueError for a cloth."""
        self._bodies.topology(name)
        if not isinstance(self._bodies.scene.objects[name], Rope):
            raise ValueError(f"{name} is a cloth, which has no tension along it and no ends; allowed is a rope")
        return self._bodies.batch[name]

    def _measure_rope(self, name: str, thing: Rope, world: int) -> dict[str, float]:
        """Return the part of `report` that only ropes have."""
        pull = self.tensions(name, world)
        found = {
            "max_tension": float(pull.max()),
            "start_tension": float(pull[self._drum(name, world)]),
            "end_tension": float(pull[-1]),
        }
        if thing.winch is not None:
            winch = self._bodies.batch[name].read_body("winches", name, world)[0, 0]
            found["paid_out"] = float(winch["behind"] + winch["length"] + winch["backlog"])
            found["pay_out"] = float(winch["rate"])
            found["winch_stopped"] = int(winch["stopped"])
        if thing.twist_compliance is not None:
            twist = self._bodies.batch[name].read_body("twists", name, world)[0, 0]
            found |= {"twist": float(twist["angle"]), "torsion": float(twist["moment"])}
        return found

    def _write_rope(self, name: str, thing: Rope) -> None:
        """Write the scene's live numbers of a rope in all worlds."""
        batch = self._bodies.batch[name]
        if thing.winch is not None:
            numbers = {field: getattr(thing.winch, field) for field in _WINCH}
            batch.drives.write(batch.index[name], None, **numbers)
        if thing.twist_compliance is not None:
            batch.ends.write(batch.index[name], None, turn=thing.end_turn)
            self._write_turns(name, "rest_turns", self._bodies.topology(name).rest_turns, None)

    def _write_turns(self, name: str, what: str, turns: np.ndarray, mask: Any) -> None:
        """Write "rest_turns" (S - 1, 2) [-] or "lags" (S,) [rad] of a rope, or a row a world; see `Tensors.write`."""
        if not np.isfinite(turns).all():
            raise ValueError(f"{name} {what} hold a number that is not finite; allowed are finite numbers")
        batch = self._bodies.batch[name]
        part = batch.part("rest_turns" if what == "rest_turns" else "twisted", batch.segments(name), None)
        rows = part.numpy()
        # What lags goes to where the material was a substep before, as none lies behind.
        into = rows if what == "rest_turns" else rows["couple"][..., 0]
        some = slice(None) if mask is None else self._bodies.some(mask)
        shape = np.shape(turns)[1 - into.ndim :]  # of one world
        into[some, : shape[0]] = np.broadcast_to(turns, (len(rows), *shape))[some]
        part.assign(rows)

    def _set_winch(self, owner: str, row: table.Parameter, name: str, value: Any, world: WorldSelection) -> None:
        if getattr(self._bodies.scene.objects[owner], "winch", None) is None:
            raise ValueError(f"{name} is set but {owner} was built without; allowed is a rope built with a winch")
        value = check_worlds(row, value, name, self._bodies.worlds, world)
        batch = self._bodies.batch[owner]
        b = batch.index[owner]
        lengths = batch.drives.read(b, world)
        if row.name in ("shortest", "longest"):
            lengths[row.name] = value
            for k in np.flatnonzero(lengths["shortest"] > lengths["longest"])[:1]:
                check_lengths(float(lengths["shortest"][k]), float(lengths["longest"][k]), f"{owner}.winch.shortest")
        batch.drives.write(b, world, **{row.name: value})


def _directors(points: np.ndarray, angles: np.ndarray, start: np.ndarray) -> np.ndarray:
    """Unit vectors (..., S, 3) across the segments of a rope, which turn with its material.

    points (..., N, 3) [m]; angles (..., S) of the material about each segment [rad]; start (..., 3) of its Twist.
    Parallel transport carries the start's vector along the rope. Then each vector turns by its angle.
    """
    tangents = np.diff(points, axis=-2)
    tangents /= np.linalg.norm(tangents, axis=-1, keepdims=True)
    u = carried(tangents, start)
    return np.cos(angles)[..., None] * u + np.sin(angles)[..., None] * np.cross(tangents, u)
