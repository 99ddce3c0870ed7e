# SPDX-License-Identifier: Apache-2.0
"""Offer the services of the standard, as far as the installed version of simulation_interfaces has them."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

from rclpy.action import ActionServer, CancelResponse
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup, ReentrantCallbackGroup
from rclpy.node import Node

from cloth_sim_ros.ros.inputs.frames import Frames
from cloth_sim_ros.ros.parameters.bridge import ParameterBridge
from cloth_sim_ros.ros.standard.entities import Entities
from cloth_sim_ros.ros.standard.replies import Asking, replying
from cloth_sim_ros.ros.standard.running import Running
from cloth_sim_ros.ros.standard.spawning import Spawner
from cloth_sim_ros.ros.time.loop import SimulationLoop
from cloth_sim_ros.ros.world import World


class Standard:
    """The handlers of one node.

    show(come, go) adds and removes outputs of objects, in the loop's thread. now(world) returns nanoseconds of a stamp.
    """

    def __init__(
        self,
        node: Node,
        loop: SimulationLoop,
        bridge: ParameterBridge,
        frames: Frames,
        show: Callable[..., None],
        now: Callable[[World], int],
    ):
        ask = Asking(node, loop)
        self.spawner = Spawner(node, loop, bridge, frames, ask, show)
        self.running = Running(loop, ask, self.spawner)
        self.entities = Entities(loop.world, frames, ask, self.spawner, now)


def offer(node: Node, standard: Standard) -> None:
    """Create the services and the action of `node`; none if the package is not installed."""
    try:
        from simulation_interfaces import action, msg, srv
    except ImportError:
        return
    running, entities, spawner = standard.running, standard.entities, standard.spawner
    at_once, in_turn = ReentrantCallbackGroup(), MutuallyExclusiveCallbackGroup()
    for name, handler, group in (
        ("GetSimulationState", running.get_state, at_once),
        ("SetSimulationState", running.set_state, at_once),
        ("StepSimulation", running.step, at_once),
        ("ResetSimulation", running.reset, in_turn),
        ("GetEntities", entities.get_all, at_once),
        ("GetEntityState", entities.get_state, at_once),
        ("GetEntitiesStates", lambda *both: entities.get_states(msg.EntityState, *both), at_once),
        ("SetEntityState", entities.set_state, at_once),
        ("GetEntityInfo", entities.get_info, at_once),
        ("GetEntityBounds", entities.get_bounds, at_once),
        ("DeleteEntity", spawner.delete, in_turn),
        ("SpawnEntity", spawner.spawn, in_turn),
        ("SpawnEntities", lambda *both: spawner.spawn_all(msg.SpawnResult, *both), in_turn),
    ):
        _serve(node, getattr(srv, name, None), name, replying(handler), group)
    _serve(node, srv.GetSimulatorFeatures, "GetSimulatorFeatures", running.get_features, at_once)
    kind = action.SimulateSteps

    async def execute(goal: Any) -> Any:  # rclpy awaits what is declared so, and no lambda
        return await running.simulate_steps(goal, kind.Feedback(), kind.Result())

    ActionServer(node, kind, "~/simulate_steps", execute, cancel_callback=_accept, callback_group=at_once)


def _accept(goal: Any) -> CancelResponse:
    return CancelResponse.ACCEPT


def _serve(node: Node, kind: Any, name: str, callback: Callable, group: Any) -> None:
    if kind is not None:  # an older version may not have it
        topic = re.sub(r"(?<!^)(?=[A-Z])", "_", name).lower()
        node.create_service(kind, f"~/{topic}", callback, callback_group=group)
