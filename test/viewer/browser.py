# SPDX-License-Identifier: Apache-2.0
"""What a browser is to the page: a websocket by which it is shown things, and says what keys and mouse do."""

from __future__ import annotations

from typing import Any

import msgspec.msgpack
import numpy as np
import viser
import zstandard
from viser import _messages as messages
from websockets.sync.client import connect


class Browser:
    """Keeps what the page at a port shows.

    gui: by uuid what is known of each control; commands: uuid by label; meshes: by name vertices (N, 3) and faces.
    """

    def __init__(self, port: int):
        protocol = f"viser-v{viser.__version__}"
        self._socket = connect(f"ws://127.0.0.1:{port}", subprotocols=[protocol], max_size=None, compression=None)
        self.gui: dict[str, dict[str, Any]] = {}
        self.commands: dict[str, str] = {}
        self.meshes: dict[str, dict[str, np.ndarray]] = {}
        look = {"near": 0.1, "far": 10.0, "image_height": 800, "image_width": 1280}
        pose = {"wxyz": (1, 0, 0, 0), "position": (0, -2, 1), "look_at": (0, 0, 1), "up_direction": (0, 0, 1)}
        self._send(messages.ViewerCameraMessage(fov=0.7, **pose, **look))

    def close(self) -> None:
        """Leaves the page."""
        self._socket.close()

    def look(self) -> None:
        """Takes in what has come since."""
        while True:
            try:
                raw = self._socket.recv(timeout=0.0)
            except TimeoutError:
                return
            size = int.from_bytes(raw[8:16], "little")
            window = msgspec.msgpack.decode(zstandard.ZstdDecompressor().decompress(raw[16 : 16 + size]))
            start, buffers = 16 + size, []
            for length in window["binaryBufferLengths"]:
                start += -start % 8
                buffers.append(raw[start : start + length])
                start += length
            for message in window["messages"]:
                self._take(message, buffers)

    def _take(self, message: dict[str, Any], buffers: list[bytes]) -> None:
        kind = message["type"]
        if kind == "RegisterCommandMessage":
            self.commands[message["props"]["label"]] = message["uuid"]
        elif kind == "GuiUpdateMessage":
            self.gui.get(message["uuid"], {}).update(message["updates"])
        elif kind == "GuiRemoveMessage":
            self.gui.pop(message["uuid"], None)
        elif kind.startswith("Gui") and "uuid" in message and "props" in message:
            self.gui[message["uuid"]] = {"kind": kind, "value": message.get("value"), **message["props"]}
        elif kind == "RemoveSceneNodeMessage":
            self.meshes = {name: mesh for name, mesh in self.meshes.items() if not name.startswith(message["name"])}
        elif kind in ("MeshMessage", "SceneNodeUpdateMessage"):
            known = self.meshes.setdefault(message["name"], {}) if kind == "MeshMessage" else {}
            known = self.meshes.get(message["name"], known)
            for key in {"vertices", "faces"} & set(message.get("props") or message.get("updates")):
                array = (message.get("props") or message["updates"])[key]
                known[key] = np.frombuffer(buffers[array["__binary_index"]], array["dtype"]).reshape(-1, 3)

    def control(self, label: str) -> str:
        """The uuid of the first control of this label, of one by powers of ten that of its slider."""
        found = next(uuid for uuid, each in self.gui.items() if each.get("label") == label)
        if self.gui[found]["kind"] != "GuiTextMessage":
            return found
        later = (uuid for uuid, each in self.gui.items() if each["order"] > self.gui[found]["order"])
        return min(later, key=lambda uuid: self.gui[uuid]["order"])

    def says(self, words: str) -> bool:
        """Whether some text of the page holds these words."""
        self.look()
        return any(words in str(each.get(key)) for each in self.gui.values() for key in ("_markdown", "value"))

    def slide(self, label: str, place: float) -> None:
        """Puts a slider to a place."""
        uuid = self.control(label)
        value = (place,) if self.gui[uuid]["kind"] == "GuiMultiSliderMessage" else place
        self._send(messages.GuiUpdateMessage(uuid, {"value": value}))

    def press(self, key: str) -> None:
        """Runs the command that a key has."""
        self._send(messages.CommandTriggerMessage(self.commands[key]))

    def drag(self, mesh: str, phase: str, start: np.ndarray, end: np.ndarray) -> None:
        """The mouse drags a mesh from `start` to `end`, both (3,) [m]."""
        places = {"start_position": tuple(map(float, start)), "end_position": tuple(map(float, end))}
        screen = {"start_screen_pos": (0.5, 0.5), "end_screen_pos": (0.5, 0.5)}
        self._send(messages.SceneNodeDragMessage(phase, mesh, None, **places, **screen, button="left", modifier=None))

    def click(self, mesh: str, eye: np.ndarray, at: np.ndarray) -> None:
        """A click on a mesh, along the ray from `eye` to `at`, both (3,) [m]."""
        way = (at - eye) / np.linalg.norm(at - eye)
        ray = {"ray_origin": tuple(map(float, eye)), "ray_direction": tuple(map(float, way))}
        self._send(messages.SceneNodeClickMessage(mesh, None, **ray, screen_pos=(0.5, 0.5), modifier=None))

    def _send(self, message: Any) -> None:
        self._socket.send(msgspec.msgpack.encode(message.as_serializable_dict()))
