# SPDX-License-Identifier: Apache-2.0
"""The page of a running node: its scene, its controls and its curves."""

from __future__ import annotations

import time
from functools import partial
from typing import Any

import numpy as np
import viser
from rclpy.task import Task
from sensor_msgs.msg import PointCloud2
from visualization_msgs.msg import MarkerArray

from cloth_sim_ros.viewer.curves import Curves
from cloth_sim_ros.viewer.drawing import Click, Drag
from cloth_sim_ros.viewer.live.grasp import Grasp
from cloth_sim_ros.viewer.live.panel import Panel
from cloth_sim_ros.viewer.live.remote import ENDS, Known, Remote, Seen
from cloth_sim_ros.viewer.live.scene import LiveScene
from cloth_sim_ros.viewer.live.scene_choice import SceneChoice
from cloth_sim_ros.viewer.look import look_from
from cloth_sim_ros.viewer.scale import PowerSlider, powers
from cloth_sim_ros.viewer.scissors import Scissors
from cloth_sim_ros.viewer.window import Page

ANSWER_IN = 5.0  # [s] after which the node is asked again, as an answer may be lost while it starts
RUN, STATE = ("pause", "go on", "step", "reset"), ("save", "load")
KEYS = {"space": "pause or go on", "N": "step", "R": "reset"}
PULL = powers(0.1, 100.0)  # [N] largest force of a drag


