# SPDX-License-Identifier: Apache-2.0
"""Grippers of the running simulation: fingers that follow openings and forces set by topic or parameter."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from cloth_sim_ros import parameters
from cloth_sim_ros.ros.inputs.pose_track import Pose, PoseTrack
from cloth_sim_ros.sim import Gripper, GripperDriver, Simulation
from cloth_sim_ros.sim.clients.grippers import SIDES

STRONGEST = parameters.row(parameters.GRIPPER, "force").high  # [N]
ASKED = ("opening", "force")  # topics, and live parameters


def finger_names(names: tuple[str, ...]) -> list[str]:
    """Return the names of the colliders of these grippers."""
    return [f"{name}_{side}" for name in names for side in SIDES]


class Grippers:
    """Owned by the thread that simulates. It moves the fingers by their tracks, as topics move colliders.

    drivers: gripper -> its driver. asked: gripper -> the last command of a topic and its value, until a parameter is
    set. plans: gripper -> times of the simulation [s] and openings [m] that it goes through.
    """

    def __init__(self) -> None:
        self.drivers: dict[str, GripperDriver] = {}
        self.asked: dict[str, tuple[str, float]] = {}
        self.plans: dict[str, tuple[np.ndarray, np.ndarray]] = {}
        self.is_driven = True  # False if the fingers' tracks are moved from elsewhere, as by a recording

    def prepare(self, grippers: Mapping[str, Gripper], tracks: Mapping[str, PoseTrack]) -> dict[str, GripperDriver]:
        """Return the drivers for another simulation, which keep their openings; place the fingers of new grippers."""
        drivers = {}
        for name, gripper in grippers.items():
            driver = drivers[name] = GripperDriver(name, gripper)
            driver.move(tracks[name].pose.position, tracks[name].pose.orientation)
            if name in self.drivers:
                driver.opening = min(self.drivers[name].opening, gripper.max_opening)
            else:
                for finger, place in driver.places().items():
                    tracks[finger].rest(Pose(*place))
        return drivers

    def build(self, drivers: dict[str, GripperDriver]) -> None:
        """Adopt the drivers of another simulation, and repeat the commands of topics."""
        self.drivers = drivers
        for name, (what, value) in self.asked.items():
            if name in drivers:
                _drive(
                    drivers[name], what, min(value, drivers[name].gripper.max_opening) if what == "opening" else value
                )

    def look(self, sim: Simulation, asked: Mapping[str, tuple[str, float]]) -> None:
        """Adopt the finger poses of a loaded state, and `asked`, the commands of topics in it."""
        self.asked, self.plans = dict(asked), {}
        for name, driver in self.drivers.items():
            left, right = (np.array(sim.get(f"{finger}.position")) for finger in finger_names((name,)))
            driver.opening = float(np.linalg.norm(left - right)) - driver.gripper.finger_size[1]
        self.build(self.drivers)

    def command(self, name: str, what: str, value: float) -> None:
        """Set an opening [m] or a force [N] by a message, in the place of a plan."""
        self.plans.pop(name, None)
        self.asked[name] = what, value
        if name in self.drivers:
            _drive(self.drivers[name], what, value)

    def follow(self, name: str, now: float, points: Sequence[tuple[float, float]]) -> None:
        """Move a gripper through openings [m], each so many seconds after `now` [s]; without points it stays."""
        opening = self.drivers[name].opening if name in self.drivers else points[0][1] if points else None
        if opening is None:
            return
        times, openings = zip((0.0, opening), *points, strict=True)
        self.command(name, "opening", openings[-1])
        if points:
            self.plans[name] = now + np.array(times), np.array(openings)

    def set_parameter(self, sim: Simulation | None, name: str, field: str, value: Any) -> None:
        """Set a live parameter of a gripper. Its pose is set by a track instead."""
        driver = self.drivers.get(name)
        if driver is None:
            return
        if field in ASKED:
            self.asked.pop(name, None)
            self.plans.pop(name, None)
            _drive(driver, field, value)
        elif field == "speed":
            driver.set_speed(value)
        elif sim is not None:  # what its fingers are made of
            for finger in finger_names((name,)):
                sim.set(f"{finger}.{field}", value)

    def advance(self, sim: Simulation, tracks: Mapping[str, PoseTrack], until: float) -> None:
        """Move the tracks of the fingers to their poses at the end of the coming frame, at `until` [s]."""
        if not self.is_driven:
            return
        frame_dt = sim.settings.frame_dt
        for name, driver in self.drivers.items():
            if name in self.plans:
                times, openings = self.plans[name]
                driver.open_to(float(np.clip(np.interp(until, times, openings), 0.0, driver.gripper.max_opening)))
                if until >= times[-1]:
                    del self.plans[name]
            pose = tracks[name].advance(frame_dt) or tracks[name].pose
            driver.move(pose.position, pose.orientation)
            if driver.gripper.force > 0.0:
                driver.measure(sim)
            places = driver.poses(frame_dt)
            driver.squeeze(sim)
            for finger, place in places.items():
                if tracks[finger].pose != Pose(*place):
                    tracks[finger].place(Pose(*place))


def _drive(driver: GripperDriver, what: str, value: float) -> None:
    (driver.open_to if what == "opening" else driver.press)(value)
