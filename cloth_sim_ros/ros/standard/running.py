# SPDX-License-Identifier: Apache-2.0
"""Features of the simulator, its state, reset and steps."""

from __future__ import annotations

import time
from collections.abc import AsyncIterator
from typing import Any

from cloth_sim_ros.ros.standard.replies import FAILED, UNSUPPORTED, Asking, Refusal, outcome
from cloth_sim_ros.ros.standard.spawning import Spawner
from cloth_sim_ros.ros.time.loop import SimulationLoop

FEATURES = (
    "SPAWNING SPAWNING_ENTITIES SPAWNING_RESOURCE_STRING DELETING ENTITY_TAGS ENTITY_BOUNDS ENTITY_BOUNDS_BOX "
    "ENTITY_CATEGORIES ENTITY_STATE_GETTING ENTITY_STATE_SETTING ENTITY_INFO_GETTING SIMULATION_RESET "
    "SIMULATION_RESET_STATE SIMULATION_RESET_SPAWNED SIMULATION_STATE_GETTING SIMULATION_STATE_SETTING "
    "SIMULATION_STATE_PAUSE STEP_SIMULATION_SINGLE STEP_SIMULATION_MULTIPLE STEP_SIMULATION_ACTION"
).split()
STOPPED, PLAYING, PAUSED, _, NO_WORLD, LOADING_WORLD = range(6)  # STATE_... of SimulationState.msg
ALREADY, INCORRECT_TRANSITION = 101, 103  # of SetSimulationState.srv
SCOPE_TIME, SCOPE_STATE, SCOPE_SPAWNED, SCOPE_ALL = 1, 2, 4, 255  # of ResetSimulation.srv
SHARE = 0.02  # [s] of steps in a row, before the loop sends and looks after other commands


class Running:
    """Handlers, each (request, response), for the executor's thread."""

    def __init__(self, loop: SimulationLoop, ask: Asking, spawner: Spawner):
        self._loop, self._ask, self._spawner = loop, ask, spawner

    async def get_features(self, request: Any, response: Any) -> Any:
        """Answer GetSimulatorFeatures, with the features that its version knows. Its response has no result."""
        features = response.features
        known = (getattr(features, name, None) for name in FEATURES)
        features.features = [number for number in known if number is not None]
        features.spawn_formats = ["yaml"]
        features.custom_info = "cloth_sim_ros: cloth and ropes, see docs/reference/ros.md"
        return response

    async def get_state(self, request: Any, response: Any) -> None:
        """Answer GetSimulationState."""
        response.state.state = self._state

    @property
    def _state(self) -> int:
        world = self._loop.world
        if world.sim is None:
            return LOADING_WORLD if self._loop.busy else NO_WORLD
        if not self._loop.paused:
            return PLAYING
        return STOPPED if world.is_at_start else PAUSED

    async def set_state(self, request: Any, response: Any) -> None:
        """Answer SetSimulationState: play, pause, or stop, which is a pause at the start."""
        now, wanted = self._state, request.state.state
        if wanted not in (STOPPED, PLAYING, PAUSED):
            raise Refusal(UNSUPPORTED, f"the state {wanted} is not offered; allowed are 0 stopped, 1 playing, 2 paused")
        if now == wanted:
            raise Refusal(ALREADY, "the simulation is in this state already")
        if (now, wanted) == (STOPPED, PAUSED):
            raise Refusal(INCORRECT_TRANSITION, "the simulation is stopped, which is paused at the start")
        self._loop.paused = wanted != PLAYING
        if wanted == STOPPED:
            await self._ask(self._loop.world.reset)

    async def reset(self, request: Any, response: Any) -> str | None:
        """Answer ResetSimulation: reset objects to their start and remove spawned ones; time goes on."""
        scope, whole = request.scope, request.scope in (0, SCOPE_ALL)
        if not whole and scope & ~(SCOPE_STATE | SCOPE_SPAWNED):
            raise Refusal(
                UNSUPPORTED, f"scope {scope} is not offered, as time never runs back; allowed are 0, 2, 4, 6 and 255"
            )
        if whole or scope & SCOPE_SPAWNED:
            await self._spawner.remove_all()
        if whole or scope & SCOPE_STATE:
            await self._ask(self._loop.world.reset)
        return "objects are back at the start, and time goes on" if whole else None

    async def step(self, request: Any, response: Any) -> None:
        """Answer StepSimulation."""
        async for _ in self._stepping(request.steps, request.steps):
            pass

    async def simulate_steps(self, goal: Any, feedback: Any, result: Any) -> Any:
        """Run the action SimulateSteps: one step and feedback with each frame that is sent, until its goal is
        canceled."""
        result.result.result, result.result.error_message = await outcome(self._act(goal, feedback))
        if goal.is_cancel_requested:
            goal.canceled()
        elif result.result.error_message:
            goal.abort()
        else:
            goal.succeed()
        return result

    async def _act(self, goal: Any, feedback: Any) -> None:
        steps = goal.request.steps
        async for done in self._stepping(steps, 1):
            feedback.completed_steps, feedback.remaining_steps = done, steps - done
            goal.publish_feedback(feedback)
            if goal.is_cancel_requested:
                raise Refusal(FAILED, f"that was canceled after {done} of {steps} steps")

    async def _stepping(self, steps: int, most: int) -> AsyncIterator[int]:
        """Simulate exactly `steps` frames while paused, at most `most` in a row; yield the number done.

        Raises Refusal if it is not paused, or is set to run or reset meanwhile.
        """
        if not self._loop.paused:
            raise Refusal(FAILED, "the simulation is running; pause it first")
        done, resets = 0, self._loop.world.resets
        while done < steps:
            if not self._loop.paused or self._loop.world.resets != resets:
                raise Refusal(FAILED, f"the simulation was set to run or reset after {done} of {steps} steps")
            done += await self._ask.at_length(self._some_steps, min(most, steps - done))
            yield done

    def _some_steps(self, most: int) -> int:
        """Simulate at least one of at most `most` frames, in the loop's thread; return their number."""
        end, done = time.monotonic() + SHARE, 0
        while done < most and (not done or time.monotonic() < end):
            self._ask.sim  # noqa: B018  it refuses where there is none
            self._loop.step_once()
            done += 1
        return done