class LivePage(Page):
    """The page that waits for the node, shows it, and waits again if it goes."""

    title = "The running node"

    def __init__(self, server: viser.ViserServer, remote: Remote):
        self._remote = remote
        self._task: Task | None = None
        self._asked = -np.inf  # when [s]
        self._calls: list[Any] = []
        self._content: Any = None
        self._contents: list[Any] = []  # of nodes that have gone: hidden
        self.known: Known | None = None
        super().__init__(server)

    def build(self) -> None:
        self._paused = False
        self._scene = SceneChoice(self.gui, self._remote.node, self.tell)
        self._commands = [self.gui.add_command(label, hotkey=key) for key, label in KEYS.items()]
        for command, label in zip(self._commands, KEYS.values(), strict=True):
            command.on_trigger(lambda event, label=label: self._pressed.append(lambda: self.press(label)))
        self.tell(f"Waiting for {self._remote.target} ...")

    def frame(self) -> None:
        self._scene.advance()
        if self.known is None:
            self._look()
        elif not self._remote.there:
            self._lose(f"{self._remote.target} has gone; waiting for it ...")
        else:
            self.panel.advance()
            self.grasp.advance()
            self._hear_answers()
            self._draw_loads()

    def dragged(self, drag: Drag) -> None:
        if self.known is not None:
            self.grasp.drag(drag)

    def clicked(self, click: Click) -> None:
        if self.known is None or click.name not in self.scene.positions:
            return
        if self.known.values.get(f"{click.name}.tear_strain"):
            self._scissors.click(click, self.scene.positions[click.name])
        else:
            self.tell(f"{click.name} cannot be cut. A cloth can with a tear_strain above 0.")

    # -- coming and going ----------------------------------------------------------------------------------------

    def _look(self) -> None:
        """Ask the node for its parameters, once it is there."""
        if self._task is not None and self._task.done():
            task, self._task = self._task, None
            if task.exception() is not None:
                self.tell(f"{self._remote.target} is no cloth_sim node: {task.exception()}")
            else:
                self._show(task.result())
        elif self._remote.there and time.monotonic() - self._asked > ANSWER_IN:
            self._asked = time.monotonic()
            self._task = self._remote.node.executor.create_task(self._remote.know)

    def _show(self, known: Known) -> None:
        while self._contents:
            self._contents.pop().remove()  # now and not as they went, see Page.remove
        self.known = known
        self.scene = LiveScene(self.server, self.drawing, known)
        self.grasp = Grasp(self._remote, known, self.scene, self.tell, lambda: self._pull.value)
        cut = partial(self._remote.cut, frame_id=known.values["frame_id"])
        self._scissors = Scissors(cut, self.tell)
        self._content = self.gui.add_folder(None, visible=False)  # until there is something that it acts on
        with self.folder, self._content:
            self._verdict = self.gui.add_markdown("")
            self.buttons(RUN, self.press)
            self.buttons(STATE, self.press)
            if known.names("handles"):
                hint = "With which a drag pulls at most: the hand is tied to the cloth by a spring."
                self._pull = PowerSlider(self.gui, "drag with at most", PULL, 5.0, " N", hint, self.tell)
            self.gui.add_markdown(self._hints(known))
            tabs = self.gui.add_tab_group()
            with tabs.add_tab("Parameters"):
                self.panel = Panel(self.gui, self._remote, known, self.tell)
            with tabs.add_tab("Curves"):
                self._make_curves(known)
        self._begin = time.monotonic()
        felt = self.loads.__setitem__
        seen = Seen(
            self._cloud, self.scene.topology, self._markers, self._report, felt, self._changed, self.panel.blown
        )
        self._remote.listen(known, seen)
        self._framed = False
        self.tell(f"{self._remote.target} is there and builds its scene ...")

    def _hints(self, known: Known) -> str:
        """Return what keys and mouse do here."""
        keys = "Keys: space pauses, N steps, R resets."
        drag = " Drag cloths and ropes with the mouse." if known.names("handles") else ""
        tears = [name for name in known.names("objects") if known.values.get(f"{name}.tear_strain")]
        return keys + drag + (f" Two clicks cut {' or '.join(tears)} between them." if tears else "")

    def _make_curves(self, known: Known) -> None:
        objects = known.names("objects")
        self.curves = {"pace": Curves(self.gui, "Real-time factor", ["real-time factor"])}
        if objects:
            self.curves["strain"] = Curves(self.gui, "Largest strain [%]", objects)
            self.curves["error"] = Curves(self.gui, "Estimated error a frame [µm]", objects, log=(1e-3, 1e5))
        ends = [f"{rope}/{end}" for rope in known.ropes() for end in ENDS]
        if ends:
            self.curves["tension"] = Curves(self.gui, "Tension at the ends of ropes [N]", ends)
        else:
            self.gui.add_markdown("There is no rope, so there is no tension to show.")
        loads = [f"{kind}/{name}" for kind in ("handles", "colliders") for name in known.names(kind)]
        if loads:
            self.curves["force"] = Curves(self.gui, "Force on handles and colliders [N]", loads)
        else:
            self.gui.add_markdown("There is no handle and no collider, so there is no force to show.")
        self.loads = dict.fromkeys([*ends, *loads], np.nan)

    def _lose(self, why: str) -> None:
        self._remote.forget()
        self.scene.close()
        self.drawing.clear()
        self._content.visible = False
        self._contents.append(self._content)
        self.known, self._task, self._asked = None, None, -np.inf
        self.tell(why)

    def close(self) -> None:
        if self.known is not None:
            self._lose("")
        for command in self._commands:
            command.remove()
        super().close()

    # -- buttons -------------------------------------------------------------------------------------------------

    def press(self, label: str) -> None:
        """Act as the button of this label."""
        if label == KEYS["space"]:
            label = "go on" if self._paused else "pause"
        if self.known is None:
            self.tell(f"{self._remote.target} is not there yet.")
        elif label in ("pause", "go on"):
            self._paused = label == "pause"
            self._call("pause", self._paused)
        else:
            self._call(label)

    def _call(self, service: str, on: bool | None = None) -> None:
        answer = self._remote.call(service, on)
        if answer is None:
            self.tell(f"The service {service} is not there yet; press again in a moment.")
        else:
            self._calls.append(answer)

    def _hear_answers(self) -> None:
        for answer in [each for each in self._calls if each.done()]:
            self._calls.remove(answer)
            self.tell(answer.result().message)

    # -- what arrives --------------------------------------------------------------------------------------------

    def _cloud(self, name: str, cloud: PointCloud2) -> None:
        self.scene.cloud(name, cloud)
        self._look_once()

    def _look_once(self) -> None:
        """Place the camera as soon as the scene is complete, or after ANSWER_IN."""
        if self._framed or not self.scene.positions:
            return
        wanted = {name for what in ("objects", "colliders", "handles") for name in self.known.names(what)}
        is_late = time.monotonic() - self._begin > ANSWER_IN
        if is_late or wanted <= {*self.scene.positions, *self.scene.places}:
            self._framed = True
            self._look_at_all()

    def _look_at_all(self) -> None:
        """Place the camera where the scene's parameters say, or so that objects, colliders and handles are in view."""
        position, at = (tuple(self.known.values.get(f"view.{what}", ())) for what in ("position", "look_at"))
        if position != at:
            look_from(self.server, position, at)
            return
        places = np.array(list(self.scene.places.values())).reshape(-1, 3)
        points = np.concatenate([*self.scene.positions.values(), *self.scene.starts.values(), places])
        middle, size = 0.5 * (points.min(axis=0) + points.max(axis=0)), np.linalg.norm(np.ptp(points, axis=0))
        away = max(1.9 * size, 0.5) * np.array([0.45, -0.85, 0.3])
        look_from(self.server, tuple(middle + away), tuple(middle))

    def _markers(self, array: MarkerArray) -> None:
        self.scene.markers(array)
        self._look_once()

    def _draw_loads(self) -> None:
        for key in {"tension", "force"} & set(self.curves):
            curve = self.curves[key]
            curve.add(time.monotonic() - self._begin, [self.loads[each] for each in curve.labels])

    def _report(self, message: str, values: dict[str, str]) -> None:
        now, objects = time.monotonic() - self._begin, self.known.names("objects")
        self._paused = values.get("paused", str(self._paused)) == "True"
        self._verdict.content = f"*{message}*"
        if not values:  # nothing is simulated at this time
            if not self._content.visible:
                self.tell(f"{self._remote.target}: {message}")
            return
        if not self._content.visible:
            self._content.visible = True
            self.tell(f"{self._remote.target} is there." + ("" if objects else " Its scene is empty."))
        self.curves["pace"].add(now, [_number(values, "real_time_factor")])
        if objects:
            self.curves["strain"].add(now, [100.0 * _number(values, f"{name}.max_strain") for name in objects])
            self.curves["error"].add(now, [1e6 * _number(values, f"{name}.error_per_frame") for name in objects])

    def _changed(self, name: str, value: Any) -> None:
        self.known.values[name] = value
        self.panel.changed(name, value)


def _number(values: dict[str, str], key: str) -> float:
    return float(values.get(key, "nan"))
