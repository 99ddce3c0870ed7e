# SPDX-License-Identifier: Apache-2.0
"""Sliders of a running node's parameters, grouped by their owners."""

from __future__ import annotations

import math
import time
from typing import Any

import viser
from rclpy.parameter import parameter_value_to_python
from rclpy.task import Future

from cloth_sim_ros.viewer.live.remote import Known, Remote
from cloth_sim_ros.viewer.live.sliders import WIND, ParameterSlider, scale_of
from cloth_sim_ros.viewer.scale import Scale, Told

SOLVER = ("solver.error", "solver.budget", "solver.iterations", "solver.substeps", "solver.global_damping")
OBJECT = (
    "stretch_compliance", "shear_compliance", "bend_compliance", "damping", "static_friction", "kinetic_friction",
    "winch.pay_out",
)  # fmt: skip
COLLIDER = ("static_friction", "kinetic_friction")
AXES = ("x", "y", "z")
ENABLED = "wind.enabled"
WIND_PERIOD = 0.2  # [s] between two winds by topic that are shown
ANSWER_IN = 10.0  # [s] after which a parameter is set again, as an answer may be lost


class Panel:
    """Folders of sliders. `told` gets a sentence if the node has something to say on a value.

    sliders: parameter -> one slider for each of its numbers; the wind has three.
    """

    def __init__(self, gui: viser.GuiApi, remote: Remote, known: Known, told: Told):
        self._remote, self._known, self._told = remote, known, told
        self._asked: dict[str, Future] = {}  # one request a parameter at a time
        self._since: dict[str, float] = {}  # when [s]
        self._waiting: dict[str, Any] = {}
        self._wind: tuple[float, float, float] | None = None  # by topic, to be shown [m/s]
        self._shown = -math.inf  # when a wind by topic was [s]
        self.sliders: dict[str, list[ParameterSlider]] = {}
        with gui.add_folder("Wind"):
            hint = self._description(ENABLED)
            self._switch: Any = gui.add_checkbox("There is wind", known.values[ENABLED], hint=hint)
            self._add(gui, "wind.velocity", AXES, Scale(-WIND, WIND))
        for name in known.names("objects"):
            self._folder(gui, name, [f"{name}.{each}" for each in OBJECT])
        with_friction = [f"{name}.{each}" for name in known.names("colliders") for each in COLLIDER]
        self._folder(gui, "Colliders", with_friction, expanded=False)
        self._folder(gui, "Solver", list(SOLVER), expanded=False)

    def _folder(self, gui: viser.GuiApi, title: str, names: list[str], expanded: bool = True) -> None:
        scales = {name: self._scale(name) for name in names}
        if not any(scales.values()):
            return
        with gui.add_folder(title, expand_by_default=expanded):
            for name, scale in scales.items():
                if scale is None:
                    continue
                label = name.removeprefix(f"{title}.").removeprefix("solver.").replace("_", " ").replace(".", " ")
                self._add(gui, name, (label,), scale)

    def _add(self, gui: viser.GuiApi, name: str, labels: tuple[str, ...], scale: Scale) -> None:
        """Add a slider for each number of a parameter."""
        hint, value = self._description(name), self._known.values[name]
        numbers = [value] if len(labels) == 1 else value

        def told(sentence: str) -> None:
            self._told(f"{name}: {sentence}")

        self.sliders[name] = [
            ParameterSlider(gui, label, scale, number, hint, told)
            for label, number in zip(labels, numbers, strict=True)
        ]

    def _scale(self, name: str) -> Scale | None:
        """Return the scale of a parameter; None if the scene lacks it or anything that it acts on."""
        values = self._known.values
        missing = name not in values
        straight = (
            name.endswith(".bend_compliance") and values.get(name.replace("bend_compliance", "bending")) == "none"
        )
        no_winch = name.endswith(".pay_out") and not values.get(name.replace("pay_out", "enabled"))
        return None if missing or straight or no_winch else scale_of(self._known.descriptors[name], values[name])

    def _description(self, name: str) -> str:
        """Return the description of a parameter, or its part for the current kind of bending if it has several."""
        words, kind = self._known.descriptors[name].description, self._known.values.get(f"{name.split('.')[0]}.bending")
        return next((part for part in words.split("; ") if part.startswith(f"{kind}:")), words)

    def advance(self) -> None:
        """Send values changed in the browser, and read the answers."""
        for name, sliders in self.sliders.items():
            wanted = [slider.wanted() for slider in sliders]
            if all(value is None for value in wanted):
                continue
            if len(sliders) == 1:
                self._waiting[name] = wanted[0]
            else:
                held = self._waiting.get(name, self._known.values[name])
                self._waiting[name] = [new if new is not None else old for new, old in zip(wanted, held, strict=True)]
        if self._switch.value != self._known.values[ENABLED] and ENABLED not in self._asked:
            self._waiting[ENABLED] = self._switch.value
        if self._wind is not None and time.monotonic() - self._shown > WIND_PERIOD:
            self.changed("wind.velocity", list(self._wind))
            self._wind, self._shown = None, time.monotonic()
        for name in [name for name, future in self._asked.items() if future.done()]:
            self._answered(name, self._asked.pop(name).result().results[0])
        for name in [name for name in self._asked if time.monotonic() - self._since[name] > ANSWER_IN]:
            del self._asked[name]
            self._waiting.setdefault(name, self._known.values[name])
        for name in [name for name in self._waiting if name not in self._asked]:
            self._known.values[name] = value = self._waiting.pop(name)
            self._asked[name], self._since[name] = self._remote.set(name, value), time.monotonic()

    def _answered(self, name: str, result: Any) -> None:
        if result.reason:
            self._told(result.reason if result.successful else f"{name} stays as it is: {result.reason}")
        if not result.successful:
            self._remote.get([name]).add_done_callback(lambda future: self._put_back(name, future))

    def _put_back(self, name: str, future: Future) -> None:
        self.changed(name, parameter_value_to_python(future.result().values[0]))

    def blown(self, velocity: tuple[float, float, float]) -> None:
        """Take a wind [m/s] that came by topic and acts in place of the parameter."""
        self._wind = velocity

    def changed(self, name: str, value: Any) -> None:
        """Show the value of a parameter that the node reports."""
        if name in self._asked or name in self._waiting:
            return  # ours, which may be older than what the browser shows
        self._known.values[name] = value
        if name == ENABLED:
            self._switch.value = value
        if name in self.sliders:
            numbers = [value] if len(self.sliders[name]) == 1 else value
            for slider, number in zip(self.sliders[name], numbers, strict=True):
                slider.show(number)
