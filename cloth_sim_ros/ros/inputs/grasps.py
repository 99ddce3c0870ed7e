# SPDX-License-Identifier: Apache-2.0
"""Grasps of the handles in the running simulation, by service and parameter, through resets and rebuilds."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from cloth_sim_ros.ros.inputs.pose_track import PoseTrack
from cloth_sim_ros.sim import Simulation
from cloth_sim_ros.sim.scene.handles import extents


class Grasps:
    """Owned by the thread that simulates.

    told(handle, attached) is called in that thread if a handle lets go by itself.
    """

    def __init__(self, log: Any, told: Callable[[str, bool], None] = lambda handle, attached: None):
        self.told = told
        self._log = log
        self._broken: dict[str, int] = {}

    def set(self, sim: Simulation, handle: str, on: bool) -> tuple[bool, str]:
        """Grasp or let go; return True if that succeeded, and one sentence about it."""
        if handle not in sim.scene.handles:
            return False, f"{handle} is left out of the simulation; the log says why"
        if not on:
            sim.release(handle)
            return True, f"{handle} holds nothing"
        count = sim.attach(handle)
        if count:
            return True, f"{handle} holds {count} particle{'s' if count > 1 else ''}"
        return False, f"{handle} holds nothing: {self._why(sim, handle)}"

    def _why(self, sim: Simulation, handle: str) -> str:
        position, only = sim.handle_position(handle), sim.get(f"{handle}.object")
        objects = [only] if only else sim.scene.objects
        apart = {name: np.linalg.norm(sim.positions(name) - position, axis=1).min() for name in objects}
        if not apart:
            return "there is no object"
        nearest = min(apart, key=apart.get)
        trouble = "is pinned or held already, or lies beside its reach"
        if apart[nearest] > extents(sim.get(f"{handle}.reach"))[3]:
            trouble = "lies beyond its reach"
        return f"the nearest particle is of {nearest}, {apart[nearest]:.3g} m away, and {trouble}"

    def tell_empty(self, sim: Simulation, values: Mapping[str, Any]) -> None:
        """Warn of handles that should hold something but have nothing within their reach."""
        for name in sim.scene.handles:
            if values[f"{name}.attached"] and not sim.held(name):
                self._log.warning(f"{name} holds nothing: {self._why(sim, name)}")

    def reset(self, sim: Simulation, tracks: Mapping[str, PoseTrack], values: Mapping[str, Any]) -> None:
        """Put handles at their last poses; attached ones grasp the particles that are there now."""
        for name in sim.scene.handles:
            sim.release(name)
            sim.set_handle_pose(name, tracks[name].pose.position, tracks[name].pose.orientation, sweep=False)
            if values[f"{name}.attached"]:
                sim.attach(name)

    def look(self, sim: Simulation) -> None:
        """Adopt a loaded state: handles that had let go in it are not reported."""
        self._broken = {name: sim.broken(name) for name in sim.scene.handles}

    def watch(self, sim: Simulation, values: Mapping[str, Any]) -> None:
        """Warn of handles that let go in the last frame because their load was too large."""
        for name in sim.scene.handles:
            if values[f"{name}.break_force"] <= 0.0:
                continue
            count = sim.broken(name)
            if count > self._broken.get(name, 0):
                most = values[f"{name}.break_force"]
                self._log.warning(f"{name} let go: its load was larger than {name}.break_force, {most:g} N")
                self.told(name, False)
            self._broken[name] = count
