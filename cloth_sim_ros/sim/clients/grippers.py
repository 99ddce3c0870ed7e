# SPDX-License-Identifier: Apache-2.0
"""Parallel grippers: two boxes that close on an object between them, to an opening or with a force.

A gripper is two ordinary colliders, which its driver moves a little in every frame. So the simulation core does not
know of grippers, and a gripper holds objects by friction alone.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from cloth_sim_ros import parameters as table
from cloth_sim_ros.sim.colliders.box import Box
from cloth_sim_ros.sim.input.checks import check_fields
from cloth_sim_ros.sim.physics.quaternion import Quaternion, Vector, rotate, unit_quaternion
from cloth_sim_ros.sim.simulation import Simulation

_LOG = logging.getLogger(__name__)

SIDES = {"left": 1.0, "right": -1.0}  # finger -> its side along the gripper's y axis
_LOOSE = 0.01  # fraction of the wanted force below which the fingers count as not touching
_MANY = 64  # number of points of contact that bounds the stiffness
_SHARE = 0.5  # fraction of the way to the opening with the wanted force that the fingers go in a frame
_TOLD = 0.05  # relative change of the force from which the opening of first contact can be found
_FEWEST = 0.05  # number of points of contact from which the load on each can be found
_PATIENCE = 20  # frames in which the fingers miss their force before the log says so
_FORGETS = 0.8  # factor of the known stiffness after a frame in which the fingers touch nothing

Pose = tuple[tuple[float, ...], tuple[float, ...]]  # position [m], orientation x y z w


@dataclass(frozen=True)
class Gripper:
    """Two fingers that open along local y, at a pose halfway between their faces.

    finger_size: x y z [m] of each. opening [m]: gap between their faces, at most max_opening. force [N]: above 0, the
    fingers close until each presses with it; at 0 they go to `opening`. speed [m/s]: largest rate of the opening.
    compliance [m/N]: of each point of contact; it is above 0, as the force follows from it. Raises ValueError for a
    value that is not allowed.
    """

    position: Vector = (0.0, 0.0, 0.0)
    orientation: Quaternion = (0.0, 0.0, 0.0, 1.0)
    finger_size: Vector = (0.02, 0.01, 0.04)
    max_opening: float = 0.08
    opening: float = 0.08
    force: float = 0.0
    speed: float = 0.1
    compliance: float = 0.01
    static_friction: float = 0.8
    kinetic_friction: float = 0.8

    def __post_init__(self) -> None:
        check_fields(self, table.GRIPPER)
        self.check_opening(self.opening, "Gripper.opening")

    def check_opening(self, opening: Any, name: str) -> float:
        """An opening [m]. Raises ValueError where it is none, or wider than the gripper opens."""
        opening = table.check(table.row(table.GRIPPER, "opening"), opening, name)
        if opening > self.max_opening:
            raise ValueError(f"{name} is {opening:g}; allowed is at most max_opening, {self.max_opening:g} m")
        return opening

    def fingers(self, name: str) -> dict[str, Box]:
        """The colliders of a gripper called `name`, <name>_left and <name>_right, for Scene.colliders."""
        shape = {field: getattr(self, field) for field in ("compliance", "static_friction", "kinetic_friction")}
        others = [f"{name}_{side}" for side in reversed(SIDES)]
        half = tuple(0.5 * edge for edge in self.finger_size)
        return {
            f"{name}_{side}": Box(
                half_extents=half, position=position, orientation=orientation, **shape, opposite=other
            )
            for (side, (position, orientation)), other in zip(self.poses(self.opening).items(), others, strict=True)
        }

    def poses(self, opening: float) -> dict[str, Pose]:
        """Poses of the fingers at an opening [m], by side."""
        away = 0.5 * (opening + self.finger_size[1])
        offsets = rotate(self.orientation, np.array([(0.0, way * away, 0.0) for way in SIDES.values()]))
        farthest = table.row(table.GRIPPER, "position").high  # where a gripper may be, with a finger beyond it
        places = np.clip(np.asarray(self.position) + offsets, -farthest, farthest)
        return {side: (tuple(place.tolist()), self.orientation) for side, place in zip(SIDES, places, strict=True)}


class GripperDriver:
    """Drives the fingers of a gripper called `name` in one world of a simulation: `advance` before each step.

    opening [m]: current gap between the fingers. speed [m/s]: its last rate of change. felt [N]: force of each finger
    in the last frame. gripper: its pose and targets. load [N]: with which the fingers squeeze each point that both
    touch. squeezes: True if there were any in the last frame.
    """

    def __init__(self, name: str, gripper: Gripper) -> None:
        self.name, self.gripper = name, gripper
        self.opening, self.speed, self.felt = gripper.opening, 0.0, 0.0
        self.load, self.squeezes = 0.0, False
        self._least = 0.0  # the opening at which the fingers are closed on the thinnest object [m]
        self._missed = 0  # frames in which closed fingers missed their force
        self._step = 0.0  # of the opening in the last frame [m]
        self._touched = gripper.opening  # the opening at which the fingers touch what is between them [m]
        self._stiffness = 0.0  # how much the force grows as they close from there [N/m]; 0 is not known
        self._before: tuple[float, float] | None = None  # opening [m] and force [N] of the frame before

    def move(self, position: Any, orientation: Any = (0.0, 0.0, 0.0, 1.0)) -> None:
        """Have the gripper at a pose [m], x y z w, at the end of the next frame."""
        turned = tuple(float(each) for each in unit_quaternion(orientation, f"{self.name}.orientation"))
        position = table.check(table.row(table.GRIPPER, "position"), position, f"{self.name}.position")
        self.gripper = replace(self.gripper, position=position, orientation=turned)

    def open_to(self, opening: float) -> None:
        """Have the fingers go to an opening [m], whatever is between them."""
        self.gripper.check_opening(opening, f"{self.name}.opening")
        self.gripper = replace(self.gripper, opening=opening, force=0.0)

    def press(self, force: float) -> None:
        """Have the fingers close until each presses with a force [N]; with 0 they go to the opening set last."""
        force = table.check(table.row(table.GRIPPER, "force"), force, f"{self.name}.force")
        self.gripper = replace(self.gripper, force=force)

    def set_speed(self, speed: float) -> None:
        """Set the largest speed at which the opening changes [m/s]."""
        self.gripper = replace(self.gripper, speed=speed)

    def measure(self, sim: Simulation, world: int = 0) -> float:
        """Force [N] with which each finger pressed in the last frame: the mean of both."""
        along = rotate(self.gripper.orientation, np.array([(0.0, 1.0, 0.0)]))[0]
        loads = {side: sim.wrench(f"{self.name}_{side}", world)[0] @ along for side in SIDES}
        self.felt = 0.5 * float(sum(way * loads[side] for side, way in SIDES.items()))
        self.squeezes, self._least = sim.is_squeezing(f"{self.name}_left", world), sim.thinnest(world)
        return self.felt

    def poses(self, frame_dt: float) -> dict[str, Pose]:
        """Name of each finger's collider -> wanted pose at the end of the next frame, of length `frame_dt` [s]."""
        most = self.gripper.speed * frame_dt
        self._set_load()
        before = self.opening
        step = float(np.clip(self._wanted() - before, -most, most))
        least = min(self._least, before) if self.gripper.force > 0.0 else 0.0
        self.opening = float(np.clip(before + step, least, self.gripper.max_opening))
        self._step = self.opening - before
        self.speed = self._step / frame_dt
        return self.places()

    def places(self) -> dict[str, Pose]:
        """Name of each finger's collider -> pose at the current opening."""
        return {f"{self.name}_{side}": pose for side, pose in self.gripper.poses(self.opening).items()}

    def _wanted(self) -> float:
        """The opening to go to next: where the force would be right, if it grows evenly from where the fingers touch.

        Openings that a force belongs to are those in the middle of a frame, as forces are means over one.
        """
        at, wanted = self.opening - 0.5 * self._step, self.gripper.force
        if wanted <= 0.0:
            self._touched, self._stiffness, self._before = self.opening, 0.0, None
            return self.gripper.opening
        if self.squeezes:
            self._before = None
            return self.opening
        if self.felt <= _LOOSE * wanted:
            self._touched, self._before = min(self._touched, at), None
            self._stiffness *= _FORGETS  # what it held may be gone
        else:
            self._find_line(at)
        goal = self._touched - wanted / self._stiffness if self._stiffness > 0.0 else self._least
        return self.opening + _SHARE * (goal - self.opening) if self._stiffness > 0.0 else goal

    def _set_load(self) -> None:
        """Find the load on each point between the fingers; the force grows evenly with it, by the number of points."""
        wanted = self.gripper.force
        if not self.squeezes or wanted == 0.0:
            self.load = wanted / _MANY
        elif self.felt > _FEWEST * self.load:
            self.load *= wanted / self.felt
        is_missed = self.opening == self._least and self._step == 0.0 and self.felt < (1.0 - _TOLD) * wanted
        self._missed = self._missed + 1 if is_missed else 0
        if self._missed == _PATIENCE:
            _LOG.warning("%s", self.shortfall)

    @property
    def shortfall(self) -> str:
        """One sentence about why the force is not reached; empty if it is, or may be yet."""
        if self._missed < _PATIENCE:
            return ""
        wanted = self.gripper.force
        return (
            f"{self.name} is closed and presses with {self.felt:.2g} of {wanted:g} N: too little is between its fingers"
        )

    def _find_line(self, at: float) -> None:
        """Fit the line by which the force grows from 0 at first contact to the force felt at an opening [m]."""
        if self._before is not None:
            closed, more = self._before[0] - at, self.felt - self._before[1]
            if closed * more > 0.0 and abs(more) > _TOLD * self.felt:
                self._touched = at + self.felt * closed / more
        # No stiffer than many points: something may have been between them from the start, or moved in between.
        self._touched = max(self._touched, at + self.felt * self.gripper.compliance / _MANY)
        self._before, self._stiffness = (at, self.felt), self.felt / (self._touched - at)

    def squeeze(self, sim: Simulation, world: int = 0) -> None:
        """Give the fingers the load of the next frame, as `poses` found it."""
        sim.squeeze(f"{self.name}_left", self.load, self.opening, world)

    def advance(self, sim: Simulation, world: int = 0) -> None:
        """Move the fingers in the next frame of a simulation whose scene has them."""
        if self.gripper.force > 0.0:
            self.measure(sim, world)
        poses = self.poses(sim.settings.frame_dt)
        self.squeeze(sim, world)
        for name, (position, orientation) in poses.items():
            sim.set_collider_pose(name, position, orientation, world=world)
