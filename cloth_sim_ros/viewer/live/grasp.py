# SPDX-License-Identifier: Apache-2.0
"""Drag a vertex by a free handle of the scene, which pulls it as a spring, over topics and services."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from rclpy.parameter import parameter_value_to_python
from rclpy.task import Future

from cloth_sim_ros.viewer.drawing import Drag
from cloth_sim_ros.viewer.live.remote import Known, Remote
from cloth_sim_ros.viewer.live.scene import LiveScene

NEAR = 0.3  # of a handle's reach within which the vertex must be before the handle grasps
LONG = 600  # frames without an answer after which a drag is given up
PATIENCE = 120  # frames within which the handle should reach the vertex
SHARE = 0.35  # of the way to the mouse that the handle goes in a frame: the mouse comes 20 times a second
_STILL = 1e-6  # [m] distance that counts as arrived
LONGEST = 0.1  # [m] longest spring between hand and vertex, which pulls with the largest force
NONE_FREE = "No handle is free to drag with. Add one to the scene, as `handles: [hand]`, that nobody else moves."


class Grasp:
    """One drag at a time: a free handle goes to the vertex, grasps, follows the mouse, and lets go.

    The parameter compliance makes its hold a spring. force() returns the largest force [N], which acts if the mouse is
    LONGEST or more away. `state` is idle, choosing, softening, reaching, asking, holding or leaving.
    """

    def __init__(
        self,
        remote: Remote,
        known: Known,
        scene: LiveScene,
        told: Callable[[str], None],
        force: Callable[[], float] = lambda: 5.0,
    ):
        self._remote, self._known, self._scene, self._told = remote, known, scene, told
        self._force = force
        self.state = "idle"
        self.handle = ""
        self._object = ""
        self._ended = False
        self._waited = 0
        self._answer: Future | None = None

    def drag(self, drag: Drag) -> None:
        """Take the start, a move or the end of a drag."""
        if drag.phase == "start":
            if self.state == "idle" and drag.name in self._scene.positions:
                self._begin(drag)
        elif drag.name == self._object:
            self._pointer = drag.pointer
            self._ended = self._ended or drag.phase == "end"

    def _begin(self, drag: Drag) -> None:
        handles = [name for name in self._known.names("handles") if self._remote.is_ours_alone(name)]
        if not handles:
            self._told(NONE_FREE)
            return
        self._object, self._pointer = drag.name, drag.pointer
        positions = self._scene.positions[drag.name]
        self._vertex = int(np.linalg.norm(positions - drag.grasped, axis=1).argmin())
        self._ended, self._waited, self._silent, self.handle, self._handles = False, 0, 0, "", handles
        self.state, self._answer = "choosing", self._remote.get([f"{name}.attached" for name in handles])

    @property
    def vertex(self) -> np.ndarray:
        """Position (3,) [m] of the dragged vertex."""
        return self._scene.positions[self._object][self._vertex]

    def advance(self) -> None:
        """Advance the drag by one frame."""
        if self.state == "idle":
            return
        self._silent = self._silent + 1 if self._answer is not None and not self._answer.done() else 0
        if self._vertex >= len(self._scene.positions[self._object]) or self._silent > LONG:
            self._give_up()
        else:
            getattr(self, f"_{self.state}")()

    def _give_up(self) -> None:
        """End the drag, as the object has other particles or the node does not answer."""
        if self.handle:
            self._remote.call(f"handles/{self.handle}/attach", False)
        held = self.state in ("holding", "leaving")
        self._told(f"{self._object} {'is not held any more' if held else 'was not grasped'}.")
        self.state = "idle"

    def _choosing(self) -> None:
        if not self._answer.done():
            return
        attached = [parameter_value_to_python(value) for value in self._answer.result().values]
        free = [name for name, holds in zip(self._handles, attached, strict=True) if not holds]
        if not free:
            self._told(NONE_FREE)
            self.state = "idle"
            return
        self.handle, self.state = free[0], "softening"
        self._answer = self._remote.set(f"{self.handle}.compliance", LONGEST / self._force())

    def _softening(self) -> None:
        if self._answer.done():
            self.state = "reaching"

    def _reaching(self) -> None:
        self._waited += 1
        if self._ended or self._waited > PATIENCE:
            self.state = "idle"
            return
        self._send(self.vertex.astype(np.float64))
        apart = np.linalg.norm(self._place() - self.vertex)
        if apart < NEAR * min(self._known.values[f"{self.handle}.reach"]):
            self._answer = self._remote.call(f"handles/{self.handle}/attach", True)
            self.state = "asking" if self._answer is not None else "reaching"

    def _asking(self) -> None:
        if not self._answer.done():
            return
        answer = self._answer.result()
        if answer.success:
            self.state = "holding"
        elif self._waited < PATIENCE and not self._ended:
            self.state = "reaching"
        else:
            self.state = "idle"
        self._told(answer.message)

    def _holding(self) -> None:
        arrived = np.linalg.norm(self._place() - self._sent) < _STILL
        vertex = self.vertex.astype(np.float64)
        pull = self._pointer - vertex
        goal = vertex + pull * min(1.0, LONGEST / max(np.linalg.norm(pull), _STILL))
        way = goal - self._sent
        if self._ended:
            self._answer = self._remote.call(f"handles/{self.handle}/attach", False)
            self.state = "leaving"
        elif np.linalg.norm(way) > _STILL:
            self._send(self._sent + (SHARE * way if np.linalg.norm(way) > 100 * _STILL else way))
        elif not arrived:  # a pose may be lost on its way
            self._send(self._sent)

    def _leaving(self) -> None:
        if self._answer is None or self._answer.done():
            if self._answer is not None:
                self._told(self._answer.result().message)
            self.state = "idle"

    def _place(self) -> np.ndarray:
        return self._scene.places.get(self.handle, np.full(3, np.inf))

    def _send(self, position: np.ndarray) -> None:
        self._sent = position
        self._remote.move(self.handle, position, self._known.values["frame_id"])
