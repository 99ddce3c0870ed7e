# SPDX-License-Identifier: Apache-2.0
"""The services ~/save and ~/load, which write the state of the simulation into a file and read it back."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

from rclpy.callback_groups import CallbackGroup
from rclpy.node import Node
from std_srvs.srv import Trigger

from cloth_sim_ros.ros.parameters.bridge import ParameterBridge
from cloth_sim_ros.ros.time.loop import SimulationLoop


class StateServices:
    """The loop's thread saves and loads between two frames, while the executor of `node` goes on.

    answer(response, command) runs `command` there and answers with its result.
    """

    def __init__(
        self, node: Node, loop: SimulationLoop, bridge: ParameterBridge, answer: Callable, group: CallbackGroup
    ):
        self._node, self._loop, self._bridge, self._answer = node, loop, bridge, answer
        self._loaded: list[Mapping[str, Any]] = []  # values that parameters have yet to follow
        node.create_service(Trigger, "~/save", self._on_save, callback_group=group)
        node.create_service(Trigger, "~/load", self._on_load, callback_group=group)

    async def _on_save(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        return await self._answer(response, partial(self._save, self._bridge.values["state_file"]))

    async def _on_load(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        await self._answer(response, partial(self._load, self._bridge.values["state_file"]))
        self._follow()  # so that whoever has the answer finds the parameters as they are
        return response

    def _save(self, file: str) -> tuple[bool, str]:
        """Save the state, in the loop's thread."""
        home, path = _home(), _state_path(file)
        if path.parent == home:  # no other folder is made: state_file may name any
            with suppress(OSError):  # the answer says that the file cannot be written
                home.mkdir(exist_ok=True)
        return self._loop.world.save(path)

    def _load(self, file: str) -> tuple[bool, str]:
        """Load the state, in the loop's thread."""
        done, sentence, values = self._loop.world.load(_state_path(file))
        self._loaded.append(values)
        if self._node.executor is not None:  # where it took so long that the answer is given already
            self._node.executor.create_task(self._follow)
        return done, sentence

    def _follow(self) -> None:
        """Let parameters follow the loaded states, in the executor's thread."""
        while self._loaded:
            self._bridge.follow(self._loaded.pop(0))


def _state_path(file: str) -> Path:
    """Return the path of the parameter state_file: a relative one lies in ROS_HOME, or in ~/.ros. Raises ValueError."""
    return _home() / _expanded(file)


def _home() -> Path:
    return _expanded(os.environ.get("ROS_HOME") or "~/.ros")


def _expanded(path: str) -> Path:
    try:
        return Path(path).expanduser()
    except RuntimeError:
        raise ValueError(
            f"{path} is in a home that nobody has; allowed are whole paths in state_file or ROS_HOME"
        ) from None
