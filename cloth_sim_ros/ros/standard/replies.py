# SPDX-License-Identifier: Apache-2.0
"""Answers with the standard's result codes, and calls into the thread that simulates."""

from __future__ import annotations

import math
from collections.abc import Awaitable, Callable
from concurrent.futures import TimeoutError as FutureTimeoutError
from functools import partial
from typing import Any

from rclpy.node import Node

from cloth_sim_ros.ros.parameters.services import settled
from cloth_sim_ros.ros.time.loop import PATIENCE, SimulationLoop
from cloth_sim_ros.sim import Simulation

UNSUPPORTED, OK, NOT_FOUND, INCORRECT_STATE, FAILED = range(5)  # RESULT_... of Result.msg


class Refusal(Exception):
    """A request cannot be met: the standard's code, and one sentence."""

    def __init__(self, code: int, sentence: str):
        super().__init__(sentence)
        self.code = code


def replying(handler: Callable[[Any, Any], Awaitable[str | None]]) -> Callable:
    """Return a service's callback: `handler` fills the response, and raises Refusal or returns a remark or nothing."""

    async def callback(request: Any, response: Any) -> Any:
        response.result.result, response.result.error_message = await outcome(handler(request, response))
        return response

    return callback


async def outcome(answer: Awaitable[str | None]) -> tuple[int, str]:
    """Return the result code and the sentence of a handler's answer."""
    try:
        return OK, await answer or ""
    except Refusal as reason:
        return reason.code, str(reason)
    except FutureTimeoutError:
        return FAILED, f"the simulation is busy; this takes effect when it is not, after more than {PATIENCE:g} s"
    except Exception as error:
        return FAILED, f"that failed: {error}"


class Asking:
    """Runs commands in the loop's thread between two frames, while the executor of `node` goes on."""

    def __init__(self, node: Node, loop: SimulationLoop):
        self._node, self._loop = node, loop

    async def __call__(self, command: Callable[..., Any], *arguments: Any, patience: float = PATIENCE) -> Any:
        """Return the result of command(*arguments). Raises its exception, and TimeoutError after `patience` [s]."""
        found = await settled(self._node, self._loop.submit(partial(_caught, command, *arguments)), patience)
        if isinstance(found, Exception):
            raise found
        return found

    async def at_length(self, command: Callable[..., Any], *arguments: Any) -> Any:
        """Call `command` likewise, without a time limit."""
        return await self(command, *arguments, patience=math.inf)

    @property
    def sim(self) -> Simulation:
        """The running simulation, to be read in the loop's thread. Raises Refusal if there is none."""
        world = self._loop.world
        if world.sim is None:
            raise Refusal(INCORRECT_STATE, f"no simulation: {world.trouble}")
        return world.sim


def _caught(command: Callable[..., Any], *arguments: Any) -> Any:
    """Return a refusal as a value, as the loop logs exceptions of commands."""
    try:
        return command(*arguments)
    except (Refusal, ValueError) as reason:
        return reason
