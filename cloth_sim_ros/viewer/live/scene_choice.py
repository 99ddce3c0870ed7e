# SPDX-License-Identifier: Apache-2.0
"""Choice of a scene while `make demo` runs, which restarts the node on the chosen one."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import viser
from rclpy.node import Node
from rclpy.parameter import Parameter, parameter_value_to_python
from rclpy.parameter_client import AsyncParameterClient
from rclpy.task import Future

DEMO = "cloth_demo"  # the demonstration's own node


class SceneChoice:
    """A dropdown of the demonstration's scenes; hidden while there is no demonstration."""

    def __init__(self, gui: viser.GuiApi, node: Node, told: Callable[[str], None]):
        self._gui, self._told = gui, told
        self._remote = AsyncParameterClient(node, DEMO)
        self._choice: Any = gui.add_dropdown("Scene", ("",), visible=False)
        self._seen = ""
        self._asked: list[Future] = []

    def advance(self) -> None:
        """Ask the demonstration for its scenes once it is there, show them, and send it another choice."""
        if not self._remote.services_are_ready():
            self._choice.visible, self._asked = False, []
        elif not self._choice.visible and not self._asked:
            self._asked = [self._remote.describe_parameters(["scene"]), self._remote.get_parameters(["scene"])]
        elif not self._choice.visible and all(each.done() for each in self._asked):
            described, values = (each.result() for each in self._asked)
            self._seen = parameter_value_to_python(values.values[0])
            self._choice.options = tuple(described.descriptors[0].additional_constraints.split())
            self._choice.value, self._choice.visible = self._seen, True
        elif self._choice.visible and self._choice.value != self._seen:
            self._seen = self._choice.value
            self._remote.set_parameters([Parameter("scene", value=self._seen)])
            self._told(f"The scene {self._seen} is started ...")

    def choose(self, scene: str) -> None:
        """Choose a scene, as a browser does."""
        self._choice.value = scene
