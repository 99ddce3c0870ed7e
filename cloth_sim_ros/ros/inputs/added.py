# SPDX-License-Identifier: Apache-2.0
"""Colliders that topics have added, kept through rebuilds of the simulation."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

from cloth_sim_ros.ros.parameters.plan import placed
from cloth_sim_ros.sim import Simulation
from cloth_sim_ros.sim.colliders.collider import Collider


class Added:
    """Owned by the thread that simulates. colliders: name -> collider, at its current pose."""

    def __init__(self):
        self.colliders: dict[str, Collider] = {}

    def put(self, sim: Simulation | None, name: str, collider: Collider) -> tuple[bool, str]:
        """Add a collider, or move one that was added; return True, or False and the reason."""
        before = self.colliders.get(name)
        try:
            if sim is not None and before is not None and replace(before, **placed(collider)) == collider:
                sim.set_collider_pose(name, collider.position, collider.orientation)
            elif sim is not None:
                sim.add_collider(name, collider)
        except ValueError as error:
            return False, str(error)
        self.colliders[name] = collider
        return True, ""

    def take_away(self, sim: Simulation | None, name: str) -> None:
        """Remove the collider of this name, if there is one."""
        if self.colliders.pop(name, None) is not None and sim is not None:
            sim.remove_collider(name)

    def put_all(self, sim: Simulation) -> None:
        """Add all colliders to a new simulation."""
        for name, collider in self.colliders.items():
            sim.add_collider(name, collider)

    def look(self, sim: Simulation, given: Collection[str]) -> None:
        """Adopt the colliders of a loaded simulation at their poses, without those `given` by parameters."""
        self.colliders = {
            name: replace(collider, position=sim.get(f"{name}.position"), orientation=sim.get(f"{name}.orientation"))
            for name, collider in sim.scene.colliders.items()
            if name not in given
        }
